"""Prediction on real pushes: motions of pushes that were not fitted, and which pushes with two fingers hold the object."""

import pathlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table
from scipy.optimize import minimize

from bench.display import pivot_table, plain_tables
from bench.paper.pushes import estimated
from bench.public import stablepush, zhou2015
from bench.real_pushes import GRIDS, OUTLINE, TRUE, TRUTH, support_points
from pushfric_core import Ellipsoid, EstimatorConfig, NamedEllipsoid, Observation, Support, friction_model, named_ellipsoid
from pushfric_core.geometry.contact import tangent
from pushfric_core.geometry.planar import Array, cross, left_of
from pushfric_core.mechanics.prediction import FrictionModel, predict, stability

RADIUS = 0.05
"""Arm at which a rotation counts as much as a translation [m]: about the radius of gyration of the triangle."""

GRID = "grid_55"
FOLDS, HALVINGS, SUBSETS, FEW = 5, 5, 20, 10
"""For each log: the number of folds, of halvings in which each half is fitted once, and of random choices of FEW pushes."""

UNIFORM = Support(OUTLINE.grid(30, 30), np.full(len(OUTLINE.grid(30, 30)), 1 / len(OUTLINE.grid(30, 30))))
CONTENDERS = ("pushfric", "uniform", "ellipsoid", "fitted_ellipsoid")
STEPS = 3


class Pushes(NamedTuple):
    """Pushes of one log."""

    observations: Sequence[Observation]
    points: Array  # (k, 2) contacts
    normals: Array  # (k, 2)
    velocities: Array  # (k, 2) of the tip, over the whole push
    twists: Array  # (k, 3) measured

    def of(self, chosen: Array) -> "Pushes":
        """Some of them."""
        return Pushes.made([self.observations[k] for k in chosen])

    @classmethod
    def made(cls, observations: Sequence[Observation]) -> "Pushes":
        """Those of observations with a tip velocity."""
        names = ("contact_point", "contact_normal", "tip_velocity", "twist")
        return cls(observations, *(np.array([getattr(one, name) for one in observations]) for name in names))


def measure(source: pathlib.Path, progress: Callable[[str], None]) -> dict[str, Any]:
    """Errors of predicted motions over all logs, and of predicted stability if stable_pushes.csv lies next to the source.

    Args:
        source: push_points.csv of `zhou2015`.
        progress: called with what comes next, STEPS times.
    Returns:
        {"twists": [{"log", "support", "fitted", "median_deg": {contender: value}, "within_90": value}],
        "stability": [{"object", "log", "balanced_accuracy": {contender: value}}]}.
    Raises:
        InvalidInput: a file cannot be read.
    """
    logs = {log: Pushes.made(observations) for log, observations in zhou2015.read_push_points(source).items()}
    twists = []
    for support in (GRID, TRUE):
        progress(f"real pushes: motions, {support}")
        for index, (log, pushes) in enumerate(logs.items()):
            points = support_points(log, support)
            if points is not None:
                twists += list(_twists(log, support, points, pushes, index))
    progress("real pushes: stability")
    two_fingers = source.parent / "stable_pushes.csv"
    stable = list(_stability(logs, two_fingers)) if two_fingers.is_file() else []
    return {"twists": twists, "stability": stable}


def tables(figures: dict[str, Any]) -> Iterator[Table]:
    """Angles between predicted and measured motions, by what was fitted; each peer has the same mu_c."""
    medians = (
        {"support": row["support"], "fitted": row["fitted"], "model": model, "log": row["log"].split("__exp")[0], "": value}
        for row in figures["twists"]
        for model, value in {**row["median_deg"], "share in the predicted 90 %": row["within_90"]}.items()
    )
    yield pivot_table("Motion of pushes not fitted [degrees], medians", medians, "log", "", median=np.median)
    yield from plain_tables("Stable pushes", figures["stability"])


def fit(points: Array, observations: Sequence[Observation]) -> FrictionModel:
    """The model that the estimator, with its defaults, makes from some observations."""
    _, estimate = estimated(observations, points, EstimatorConfig())
    return friction_model(estimate)


def angles(twists: Array, measured: Array) -> Array:
    """Angles (k,) between motions (k, 3) as (v at the middle of the triangle, RADIUS * omega) [degrees]."""
    a, b = (np.column_stack((t[:, :2] + t[:, 2:] * left_of(TRUTH), RADIUS * t[:, 2])) for t in (twists, measured))
    cosines = np.sum(a * b, axis=1) / np.maximum(np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1), 1e-300)
    return np.degrees(np.arccos(np.clip(cosines, -1, 1)))


