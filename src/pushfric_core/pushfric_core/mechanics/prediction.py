"""Predictions of an estimate: where a push takes the object, which pushes hold it, and how far each answer can be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.estimation.estimate import Estimate
from pushfric_core.geometry.planar import Array, as_array, frozen, left_of
from pushfric_core.geometry.support import Support, center_of_friction, check_points
from pushfric_core.mechanics import quasi_static
from pushfric_core.mechanics.quasi_static import MODES, SUM, Motions
from pushfric_core.mechanics.simulation import ContactMode
from pushfric_core.records import comparable
from pushfric_core.trajectories.observation import Observation
from pushfric_core.uncertainty import contact_friction
from pushfric_core.wording import counted

SHARE = 0.9
"""The truth lies within a spread this often."""

WITNESSES = 50
"""A model is judged by at most this many observations, spread evenly over all: its cost does not grow with their number."""

LEAST_SHARE = 0.01
"""Samples with a smaller weight are left out."""

STICKING = 1e6
"""A contact friction coefficient with which no tip slides."""

COEFFICIENTS = 0.05 * 2 ** (np.arange(11) / 2)
"""Contact friction coefficients to try, as far as they lie in the estimate's interval; 1.6 is that of rubber on wood."""

EXACT = 1e-6
"""Mean angles below this are those of exact data [rad]."""


@comparable
@dataclass(frozen=True)
class FrictionModel:
    """How an object slides: samples of what w and mu_c may be. A single sample is an estimate taken as exact.

    Args:
        support_points: (n, 2) object frame [m].
        w: (s, n) support friction distributions, >= 0, each with sum 1.
        mu_c: (s,) contact friction coefficients, >= 0 and finite.
        share: (s,) weights of the samples, sum 1.
        misfit: 90 % of the observations have a smaller angle between their measured motion and the one that w predicts [rad]:
            what the model itself cannot explain, see `misfit`.
    Raises:
        ValueError: shapes that do not fit, or values that make no sense.

    Example:
        >>> from pushfric_core import TABLE_1, FrictionModel
        >>> known = TABLE_1["wood_rect4"]
        >>> model = FrictionModel.of(known.support, known.mu_c)
        >>> model.center_of_friction.tolist(), model.mean_mu_c
        ([0.0, 0.0], 0.3)
    """

    support_points: Array
    w: Array
    mu_c: Array
    share: Array
    misfit: float = 0.0

    def __post_init__(self) -> None:
        points = check_points(self.support_points)
        w, mu_c = frozen(self.w), frozen(self.mu_c)
        quasi_static.check_samples(points, w, mu_c)
        share = frozen(self.share)
        if share.shape != (len(w),) or not (share >= 0).all() or not abs(share.sum() - 1) < SUM:
            raise ValueError(f"share must have shape ({len(w)},), nonnegative with sum 1, got {share.tolist()}")
        if not 0 <= self.misfit <= np.pi:
            raise ValueError(f"misfit must lie in [0, pi] rad, got {self.misfit}")
        for name, array in (("support_points", points), ("w", w), ("mu_c", mu_c), ("share", share)):
            object.__setattr__(self, name, array)

    def __repr__(self) -> str:
        x, y = 1e3 * self.center_of_friction
        samples = f"{counted(len(self.w), 'sample')} over {counted(len(self.support_points), 'support point')}"
        return f"<FrictionModel: p_CF ({x:.2f}, {y:.2f}) mm, mu_c {self.mean_mu_c:.3f}, {samples}>"

    @classmethod
    def of(cls, support: Support, mu_c: float, misfit: float = 0.0) -> FrictionModel:
        """The model of a single sample."""
        return cls(support.points, support.weights[None], np.array((mu_c,)), np.ones(1), misfit)

    @cached_property
    def support(self) -> Support:
        """The mean of the support friction distributions."""
        mean = self.share @ self.w
        return Support(self.support_points, mean / mean.sum())

    def drawn(self, count: int) -> list[FrictionModel]:
        """Models of a single sample each, in proportion to the weights: those at evenly spaced quantiles, always the same.

        Raises:
            ValueError: count < 1.
        """
        if count < 1:
            raise ValueError(f"count must be at least 1, got {count}")
        levels = (np.arange(count) + 0.5) / count
        rows = np.minimum(np.searchsorted(np.cumsum(self.share), levels), len(self.w) - 1)
        return [FrictionModel(self.support_points, self.w[[k]], self.mu_c[[k]], np.ones(1), self.misfit) for k in rows]

    @cached_property
    def mean(self) -> FrictionModel:
        """The model of a single sample: the mean friction."""
        return FrictionModel.of(self.support, self.mean_mu_c, self.misfit)

    @property
    def with_mean(self) -> tuple[Array, Array]:
        """w (s + 1, n) and mu_c (s + 1,) of the samples, the last ones of their mean; of a single sample, only its own."""
        if len(self.w) == 1:
            return self.w, self.mu_c
        return np.vstack((self.w, self.support.weights)), np.append(self.mu_c, self.mean_mu_c)

    @cached_property
    def mean_mu_c(self) -> float:
        """The mean contact friction coefficient."""
        return float(self.share @ self.mu_c)

    @cached_property
    def center_of_friction(self) -> Array:
        """p_CF (2,) of the mean [m]."""
        return center_of_friction(self.support.points, self.support.weights)

    @cached_property
    def length(self) -> float:
        """Arm at which a rotation counts as much as a translation, and a moment as much as a force [m].

        The rms distance of the support points from their middle; 1 if there is only one point.
        """
        spread = self.support_points - self.support_points.mean(axis=0)
        return float(np.sqrt(np.mean(np.sum(spread**2, axis=1)))) or 1.0

    def angles(self, twists: npt.ArrayLike, others: npt.ArrayLike) -> Array:
        """Angles (...) between twists (..., 3) as (v at p_CF, length * omega) [rad]; pi/2 if one of the two is zero."""
        a, b = self.centered(twists), self.centered(others)
        sizes = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
        cosines = np.sum(a * b, axis=-1) / np.where(sizes > 0, sizes, 1.0)
        return np.asarray(np.arccos(np.clip(cosines, -1.0, 1.0)))

    def centered(self, twists: npt.ArrayLike) -> Array:
        """Twists (..., 3) as (v at p_CF, length * omega) [m/s]."""
        twists = as_array(twists)
        omega = twists[..., 2:]
        return np.concatenate((twists[..., :2] + omega * left_of(self.center_of_friction), self.length * omega), axis=-1)


