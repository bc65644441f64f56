"""The paper's experiments on simulated pushes: one seed gives every number of its tables and figures, in the paper's units.

Lengths in the results are in centimetres, as in the paper. The unit of force is the support friction of the translating
object. The experiments need nothing but pushfric_core, so that they can run on other machines.
"""

import hashlib
import math
import pathlib
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

import pushfric_core
from pushfric_core.estimation.estimate import Estimate
from pushfric_core.estimation.estimator import Estimator, EstimatorConfig
from pushfric_core.estimation.push_plan import SHARP, PlannedPush, even_pushes, placement
from pushfric_core.estimation.recognition import Hypothesis, Recognizer
from pushfric_core.estimation.region import HalfPlanes, line_of_motion
from pushfric_core.geometry.contact import PushingLine
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array, Pose, Wrench, wrap
from pushfric_core.geometry.support import Support, center_of_friction, support_forces
from pushfric_core.geometry.table_1 import LOOKALIKES, ORIENTATIONS, TABLE_1, PoseNoise
from pushfric_core.mechanics.limit_surface import LimitSurface, Measurement, separation
from pushfric_core.mechanics.simulation import PushedObject
from pushfric_core.program.least_squares import least_squares_fit
from pushfric_core.solvers.program import Loss
from pushfric_core.trajectories.observation import Observation
from pushfric_core.trajectories.trajectory import PoseSample, PusherSample, Trajectory
from pushfric_core.uncertainty import contact_friction

Mask = npt.NDArray[np.bool_]

Numbers = dict[str, Any]
"""A nested dictionary whose leaves are numbers and truth values."""

CENTIMETRE = 100.0

PAPER = EstimatorConfig(cor_radius=0.0, confidence=False, screening=False)
"""Moment constraints, eq. 7 as a hard constraint, no contact uncertainty, no free supports (section 5)."""

LINE = PushingLine((0.0, 0.0), (0.0, 1.0), 0.003)
SPEED = 0.02  # [m/s]
STROKE = 0.05  # [m]
FRAME_RATE = 14.0  # [Hz]

PLACEMENT = 0.001
"""Standard deviation of the operator's placement of the object [m]; divided by 2 cm, that of its angle [rad]."""


class Conduct(NamedTuple):
    """Details of the pushes that the paper leaves out; chosen so that the numbers as a whole match the reference."""

    closer: float = 1.0  # contacts lie at this fraction of their evenly spaced distance from the middle of the edge
    longest_turn: float = math.inf  # a push ends early once the object has turned this far [rad]


CONDUCT = {
    # an object pushed nearer to its corners turns about one of its feet, and the data say nothing about that foot's force
    "delrin_square3": Conduct(closer=0.8),
    "wood_rect3": Conduct(closer=0.88),
    "wood_rect4": Conduct(closer=0.88),
    "rubber_rect4": Conduct(closer=0.88),
    # "tended to rotate quickly, resulting in fewer useful observations" (section 5)
    "delrin_rect_center": Conduct(longest_turn=math.radians(25)),
    "delrin_rect_right": Conduct(longest_turn=math.radians(25)),
}

GRIDS = {4: (2, 2), 9: (3, 3), 15: (5, 3), 24: (6, 4)}
"""Columns and rows of Figure 4."""

CENTERS = {name.removeprefix("delrin_rect_"): center for name, center in LOOKALIKES.items()}
"""Hypothesised centres of friction of the delrin rectangle [m] (section 5.2.1)."""

HALF_WIDTHS = (0, 2, 4, 6, 8)
"""Half-widths of the contact interval [mm] in Figures 9 and 10."""

CLEAR = 1e-6
"""All other orientations must fit worse than the true one by this [cm]; with wide contact intervals, several fit exactly."""

PUBLISHED = {"delrin_square3": 85, "delrin_rect_center": 36, "delrin_rect_right": 32}
"""Numbers of observations in Table 1."""

SUBSETS = (3, 5, 10, 15, 20, 30, 40, 60)
"""Numbers of observations in Figure 11."""

SAMPLINGS = 10

VISION_ERROR = (0.008, -0.002)
"""In the middle third of one push of wood_rect4, the object seems to jump by this [m], table frame: sideways and to the tip.

This causes the distant outlier of Table 3 and Figure 7.
"""

BAD_PUSH = 3
"""The push with that error: the middle one of the first edge."""

SLIPPING = [PlannedPush(edge, side * 0.015, side * SHARP) for edge in (0, 2) for side in (-1, 1)]
"""Test pushes of rubber_rect4 at sharp angles, in which the contact slips all the time (section 5.1.3)."""

