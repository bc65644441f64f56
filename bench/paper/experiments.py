"""The paper's experiments on simulated pushes: one seed gives every number of its tables and figures, in the paper's units.

Lengths in the results are in centimetres, as in the paper. The unit of force is the support friction of the translating
object.
"""

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import null_space

from bench.paper.pushes import BAD_PUSH, SLIPPING, motions, plan, watch
from bench.paper.sections import cross_section
from bench.paper.tables import PUBLISHED, Nested
from pushfric_core import TABLE_1, Estimate, Estimator, EstimatorConfig, HalfPlanes, Hypothesis, Loss, Observation, Recognizer
from pushfric_core.estimation.estimator import last
from pushfric_core.estimation.region import Region, line_of_motion
from pushfric_core.geometry.planar import Array, Wrench
from pushfric_core.geometry.support import Support, center_of_friction, support_forces
from pushfric_core.geometry.table_1 import FLAT, LOOKALIKES, ORIENTATIONS
from pushfric_core.mechanics.limit_surface import LimitSurface
from pushfric_core.program import contact_friction
from pushfric_core.program.constraints import Moment

CENTIMETRE = 100.0

PAPER = EstimatorConfig(cor_radius=0.0, screening=False)
"""Moment constraints, eq. 7 as a hard constraint, no contact uncertainty, no free supports (section 5)."""

GRIDS = {4: (2, 2), 9: (3, 3), 15: (5, 3), 24: (6, 4)}
"""Columns and rows of Figure 4."""

CENTERS = {name.removeprefix("delrin_rect_"): center for name, center in LOOKALIKES.items()}
"""Hypothesised centres of friction of the delrin rectangle [m] (section 5.2.1)."""

HALF_WIDTHS = (0, 2, 4, 6, 8)
"""Half-widths of the contact interval [mm] in Figures 9 and 10."""

CLEAR = 1e-6
"""All other orientations must fit worse than the true one by this [cm]; with wide contact intervals, several fit exactly."""

CASES = ("delrin_rect_center", "delrin_rect_right", "wood_rect3", "wood_rect4_all_data", "wood_rect4", "rubber_rect4")
"""The rows of Table 3; the first of wood_rect4 has the bad push."""

FITS = ("feet", "grid_15", "grid_15_nonnegative", "grid_15_linear_program")
"""The panels of Figure 13: least squares on the feet, on 15 points and with w >= 0, and the linear program."""

SUBSETS = (3, 5, 10, 15, 20, 30, 40, 60)
"""Numbers of observations in Figure 11."""

SAMPLINGS = 10


class Seed(NamedTuple):
    """All experiments with the camera noise and the operator's hand of one seed."""

    seed: int
    numbers: Nested  # as tables.json nests them
    data: dict[str, list[Observation]]  # of each object
    weights: dict[str, list["Weights"]]  # the panels of Figures 5, 6 and 13
    bounds: dict[str, Array]  # lower bounds on mu_c, by the row of Table 3
    regions: list[Region]  # where p_CF of delrin_rect_right can lie before the first push and after each


class Weights(NamedTuple):
    """A support friction distribution that a figure shows."""

    name: str  # of the object
    title: str
    points: Array  # (n, 2) object frame [m]
    w: Array  # (n,)

    def located(self) -> Nested:
        """Its p_CF."""
        return located(self.name, center_of_friction(self.points, self.w))

    def near_feet(self, distance: float) -> float:
        """How much of w lies within a distance [m] of a foot."""
        return float(self.w[self._at_feet(distance)].sum())

    def feet_are_largest(self) -> bool:
        """Whether the largest weights are exactly those of the feet."""
        feet = self._at_feet(1e-6)
        return bool(self.w[feet].min() > self.w[~feet].max())

    def _at_feet(self, distance: float) -> np.ndarray:
        """Mask (n,) of the points that lie within a distance [m] of a foot."""
        return np.linalg.norm(self.points[:, None] - TABLE_1[self.name].support.points, axis=2).min(axis=1) <= distance