@comparable
class Predictions(NamedTuple):
    """The effect of k pushes: the motion of the mean friction, and how those of the samples scatter about it.

    Example:
        >>> from pushfric_core import TABLE_1, FrictionModel, predict
        >>> known = TABLE_1["wood_rect4"]
        >>> found = predict(FrictionModel.of(known.support, known.mu_c), [(0.0, -0.032)], [(0.0, -1.0)], [(0.0, 0.02)])
        >>> found.modes[0].value, float(found.spread[0])
        ('sticking', 0.0)
    """

    twists: Array  # (k, 3) of the object-frame origin, object frame, per the unit of time of the tip's velocity
    modes: tuple[ContactMode, ...]  # how the tip meets the object in each push
    forces: Array  # (k, 2) of the pusher ON the object, object frame; unit: the support friction of the translating object
    spread: Array  # (k,) 90 % of measured twists lie within this angle of the predicted one [rad], see FrictionModel.angles
    samples: Motions  # of each push and sample
    covariance: Array  # (k, 3, 3) of the measured twist about the predicted one: of the samples, and of the misfit


def predict(
    model: FrictionModel, contact_points: npt.ArrayLike, contact_normals: npt.ArrayLike, tip_velocities: npt.ArrayLike
) -> Predictions:
    """How the object moves under each of k pushes, at that instant.

    If the tip moves away from the object, or along it, the object stays at rest: the mode is FREE, and the twist zero.

    Args:
        model: of the object.
        contact_points: (k, 2) object frame [m].
        contact_normals: (k, 2) unit, outward.
        tip_velocities: (k, 2) object frame [m per any unit of time].
    Raises:
        ValueError: shapes that do not fit, or values that are not finite.
        SolverFailed: a motion did not converge.

    Example:
        >>> from pushfric_core import TABLE_1, FrictionModel, predict
        >>> known = TABLE_1["wood_rect4"]
        >>> model = FrictionModel.of(known.support, known.mu_c)
        >>> found = predict(model, [(0.0, -0.032)], [(0.0, -1.0)], [(0.0, 0.02)])
        >>> found.modes[0].value, round(float(found.twists[0, 1]), 4)
        ('sticking', 0.02)
    """
    w, mu_c = model.with_mean
    moved = quasi_static.motions(model.support_points, w, mu_c, contact_points, contact_normals, tip_velocities)
    twists, modes, forces = moved.twists[:, -1], moved.modes[:, -1], moved.forces[:, -1]
    count = len(model.w)
    samples = Motions(moved.twists[:, :count], moved.modes[:, :count], moved.forces[:, :count])
    scatter = _quantile(model.angles(samples.twists, twists[:, None]), model.share, SHARE)
    spread = np.where(modes == quasi_static.FREE, 0.0, np.minimum(np.hypot(scatter, model.misfit), np.pi))
    covariance = scattered(samples.twists, twists, model.share) + _of_misfit(model, twists)
    return Predictions(twists, tuple(MODES[mode] for mode in modes), forces, spread, samples, covariance)