SOURCES = [pathlib.Path(__file__), *sorted(pathlib.Path(pushfric_core.__path__[0]).rglob("*.py"))]

CODE = hashlib.sha256(b"\0".join(source.read_bytes() for source in SOURCES)).hexdigest()[:16]
"""A fingerprint of all code that affects the numbers, as it was imported."""

Frames = list[tuple[float, Pose]]
"""Stroke position [m] and true pose of the object in each frame of a push."""


def run_seed(seed: int) -> dict[str, Any]:
    """All experiments with the camera noise and the operator's hand of one seed.

    Returns:
        A dictionary of `seed`; `code`, the fingerprint; `numbers`, nested; `drawings`, what the figures show of this seed; and
        `data`, the observations of each object as `observation_row` lists them.
    """
    moved = {name: motions(name, plan(name), seed) for name in TABLE_1}
    data = {name: watch(name, moved[name], seed) for name in TABLE_1}
    bad = watch("wood_rect4", moved["wood_rect4"], seed, bad_push=BAD_PUSH)
    slipping = watch("rubber_rect4", motions("rubber_rect4", SLIPPING, seed), seed)
    rng = np.random.default_rng((seed, len(TABLE_1)))
    numbers: Numbers = {
        "table1": {name: {"data_points": len(observations)} for name, observations in data.items()},
        "table2": {name: _grids(name, data[name]) for name in ("delrin_rect_center", "delrin_rect_right")},
        "table4": _recognition("center", data["delrin_rect_center"], PAPER),
        "table5": _recognition("right", data["delrin_rect_right"], PAPER),
        "table4_default": _recognition("center", data["delrin_rect_center"], EstimatorConfig()),
        "table5_default": _recognition("right", data["delrin_rect_right"], EstimatorConfig()),
    }
    drawings: dict[str, Any] = {}
    numbers["table3"], drawings["bounds"] = _contact_friction(data, bad, slipping)
    numbers["figure5"], drawings["figure5"] = _support_friction(data)
    numbers["figure6"], drawings["figure6"] = _feet_off_the_grid(data["delrin_square3"])
    numbers["figure9"] = _orientation("wood_rect3", data["wood_rect3"])
    numbers["figure10"] = _orientation("delrin_square3", data["delrin_square3"])
    fewer = _sample(data["delrin_square3"], PUBLISHED["delrin_square3"], rng)
    numbers["figure10_fewer_data_points"] = _orientation("delrin_square3", fewer)
    numbers["figure11"] = _subsets(data["rubber_rect4"], rng)
    numbers["figure13"], drawings["figure13"] = _least_squares(data["wood_rect4"])
    numbers["test_pushes"], drawings["test_pushes"] = _test_pushes(data["delrin_rect_right"])
    rows = {name: [observation_row(observation) for observation in observations] for name, observations in data.items()}
    return {"seed": seed, "code": CODE, "numbers": numbers, "drawings": drawings, "data": rows}


def plan(name: str) -> list[PlannedPush]:
    """The pushes of an object of Table 1: along each edge as many as in section 5, perpendicular to the edge."""
    known = TABLE_1[name]
    closer = CONDUCT[name].closer
    return [push._replace(offset=push.offset * closer) for push in even_pushes(known.outline, known.pushes)]


def motions(name: str, pushes: Sequence[PlannedPush], seed: int) -> list[Frames]:
    """The true motion in each push of an object of Table 1.

    Args:
        name: of the object.
        pushes: where it is pushed.
        seed: of the operator's hand; the same seed gives the same motions.
    """
    known, rng = TABLE_1[name], np.random.default_rng((seed, list(TABLE_1).index(name), 0))
    turn = CONDUCT[name].longest_turn
    errors = (rng.normal(0.0, PLACEMENT, 3) for _ in pushes)
    return [
        motion(known.outline, known.support, known.mu_c, push, error, turn) for push, error in zip(pushes, errors, strict=True)
    ]


def motion(outline: Outline, support: Support, mu_c: float, push: PlannedPush, error: Array, longest_turn: float) -> Frames:
    """The motion from where the operator put the object to the end of the stroke, or until it has turned too far.

    Args:
        outline: of the object.
        support: of the object.
        mu_c: contact friction coefficient.
        push: where it is pushed.
        error: (3,) of the placement, as `PLACEMENT` is its standard deviation [m]; the third turns the object.
        longest_turn: it turns no further [rad].
    """
    x, y, theta = placement(outline, push, LINE, 0.0)
    dx, dy, turn = error.tolist()
    start = Pose(x + dx, y + dy, theta + turn / 0.02)
    pushed = PushedObject(outline, support, mu_c, start)
    frames: Frames = []
    for frame in range(int(STROKE / SPEED * FRAME_RATE) + 1):
        position = frame / FRAME_RATE * SPEED
        pushed.push(LINE, position)
        if abs(wrap(pushed.pose.theta - start.theta)) > longest_turn:
            break
        frames.append((position, pushed.pose))
    return frames