def _splits(count: int, index: int) -> Iterator[tuple[str, Array, Array]]:
    """The indices of the pushes that are fitted and of those that are predicted, with the name of the protocol."""
    shuffled = np.random.default_rng([index, FOLDS]).permutation(count)
    for fold in range(FOLDS):
        yield f"{FOLDS}-fold", np.delete(shuffled, np.s_[fold::FOLDS]), shuffled[fold::FOLDS]
    for number in range(HALVINGS):
        shuffled = np.random.default_rng([index, number, 2]).permutation(count)
        halves = shuffled[: count // 2], shuffled[count // 2 :]
        yield "half", *halves
        yield "half", *halves[::-1]
    for number in range(SUBSETS):
        shuffled = np.random.default_rng([index, number, FEW]).permutation(count)
        yield f"{FEW} pushes", shuffled[:FEW], shuffled[FEW:]


def _twists(log: str, support: str, points: Array, pushes: Pushes, index: int) -> Iterator[dict[str, Any]]:
    errors: dict[str, dict[str, list[float]]] = {}
    within: dict[str, list[bool]] = {}
    for protocol, fitted, unseen in _splits(len(pushes.observations), index):
        train, test = pushes.of(fitted), pushes.of(unseen)
        model = fit(points, train.observations)
        mu_c = model.mean_mu_c
        own = predict(model, test.points, test.normals, test.velocities)
        uniform = predict(FrictionModel.of(UNIFORM, mu_c), test.points, test.normals, test.velocities)
        found = {
            "pushfric": own.twists,
            "uniform": uniform.twists,
            "ellipsoid": ellipsoid_motions(named_ellipsoid(UNIFORM).form(), mu_c, test),
            "fitted_ellipsoid": ellipsoid_motions(fitted_ellipsoid(mu_c, train), mu_c, test),
        }
        for contender, twists in found.items():
            errors.setdefault(protocol, {}).setdefault(contender, []).extend(angles(twists, test.twists))
        within.setdefault(protocol, []).extend(model.angles(own.twists, test.twists) <= own.spread)
    for protocol, by_contender in errors.items():
        yield {
            "log": log,
            "support": support,
            "fitted": protocol,
            "median_deg": {contender: float(np.median(values)) for contender, values in by_contender.items()},
            "within_90": float(np.mean(within[protocol])),
        }


def ellipsoid_motions(ellipsoid: Ellipsoid, mu_c: float, pushes: Pushes) -> Array:
    """The motions (k, 3) of an object with this limit surface, in closed form (Lynch, Maekawa and Tanie 1992)."""
    k = len(pushes.points)
    jacobians = np.zeros((k, 2, 3))
    jacobians[:, 0, 0] = jacobians[:, 1, 1] = 1
    jacobians[:, :, 2] = left_of(pushes.points)
    mobility = jacobians @ ellipsoid.form @ jacobians.transpose(0, 2, 1)
    forces = np.linalg.solve(mobility, pushes.velocities[..., None])[..., 0]
    along = tangent(pushes.normals)
    pressure, shear = -np.sum(forces * pushes.normals, axis=1), np.sum(forces * along, axis=1)
    slides = np.abs(shear) > mu_c * pressure
    edges = -pushes.normals + (np.sign(shear) * mu_c)[:, None] * along
    forces[slides] = edges[slides]
    twists = np.einsum("ij,kaj,ka->ki", ellipsoid.form, jacobians, forces)
    moved = np.einsum("kaj,kj->ka", jacobians, twists)
    scale = np.sum(pushes.velocities * pushes.normals, axis=1) / np.sum(moved * pushes.normals, axis=1)
    return np.where(slides[:, None], scale[:, None] * twists, twists)


def fitted_ellipsoid(mu_c: float, pushes: Pushes) -> Ellipsoid:
    """The centre and the ratio of the axes that predict the fitted pushes best: least mean angle."""

    def cost(parameters: Array) -> float:
        return float(np.mean(angles(ellipsoid_motions(_ellipsoid(parameters), mu_c, pushes), pushes.twists)))

    start = np.array((*UNIFORM.center_of_friction, named_ellipsoid(UNIFORM).m_max))
    simplex = np.vstack((start, start + 0.01 * np.eye(3)))
    return _ellipsoid(minimize(cost, start, method="Nelder-Mead", options={"initial_simplex": simplex, "xatol": 1e-4}).x)


def _ellipsoid(parameters: Array) -> Ellipsoid:
    return NamedEllipsoid(1.0, max(abs(float(parameters[2])), 1e-3), parameters[:2]).form()


def _stability(logs: dict[str, Pushes], source: pathlib.Path) -> Iterator[dict[str, Any]]:
    for name, (edge, _, stable) in stablepush.read_stable_pushes(source).items():
        for log, pushes in logs.items():
            if log.split("__exp")[0].removeprefix("wood_") != name:
                continue
            model = fit(GRIDS[GRID], pushes.observations)
            uniform = FrictionModel.of(UNIFORM, model.mean_mu_c)
            held = {
                "pushfric": stability(model, *edge).stable,
                "uniform": stability(uniform, *edge).stable,
                "ellipsoid": ellipsoid_holds(named_ellipsoid(UNIFORM).form(), model.mean_mu_c, edge),
            }
            scores = {contender: balanced_accuracy(found, stable) for contender, found in held.items()}
            yield {"object": name, "log": log, "balanced_accuracy": scores}


def ellipsoid_holds(ellipsoid: Ellipsoid, mu_c: float, pushes: stablepush.EdgePushes) -> np.ndarray:
    """Which pushes (k,) hold an object with this limit surface: the wrench lies in the cone of the two contacts."""
    twists = np.column_stack((-pushes.turns[:, None] * left_of(pushes.centers), pushes.turns))
    wrenches = np.linalg.solve(ellipsoid.form, twists.T).T
    pressure = -np.sum(wrenches[:, :2] * pushes.contact_normals, axis=1)
    shear = np.abs(np.sum(wrenches[:, :2] * tangent(pushes.contact_normals), axis=1))
    moment = np.abs(wrenches[:, 2] - cross(pushes.contact_points, wrenches[:, :2]))
    return (shear <= mu_c * pressure) & (moment <= pushes.half_widths * pressure)


def balanced_accuracy(found: np.ndarray, truth: np.ndarray) -> float:
    """Mean of the share of positives that was found and the share of negatives that was found."""
    return float((found[truth].mean() + (~found[~truth]).mean()) / 2)