def scattered(samples: Array, about: Array, share: Array) -> Array:
    """The mean squares and products (k, 3, 3) of the differences of samples (k, s, 3) from (k, 3); shares (s,)."""
    differences = samples - about[:, None]
    return np.asarray(np.sum(share[:, None, None] * differences[..., :, None] * differences[..., None, :], axis=1))


def _of_misfit(model: FrictionModel, twists: Array) -> Array:
    """The covariances (k, 3, 3) of twists (k, 3) that are off by the misfit in 90 of 100 cases, in no preferred direction.

    Such an error lies across the twist, as (v at p_CF, length * omega): two normal deviates exceed the misfit in 10 % of cases.
    """
    x, y = model.center_of_friction
    # from (v at p_CF, length * omega) to the twist of the origin
    back = np.array(((1.0, 0.0, y / model.length), (0.0, 1.0, -x / model.length), (0.0, 0.0, 1 / model.length)))
    centered = model.centered(twists)
    squares = np.sum(centered**2, axis=1)
    across = squares[:, None, None] * np.eye(3) - centered[:, :, None] * centered[:, None, :]
    variance = model.misfit**2 / (-2 * np.log(1 - SHARE))
    return np.asarray(variance * np.einsum("ia,kab,jb->kij", back, across, back))


@comparable
class MotionCone(NamedTuple):
    """The edges of the motion cones of k contacts: motions with the tip on the verge of sliding, the contact at unit speed."""

    right: Array  # (k, 3) it slides towards -t beyond
    left: Array  # (k, 3) it slides towards +t beyond


def motion_cone(model: FrictionModel, contact_points: npt.ArrayLike, contact_normals: npt.ArrayLike) -> MotionCone:
    """The motion cones of k contacts: means over the samples. Raises as `predict`.

    Example:
        >>> from pushfric_core import TABLE_1, FrictionModel, motion_cone
        >>> known = TABLE_1["wood_rect4"]
        >>> cone = motion_cone(FrictionModel.of(known.support, known.mu_c), [(0.0, -0.032)], [(0.0, -1.0)])
        >>> cone.left.shape, cone.right.shape
        ((1, 3), (1, 3))
    """
    cones = quasi_static.motion_cones(model.support_points, model.w, model.mu_c, contact_points, contact_normals)
    mean = np.einsum("s,kseD->keD", model.share, cones)
    return MotionCone(mean[:, 0], mean[:, 1])


@comparable
class Stability(NamedTuple):
    """Whether pushes with an edge or two fingers hold the object.

    Example:
        >>> from pushfric_core import TABLE_1, FrictionModel, stability
        >>> known = TABLE_1["wood_rect4"]
        >>> model = FrictionModel.of(known.support, known.mu_c)
        >>> held = stability(model, [(0.0, -0.032)], [(0.0, -1.0)], [0.03], centers=[(-0.02, -0.032)], turns=[1.0])
        >>> held.stable.tolist(), held.probabilities.tolist()
        ([False], [0.0])
    """

    stable: npt.NDArray[np.bool_]  # (k,)
    margins: Array  # (k,) median over the samples; see quasi_static.holding_margins
    probabilities: Array  # (k,) share of the samples in which the object does not slip