def watch(name: str, moved: Sequence[Frames], seed: int, bad_push: int | None = None) -> list[Observation]:
    """The observations of a pushed object as the paper's camera sees it.

    Args:
        name: of the object.
        moved: the true motion in each push, from `motions`.
        seed: of the camera's noise; the same seed gives the same noise.
        bad_push: index of the push in which the camera errs by `VISION_ERROR` from some moment in its middle third on; None: it
            errs in none.
    """
    known, number, pushes = TABLE_1[name], list(TABLE_1).index(name), [*moved]
    if bad_push is not None:
        frames, (x, y) = pushes[bad_push], VISION_ERROR
        moment = np.random.default_rng((seed, number, 3)).uniform(1 / 3, 2 / 3) * len(frames)
        pushes[bad_push] = [
            (position, pose._replace(x=pose.x + x, y=pose.y + y) if frame >= moment else pose)
            for frame, (position, pose) in enumerate(frames)
        ]
    return filmed(known.outline, pushes, known.noise, np.random.default_rng((seed, number, 1)))


def filmed(
    outline: Outline, pushes: Sequence[Frames], noise: PoseNoise, rng: np.random.Generator, first: int = 0
) -> list[Observation]:
    """The observations that a camera with this noise makes of pushes, numbered from `first` on."""
    trajectory = Trajectory(outline)
    observations = []
    for push_id, frames in enumerate(pushes, first):
        for frame, (position, pose) in enumerate(frames):
            stamp = round((3600 * push_id + frame / FRAME_RATE) * 1e9)
            seen = np.asarray(pose) + rng.normal(0.0, 1.0, 3) * (noise.position, noise.position, noise.angle)
            observations += trajectory.add_pusher(PusherSample(stamp, position, SPEED, LINE, push_id))
            observations += trajectory.add_pose(PoseSample(stamp, Pose(*seen.tolist())))
    return observations


def observation_row(observation: Observation) -> list[float]:
    """Contact [m], normal, twist [m/s, rad/s] (object frame), push and pose [m, rad] (table frame) as plain numbers."""
    assert observation.pose is not None
    o = observation
    return [*o.contact_point, *o.contact_normal, *o.twist, o.push_id, *observation.pose]


def estimate(
    observations: Iterable[Observation], points: Array, config: EstimatorConfig = PAPER, center: npt.ArrayLike | None = None
) -> Estimate:
    """The estimate from all observations, over hypothesised support points (n, 2) [m]."""
    return Estimator(points, config, center).add(observations)


def located(name: str, center: Array) -> Numbers:
    """An estimated p_CF (2,) [m], object frame, in cm, and its error in percent of the object's sides."""
    known = TABLE_1[name]
    x, y = (center * CENTIMETRE).tolist()
    percent_x, percent_y = (100 * np.abs(center - known.support.center_of_friction) / known.outline.size).tolist()
    return {"x": x, "y": y, "percent_x": percent_x, "percent_y": percent_y}


def _grids(name: str, observations: list[Observation]) -> Numbers:
    """Table 2: p_CF over the grids of Figure 4."""
    outline = TABLE_1[name].outline
    return {
        f"grid_{size}": located(name, estimate(observations, outline.grid(*grid)).center_of_friction)
        for size, grid in GRIDS.items()
    }


def _recognition(truth: str, observations: list[Observation], config: EstimatorConfig) -> Numbers:
    """Tables 4 and 5: which centre of friction fits best. Errors are scaled to the paper's number of observations."""
    name = f"delrin_rect_{truth}"
    scale = PUBLISHED[name] / len(observations)
    numbers: Numbers = {}
    for size, grid in GRIDS.items():
        points = TABLE_1[name].outline.grid(*grid)
        hypotheses = [Hypothesis(center, points, np.array(xy)) for center, xy in CENTERS.items()]
        errors = _fit_errors(hypotheses, observations, config)
        best = min(errors.values())
        numbers[f"grid_{size}"] = {
            **{f"error_{center}": error * scale for center, error in errors.items()},
            **{f"ratio_{center}": error / best if error < math.inf else error for center, error in errors.items()},
            "correct": errors[truth] < min(error for center, error in errors.items() if center != truth),
        }
    return numbers