def run_seed(seed: int) -> Seed:
    """All experiments of one seed."""
    moved = {name: motions(name, plan(name), seed) for name in TABLE_1}
    data = {name: watch(name, moved[name], seed) for name in TABLE_1}
    bad = watch("wood_rect4", moved["wood_rect4"], seed, bad_push=BAD_PUSH)
    slipping = watch("rubber_rect4", motions("rubber_rect4", SLIPPING, seed), seed)
    rng = np.random.default_rng((seed, len(TABLE_1)))
    fewer = _sample(data["delrin_square3"], _published("delrin_square3"), rng)
    table3, bounds = _contact_friction(data, bad, slipping)
    weights = _weights(data)
    regions = _regions(data["delrin_rect_right"])
    numbers: Nested = {
        "table1": {name: {"data_points": len(observations)} for name, observations in data.items()},
        "table2": {name: _grids(name, data[name]) for name in ("delrin_rect_center", "delrin_rect_right")},
        "table3": table3,
        "table4": _recognition("center", data, PAPER),
        "table5": _recognition("right", data, PAPER),
        "table4_default": _recognition("center", data, EstimatorConfig()),
        "table5_default": _recognition("right", data, EstimatorConfig()),
        "figure5": {one.name: _feet_found(one) for one in weights["figure5"]},
        "figure6": {"weight_within_1_cm": weights["figure6"][1].near_feet(0.01), **weights["figure6"][1].located()},
        "figure9": _orientation("wood_rect3", data["wood_rect3"]),
        "figure10": _orientation("delrin_square3", data["delrin_square3"]),
        "figure10_fewer_data_points": _orientation("delrin_square3", fewer),
        "figure11": _subsets(data["rubber_rect4"], rng),
        "figure13": {},
    }
    for case, one in zip(FITS, weights["figure13"], strict=True):
        numbers["figure13"][case] = {**one.located(), "w_min": float(one.w.min()), "w_max": float(one.w.max())}
    area = {"area_cm2": regions[-1].area * CENTIMETRE**2, "collapsed": regions[-1].area == 0}
    numbers["test_pushes"] = {**area, **located("delrin_rect_right", regions[-1].center)}
    return Seed(seed, numbers, data, weights, bounds, regions)


def estimate(observations: Iterable[Observation], points: Array, config: EstimatorConfig = PAPER) -> Estimate:
    """The estimate from all observations, over hypothesised support points (n, 2) [m]; taken one by one, none is judged."""
    estimator = Estimator(points, config)
    return [estimator.add(one) for one in observations][-1]


def located(name: str, center: Array) -> Nested:
    """An estimated p_CF (2,) [m], object frame, in cm, and its error in percent of the object's sides."""
    known = TABLE_1[name]
    x, y = (center * CENTIMETRE).tolist()
    percent_x, percent_y = (100 * np.abs(center - known.support.center_of_friction) / known.outline.size).tolist()
    return {"x": x, "y": y, "percent_x": percent_x, "percent_y": percent_y}


def _published(name: str) -> int:
    """The number of observations in Table 1 of the paper."""
    return int(PUBLISHED["paper"]["table1"][name]["data_points"])


def _grids(name: str, observations: list[Observation]) -> Nested:
    """Table 2: p_CF over the grids of Figure 4."""
    outline = TABLE_1[name].outline
    return {
        f"grid_{size}": located(name, estimate(observations, outline.grid(*grid)).center_of_friction)
        for size, grid in GRIDS.items()
    }


def _recognition(right: str, data: dict[str, list[Observation]], config: EstimatorConfig) -> Nested:
    """Tables 4 and 5: which centre of friction fits best. Errors are scaled to the paper's number of observations."""
    name = f"delrin_rect_{right}"
    observations = data[name]
    numbers: Nested = {}
    for size, grid in GRIDS.items():
        points = TABLE_1[name].outline.grid(*grid)
        errors = _fit_errors([Hypothesis(key, points, np.array(xy)) for key, xy in CENTERS.items()], observations, config)
        best = min(errors.values())
        numbers[f"grid_{size}"] = {
            **{f"error_{key}": error * (_published(name) / len(observations)) for key, error in errors.items()},
            **{f"ratio_{key}": error / best if error < math.inf else error for key, error in errors.items()},
            "correct": errors[right] < min(error for key, error in errors.items() if key != right),
        }
    return numbers