def stability(
    model: FrictionModel,
    contact_points: npt.ArrayLike,
    contact_normals: npt.ArrayLike,
    half_widths: npt.ArrayLike,
    centers: npt.ArrayLike,
    turns: npt.ArrayLike,
) -> Stability:
    """Which of k pushes with an edge or two fingers hold the object while they turn it about a centre of rotation.

    All centres of one contact with a margin above zero are the set of those that hold.

    Args:
        model: of the object.
        contact_points: (k, 2) middles of the contact intervals, object frame [m].
        contact_normals: (k, 2) unit, outward.
        half_widths: (k,) of the intervals [m].
        centers: (k, 2) of rotation, object frame [m].
        turns: (k,) +1 counter-clockwise, -1 clockwise.
    Raises:
        ValueError: shapes that do not fit, values that are not finite, or a turn other than +1 and -1.

    Example:
        >>> from pushfric_core import TABLE_1, FrictionModel, stability
        >>> known = TABLE_1["wood_rect4"]
        >>> model = FrictionModel.of(known.support, known.mu_c)
        >>> held = stability(model, [(0.0, -0.032)], [(0.0, -1.0)], [0.03], centers=[(-1.0, -0.032)], turns=[1.0])
        >>> held.stable.tolist()
        [True]
    """
    centers, turns = as_array(centers), as_array(turns)
    if centers.ndim != 2 or centers.shape[1] != 2 or turns.shape != centers.shape[:1]:
        raise ValueError(f"centers and turns must have shapes (k, 2) and (k,), got {centers.shape} and {turns.shape}")
    if not (np.abs(turns) == 1).all():
        raise ValueError("turns must be +1 or -1")
    twists = np.column_stack((-turns[:, None] * left_of(centers), turns))
    samples = quasi_static.holding_margins(
        model.support_points, model.w, model.mu_c, contact_points, contact_normals, half_widths, twists, model.length
    )
    margins = _quantile(samples, model.share, 0.5)
    held = np.sum((samples >= 0) * model.share, axis=1)
    return Stability(margins >= 0, margins, np.minimum(held, 1.0))


def misfit(model: FrictionModel, observations: Sequence[Observation], fitted: int) -> float:
    """The misfit that a model leaves in the observations it was made from, for `FrictionModel.misfit` [rad].

    Each observation's motion is compared with the one that the mean friction predicts, see `_explained`. The misfit is the
    angle that 90 % of new observations stay below (the order statistic of rank ceil(0.9 (m + 1))), enlarged because w was
    fitted to the same observations. It is 0 without observations.

    Args:
        model: of the object.
        observations: the observations, m.
        fitted: how many parameters were fitted to them: the weights above zero of the optimum, less one.
    """
    if not observations:
        return 0.0
    angles = np.sort(_explained(model.mean, model, _witnesses(observations))[:, 0])
    m = len(angles)
    rank = min(int(np.ceil(SHARE * (m + 1) - 1e-9)), m)
    count = len(observations)
    return float(min(angles[rank - 1] * np.sqrt(count / max(count - fitted, 1)), np.pi))


def prediction_errors(model: FrictionModel, observations: Sequence[Observation]) -> Array:
    """Angles (m,) between the motions of m >= 1 observations and those that the mean friction predicts [rad].

    Where the tip's velocity is known, it is the tip that pushes; else the contact moves as it was measured to.
    """
    return _explained(model.mean, model, observations)[:, 0]


def friction_model(estimate: Estimate) -> FrictionModel:
    """The friction model of an estimate, from the w that explain the observations about as well as the optimum.

    The samples are the optimum, the middle and the extreme w of its spread, and equal weights on all support points, as one
    assumes before any push; each has its own mu_c. The program compares moments, but a planner asks for motions. So each sample
    counts by the motions that it predicts for the observations. For each standard error by which the mean of its angles exceeds
    the least such mean, it counts 1/e as much. The errors of one push are alike. So the standard error is that of as many
    angles as there are pushes; their standard deviation is taken for their mean, as in an exponential distribution.
    docs/planning.md has the evidence.

    Where the tip's velocity is known, mu_c is shifted to the mean of what its interval holds, weighed in the same way: few
    slips, or bounds alone, hardly determine it, but a tip that would slide with a lower one moves the object another way.
    Elsewhere, if mu_c is only bounded, 90 % of the finite lower bounds lie at or below the value used.

    Args:
        estimate: from at least one observation; the observations that it holds are those that judge the samples.
    Raises:
        ValueError: the estimate rests on no observation.

    Example:
        >>> from pushfric_core import Estimator, Observation, Twist, friction_model, predict
        >>> estimator = Estimator([(-0.05, -0.02), (0.05, -0.02), (0.0, 0.02)])
        >>> estimate = estimator.add(Observation((0.01, -0.03), (0.0, -1.0), Twist(0.0, 0.02, 0.1)))
        >>> model = friction_model(estimate)
        >>> predict(model, [(0.0, -0.03)], [(0.0, -1.0)], [(0.0, 0.02)]).twists.shape
        (1, 3)
    """
    if not estimate.data_points:
        raise ValueError("a friction model needs an estimate from at least one observation, got one from none")
    observations = estimate.observations
    bounds = estimate.contact_friction[np.isfinite(estimate.contact_friction)]
    bound = contact_friction.percentile(bounds, SHARE) if len(bounds) else STICKING
    points = estimate.support_points
    known = [estimate.w] if estimate.spread is None else [estimate.w, estimate.spread.middle, *estimate.spread.extremes]
    w = np.clip((*known, np.full(len(points), 1 / len(points))), 0.0, 1.0)
    w /= w.sum(axis=1, keepdims=True)
    mu_c = np.array([bound if value is None else value for value in estimate.mu_c_of(w)])
    model = FrictionModel(points, w, mu_c, np.full(len(w), 1 / len(w)))
    if observations:
        witnesses = _witnesses(observations)
        mu_c = np.maximum(mu_c - model.mean_mu_c + _mu_c(model, estimate, witnesses), 0.0)
        model = replace(model, mu_c=mu_c)
        share = _shares(_explained(model, model, witnesses).mean(axis=0), estimate.pushes)
        counts = share >= LEAST_SHARE
        model = FrictionModel(points, w[counts], mu_c[counts], share[counts] / share[counts].sum())
    fitted = int(np.count_nonzero(estimate.w)) - 1
    return replace(model, misfit=misfit(model, observations, fitted))