def _contact_friction(
    data: dict[str, list[Observation]], bad: list[Observation], slipping: list[Observation]
) -> tuple[Numbers, dict[str, list[float]]]:
    """Table 3 and the histograms of Figures 7 and 8."""
    cases = {
        "delrin_rect_center": (data["delrin_rect_center"], TABLE_1["delrin_rect_center"].support_points),
        "delrin_rect_right": (data["delrin_rect_right"], TABLE_1["delrin_rect_right"].support_points),
        "wood_rect3": (data["wood_rect3"], TABLE_1["wood_rect3"].support.points),
        "wood_rect4_all_data": (bad, TABLE_1["wood_rect4"].support.points),
        "wood_rect4": ([one for one in bad if one.push_id != BAD_PUSH], TABLE_1["wood_rect4"].support.points),
        "rubber_rect4": (data["rubber_rect4"], TABLE_1["rubber_rect4"].support.points),
    }
    numbers: Numbers = {}
    bounds: dict[str, Array] = {}
    for case, (observations, points) in cases.items():
        result = estimate(observations, points)
        bounds[case] = result.contact_friction
        numbers[case] = {"p90": result.mu_c_p90, "p100": result.mu_c_max}
    numbers["wood_rect4_all_data"]["bad_data_points"] = len(bad) - len(cases["wood_rect4"][0])
    # the last estimate is that of rubber_rect4; the test pushes use its w
    bounds["rubber_rect4_slipping"] = np.concatenate(
        [
            contact_friction.lower_bounds(
                contact_friction.contact_forces(one, support_forces(result.support_points, one.twist)), result.w
            )
            for one in slipping
        ]
    )
    low, high = bounds["rubber_rect4_slipping"].min(), bounds["rubber_rect4_slipping"].max()
    numbers["rubber_rect4_slipping"] = {"low": float(low), "high": float(high), "data_points": len(slipping)}
    return numbers, {case: values.tolist() for case, values in bounds.items()}


def _support_friction(data: dict[str, list[Observation]]) -> tuple[Numbers, dict[str, list[float]]]:
    """Figure 5: w over 15 points; the feet are at the four corners."""
    numbers: Numbers = {}
    drawn = {}
    for name in ("wood_rect4", "rubber_rect4"):
        result = estimate(data[name], TABLE_1[name].support_points)
        feet = _at_feet(name, 1e-6)
        numbers[name] = {
            "corners_are_top_four": _largest_are(result.w, feet),
            "weight_at_corners": float(result.w[feet].sum()),
            "nonzero_weights": int((result.w > 1e-6).sum()),
            **located(name, result.center_of_friction),
        }
        drawn[name] = result.w.tolist()
    return numbers, drawn


def _at_feet(name: str, distance: float) -> Mask:
    """Mask (n,) of the hypothesised support points that lie within a distance [m] of a foot."""
    known = TABLE_1[name]
    between = np.linalg.norm(known.support_points[:, None] - known.support.points, axis=2)
    return np.asarray(between.min(axis=1) <= distance, dtype=bool)


def _largest_are(w: Array, which: Mask) -> bool:
    """Whether the largest weights are exactly those that the mask `which` selects."""
    return bool(w[which].min() > w[~which].max())


def _feet_off_the_grid(observations: list[Observation]) -> tuple[Numbers, list[float]]:
    """Figure 6: w over 6 x 6 points, none of which is a foot."""
    result = estimate(observations, TABLE_1["delrin_square3"].support_points)
    near = float(result.w[_at_feet("delrin_square3", 0.01)].sum())
    numbers = {"weight_within_1_cm": near, **located("delrin_square3", result.center_of_friction)}
    return numbers, result.w.tolist()


def _orientation(name: str, observations: list[Observation]) -> Numbers:
    """Figures 9 and 10: the fit errors of an object's orientations for each half-width of the contact interval."""
    feet, center = TABLE_1[name].support.points, TABLE_1[name].support.center_of_friction
    numbers: Numbers = {}
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
    for observation in observations:
        ranking = recognizer.add(observation)
    errors = {one.name: one.fit_error * CENTIMETRE for one in ranking.hypotheses}
    return {hypothesis.name: errors[hypothesis.name] for hypothesis in hypotheses}


def _sample(observations: list[Observation], size: int, rng: np.random.Generator) -> list[Observation]:
    """A random sample of this many observations, or all of them if there are fewer."""
    chosen = rng.choice(len(observations), min(size, len(observations)), replace=False)
    return [observations[i] for i in chosen]