def _contact_friction(
    data: dict[str, list[Observation]], bad: list[Observation], slipping: list[Observation]
) -> tuple[Nested, dict[str, Array]]:
    """Table 3, and the bounds of the histograms of Figures 7 and 8.

    Args:
        data: of each object.
        bad: of wood_rect4 with the bad push.
        slipping: of rubber_rect4 in the test pushes; they are judged by the w of its other pushes.
    """
    known = {case: TABLE_1[case.removesuffix("_all_data")] for case in CASES}
    seen = data | {"wood_rect4_all_data": bad, "wood_rect4": [one for one in bad if one.push_id != BAD_PUSH]}
    points = {case: one.support_points if one.noise == FLAT else one.support.points for case, one in known.items()}
    fits = {case: estimate(seen[case], points[case]) for case in CASES}
    bounds = {case: fit.contact_friction for case, fit in fits.items()}
    numbers: Nested = {case: {"p90": fit.mu_c_p90, "p100": fit.mu_c_max} for case, fit in fits.items()}
    numbers["wood_rect4_all_data"]["bad_data_points"] = len(bad) - len(seen["wood_rect4"])
    forces = [contact_friction.contact_forces(one, support_forces(points["rubber_rect4"], one.twist)) for one in slipping]
    slipped = np.concatenate([contact_friction.lower_bounds(one, fits["rubber_rect4"].w) for one in forces])
    numbers["rubber_rect4_slipping"] = {"low": float(slipped.min()), "high": float(slipped.max()), "data_points": len(slipping)}
    return numbers, {**bounds, "rubber_rect4_slipping": slipped}


def _weights(data: dict[str, list[Observation]]) -> dict[str, list[Weights]]:
    """w over 15 points (Figure 5), over points none of which is a foot (Figure 6), and by least squares (Figure 13)."""
    square, wood, pushes = TABLE_1["delrin_square3"], TABLE_1["wood_rect4"], data["wood_rect4"]
    feet, points = wood.support.points, wood.support_points
    squares = EstimatorConfig(cor_radius=0.0, nonnegative_force=False, loss=Loss.L2)
    cases = [(feet, least_squares_fit(pushes, feet)), (points, least_squares_fit(pushes, points))]
    cases += [(points, estimate(pushes, points, squares).w), (points, estimate(pushes, points).w)]
    actual = Weights("delrin_square3", "Actual", square.support.points, square.support.weights)
    titled = zip(FITS, cases, strict=True)
    return {
        "figure5": [_fitted(name, data[name]) for name in ("wood_rect4", "rubber_rect4")],
        "figure6": [actual, _fitted("delrin_square3", data["delrin_square3"])._replace(title="Estimated")],
        "figure13": [Weights("wood_rect4", case.replace("_", " "), where, w) for case, (where, w) in titled],
    }


def _fitted(name: str, observations: list[Observation]) -> Weights:
    """w over the hypothesised support points of an object."""
    points = TABLE_1[name].support_points
    return Weights(name, name, points, estimate(observations, points).w)


def least_squares_fit(observations: Sequence[Observation], points: Array) -> Array:
    """The fit that the paper warns of: the w (n,) of sum 1 with the least squared moments, which may be negative (section 7).

    The paper weights the sum (eq. 11) heavily; here it holds exactly, which is the limit of that. If the observations do not
    determine w, this is the w nearest to uniform.

    Raises:
        UninformativePush: an observation rotates exactly about a support point.
    """
    pointlike = [replace(observation, half_width=0.0) for observation in observations]
    moments = np.concatenate([Moment().rows(one, support_forces(points, one.twist)).a for one in pointlike])
    uniform = np.full(len(points), 1 / len(points))
    within = null_space(uniform[None])  # the changes that keep the sum
    return np.asarray(uniform - within @ np.linalg.lstsq(moments @ within, moments @ uniform)[0])


def _feet_found(found: Weights) -> Nested:
    """Figure 5: whether the four largest of 15 weights are the feet."""
    return {
        "corners_are_top_four": found.feet_are_largest(),
        "weight_at_corners": found.near_feet(1e-6),
        "nonzero_weights": int((found.w > 1e-6).sum()),
        **found.located(),
    }