def _mu_c(model: FrictionModel, estimate: Estimate, observations: Sequence[Observation]) -> float:
    """mu_c by the motions that it predicts for observations with a known tip, within the interval of the estimate."""
    known, own = estimate.mu_c, model.mean_mu_c
    if known is None or not any(observation.tip_velocity for observation in observations):
        return own
    high = max(known.low, min(known.high, float(COEFFICIENTS[-1])))
    inside = COEFFICIENTS[(known.low < COEFFICIENTS) & (high > COEFFICIENTS)]
    mu_c = np.array((known.low, *inside, high, min(own, STICKING)))
    w = np.repeat(model.support.weights[None], len(mu_c), axis=0)
    candidates = FrictionModel(model.support_points, w, mu_c, np.full(len(mu_c), 1 / len(mu_c)))
    share = _shares(_explained(candidates, model, observations).mean(axis=0), estimate.pushes)
    return float(share @ np.minimum(mu_c, high))


def _shares(means: Array, pushes: int) -> Array:
    """How much samples count whose angles have these means (s,) [rad]; (s,), sum 1."""
    least = float(means.min())
    share = np.exp(-(means - least) * np.sqrt(pushes) / max(least, EXACT))
    return np.asarray(share / share.sum())


def _witnesses(observations: Sequence[Observation]) -> Sequence[Observation]:
    """At most WITNESSES of the observations, evenly spread over all."""
    count = len(observations)
    if count <= WITNESSES:
        return observations
    return [observations[k] for k in np.linspace(0, count - 1, WITNESSES).round().astype(int).tolist()]


def predicted_twists(model: FrictionModel, observations: Sequence[Observation]) -> Array:
    """Twists (m, s, 3) that the samples of a model predict for m >= 1 observations, object frame [m/s, rad/s].

    Where the tip's velocity is known, it is the tip that pushes; else, or where the tip was seen to leave, the contact moves as
    it was measured to, so that mu_c does not matter. If that moves away from the pusher, the object stays at rest.

    Raises:
        SolverFailed: a motion did not converge.
    """
    points = np.array([observation.contact_point for observation in observations])
    normals = np.array([observation.contact_normal for observation in observations])
    measured = np.array([observation.twist for observation in observations])
    velocities = measured[:, :2] + measured[:, 2:] * left_of(points)
    tips = np.array([observation.tip_velocity or (0.0, 0.0) for observation in observations])
    pushed = np.sum(tips * normals, axis=1) < 0
    twists = np.empty((len(points), len(model.w), 3))
    for rows, moving, mu_c in ((pushed, tips, model.mu_c), (~pushed, velocities, np.full(len(model.w), STICKING))):
        if rows.any():
            seen = quasi_static.motions(model.support_points, model.w, mu_c, points[rows], normals[rows], moving[rows])
            twists[rows] = seen.twists
    return twists


def _explained(model: FrictionModel, judge: FrictionModel, observations: Sequence[Observation]) -> Array:
    """Angles (m, s) between the motions of m >= 1 observations and those that each of the samples of a model predicts [rad].

    If nothing can be predicted, the angle counts as pi/2. The angles go by p_CF and length of the judge.
    """
    measured = np.array([observation.twist for observation in observations])
    return judge.angles(predicted_twists(model, observations), measured[:, None])


def _quantile(values: Array, share: Array, level: float) -> Array:
    """The least of the values (k, s) at or below which a share of `level` lies, for samples of the given shares (s,); (k,)."""
    order = np.argsort(values, axis=1)
    reached = np.cumsum(share[order], axis=1) >= level - SUM
    return np.asarray(np.take_along_axis(values, np.take_along_axis(order, reached.argmax(axis=1)[:, None], 1), 1)[:, 0])