def _subsets(observations: list[Observation], rng: np.random.Generator) -> Numbers:
    """Figure 11: the mean error of p_CF over random samplings of the observations of rubber_rect4."""
    points, feet = TABLE_1["rubber_rect4"].support_points, _at_feet("rubber_rect4", 1e-6)
    numbers = {}
    for size in SUBSETS:
        results = [estimate(_sample(observations, size, rng), points) for _ in range(SAMPLINGS)]
        errors = [located("rubber_rect4", result.center_of_friction) for result in results]
        numbers[f"points_{size}"] = {
            **{axis: float(np.mean([error[axis] for error in errors])) for axis in ("percent_x", "percent_y")},
            "share_with_correct_supports": float(np.mean([_largest_are(result.w, feet) for result in results])),
        }
    return numbers


def _least_squares(observations: list[Observation]) -> tuple[Numbers, dict[str, list[float]]]:
    """Figure 13 and section 7: unconstrained least squares, the linear program, and least squares with w >= 0."""
    known = TABLE_1["wood_rect4"]
    feet, points = known.support.points, known.support_points
    on_feet, on_grid = least_squares_fit(observations, feet), least_squares_fit(observations, points)
    squares = EstimatorConfig(cor_radius=0.0, nonnegative_force=False, loss=Loss.L2, confidence=False)
    weights = {
        "feet": (on_feet.w, feet),
        "grid_15": (on_grid.w, points),
        "grid_15_nonnegative": (estimate(observations, points, squares).w, points),
        "grid_15_linear_program": (estimate(observations, points).w, points),
    }
    numbers = {
        case: {
            **located("wood_rect4", center_of_friction(where, w)),
            "w_min": float(w.min()),
            "w_max": float(w.max()),
        }
        for case, (w, where) in weights.items()
    }
    return numbers, {case: w.tolist() for case, (w, _) in weights.items()}


def _test_pushes(observations: list[Observation]) -> tuple[Numbers, dict[str, list[Any]]]:
    """Section 6.2: the half-planes of delrin_rect_right, one push after another, without support points."""
    known = TABLE_1["delrin_rect_right"]
    half_planes = HalfPlanes(known.outline)
    region = half_planes.region()
    regions = [np.asarray(region.polygon.exterior.coords).tolist()]
    for push in range(1 + max(observation.push_id for observation in observations)):
        for observation in observations:
            if observation.push_id == push:
                region = half_planes.add(line_of_motion(observation))
        regions.append(np.asarray(region.polygon.exterior.coords).tolist())
    numbers = {
        "area_cm2": region.area * CENTIMETRE**2,
        "collapsed": region.area == 0,
        **located("delrin_rect_right", region.center),
    }
    return numbers, {"regions": regions, "center": region.center.tolist()}


def rods() -> tuple[Numbers, dict[str, Any]]:
    """Figure 12: two rods that frictionless pushes along their length cannot distinguish. Nothing in it is random.

    The rods have length 2. The numbers also say how well a pusher with friction could distinguish them.

    Returns:
        The numbers, and for each rod the section and the reachable wrenches that the figure shows.
    """
    ends = np.array(((-1.0, 0.0), (1.0, 0.0)))
    supports = {
        "two_supports": Support(ends, np.full(2, 1 / 2)),
        "three_supports": Support(np.vstack((ends, (0.0, 0.0))), np.full(3, 1 / 3)),
    }
    contacts = np.column_stack((np.linspace(-1, 1, 201), np.zeros(201)))
    normals = np.tile((0.0, -1.0), (len(contacts), 1))
    drawings, reached = {}, {}
    for name, support in supports.items():
        surface = LimitSurface(support)
        section = surface.cross_section(Wrench(0.0, 1.0, 0.0), Wrench(0.0, 0.0, 1.0))
        reached[name] = surface.reachable(contacts, normals, 0.0).wrenches[:, 0, 1:]
        drawings[name] = {"section": section.points.tolist(), "reachable": reached[name].tolist()}
    first, second = supports.values()
    measurement = Measurement(0.01, 1e-4, 1e-3)
    return {
        "largest_difference_of_reachable_wrenches": float(np.abs(reached["two_supports"] - reached["three_supports"]).max()),
        "deviations_without_friction": separation(first, second, contacts, normals, 0.0, measurement).deviations,
        "deviations_with_mu_c_1": separation(first, second, contacts, normals, 1.0, measurement).deviations,
    }, drawings