def _orientation(name: str, observations: list[Observation]) -> Nested:
    """Figures 9 and 10: the fit errors of an object's orientations for each half-width of the contact interval."""
    feet, center = TABLE_1[name].support.points, TABLE_1[name].support.center_of_friction
    numbers: Nested = {}
    for case, known in (("supports", None), ("supports_and_center", center)):
        hypotheses = [Hypothesis(str(turn), feet, known).turned(math.radians(turn), (0.0, 0.0)) for turn in ORIENTATIONS[name]]
        numbers[case] = {}
        for half_width in HALF_WIDTHS:
            errors = _fit_errors(hypotheses, observations, replace(PAPER, half_width=half_width / 1e3))
            others = min(error for turn, error in errors.items() if turn != "0")
            numbers[case][f"half_width_{half_width}_mm"] = {
                **{f"error_{turn}": error for turn, error in errors.items()},
                "correct": errors["0"] + CLEAR < others,
            }
    return numbers


def _fit_errors(
    hypotheses: Sequence[Hypothesis], observations: Iterable[Observation], config: EstimatorConfig
) -> dict[str, float]:
    """The fit error of each hypothesis [cm], by name; infinite if no w satisfies its hard constraints."""
    recognizer = Recognizer(hypotheses, config)
    ranking = last(map(recognizer.add, observations))
    errors = {one.name: one.fit_error * CENTIMETRE for one in ranking.hypotheses}
    return {hypothesis.name: errors[hypothesis.name] for hypothesis in hypotheses}


def _sample(observations: list[Observation], size: int, rng: np.random.Generator) -> list[Observation]:
    """A random sample of this many observations, or all of them if there are fewer."""
    return [observations[i] for i in rng.choice(len(observations), min(size, len(observations)), replace=False)]


def _subsets(observations: list[Observation], rng: np.random.Generator) -> Nested:
    """Figure 11: the mean error of p_CF over random samplings of the observations of rubber_rect4."""
    numbers = {}
    for size in SUBSETS:
        results = [_fitted("rubber_rect4", _sample(observations, size, rng)) for _ in range(SAMPLINGS)]
        errors = [result.located() for result in results]
        numbers[f"points_{size}"] = {
            **{axis: float(np.mean([error[axis] for error in errors])) for axis in ("percent_x", "percent_y")},
            "share_with_correct_supports": float(np.mean([result.feet_are_largest() for result in results])),
        }
    return numbers


def _regions(observations: list[Observation]) -> list[Region]:
    """Section 6.2: where p_CF can lie, at first and after each push, without support points."""
    half_planes = HalfPlanes(TABLE_1["delrin_rect_right"].outline)
    regions = [half_planes.region()]
    for _, push in itertools.groupby(observations, lambda one: one.push_id):
        regions.append([half_planes.add(line_of_motion(one)) for one in push][-1])
    return regions


def rods() -> tuple[Nested, list[tuple[Array, Array]]]:
    """Figure 12: two rods of length 2 that frictionless pushes along them cannot distinguish. Nothing in it is random.

    Returns:
        Numbers, and of each rod f_y and moment (k, 2) on its limit surface, and those (m, 2) that such pushes reach.
    """
    ends = np.array(((-1.0, 0.0), (1.0, 0.0)))
    first, second = Support(ends, np.full(2, 1 / 2)), Support(np.vstack((ends, (0.0, 0.0))), np.full(3, 1 / 3))
    contacts = np.column_stack((np.linspace(-1, 1, 201), np.zeros(201)))
    normals = np.tile((0.0, -1.0), (len(contacts), 1))
    drawn = []
    for support in (first, second):
        surface = LimitSurface(support)
        section = cross_section(surface, Wrench(0.0, 1.0, 0.0), Wrench(0.0, 0.0, 1.0))
        drawn.append((section, surface.reachable(contacts, normals, 0.0).wrenches[:, 0, 1:]))
    return {"largest_difference_of_reachable_wrenches": float(np.abs(drawn[0][1] - drawn[1][1]).max())}, drawn
