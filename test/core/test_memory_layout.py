"""The core's answers depend on the numbers that it is given, not on how they lie in memory or how NumPy computes with them."""

import dataclasses
import enum
import inspect
import os
import pathlib
import subprocess
import sys
import typing
from collections.abc import Sequence
from functools import partial

import numpy as np
import numpy.typing as npt
import pytest
import shapely

import pushfric_core
from pushfric_core.estimation import region
from pushfric_core.geometry import support
from pushfric_core.geometry.planar import Array, Pose, Twist, Wrench
from pushfric_core.mechanics import prediction

CORE = pathlib.Path(__file__).parent
RNG = np.random.default_rng(11)
K, N, S = 40, 13, 5
"""Numbers of pushes, support points and samples: enough to fill NumPy's vectors, and not a multiple of them."""

TURN = np.sort(RNG.uniform(0, 2 * np.pi, 9))
CORNERS = 0.06 * np.column_stack((np.cos(TURN), 0.7 * np.sin(TURN)))
OUTLINE = pushfric_core.Outline(CORNERS)
POINTS = RNG.uniform(-0.04, 0.04, (N, 2))
W = RNG.dirichlet(np.ones(N), S)
MU_C = RNG.uniform(0.1, 0.9, S)
SHARE = np.full(S, 1 / S)
SUPPORT = pushfric_core.Support(POINTS, W[0])
MODEL = pushfric_core.FrictionModel(POINTS, W, MU_C, SHARE)
EDGES = RNG.integers(len(CORNERS), size=K)
CONTACTS = OUTLINE.vertices[EDGES] + RNG.uniform(0.1, 0.9, (K, 1)) * OUTLINE.edges[EDGES]
NORMALS = OUTLINE.normals[EDGES]
VELOCITIES = -0.02 * NORMALS + RNG.uniform(-0.01, 0.01, (K, 2))
TWISTS, HALVES = RNG.uniform(-1, 1, (K, 3)), RNG.uniform(0, 0.03, K)
COVARIANCE = np.array(((2e-6, 1e-7), (1e-7, 1e-6)))
CENTERS, TURNS = RNG.uniform(-0.3, 0.3, (K, 2)), RNG.choice((-1.0, 1.0), K)
TWIST, WRENCH = Twist(0.01, 0.02, 0.3), Wrench(0.3, 0.5, 0.01)
OBSERVATION = pushfric_core.Observation(CONTACTS[0], NORMALS[0], TWIST, force=(0.1, 0.3), tip_velocity=(0.01, 0.02))
OBSERVATIONS = [
    pushfric_core.Observation(*row, Twist(*twist), number)
    for number, (*row, twist) in enumerate(
        zip(CONTACTS, NORMALS, pushfric_core.predict(MODEL, CONTACTS, NORMALS, VELOCITIES).twists, strict=True)
    )
]
FORCES = support.support_forces(POINTS, TWIST, support.FreeRadii(0.01, 0.05))
LINES = [pushfric_core.PushingLine(tuple(0.3 * normal), tuple(-normal), 0.003) for normal in NORMALS[:6]]
SURFACE = pushfric_core.LimitSurface(SUPPORT)


def estimate(points=POINTS, center=None):
    estimator = pushfric_core.Estimator(points, pushfric_core.EstimatorConfig(nonnegative_force=False), center)
    for observation in OBSERVATIONS:
        last = estimator.add(observation)
    return last


def outline(vertices):
    made = pushfric_core.Outline(vertices)
    return made, made.edges, made.lengths, made.normals, made.grid(5, 4), made.polygon


def known_support(points, weights):
    made = pushfric_core.Support(points, weights)
    bearing = pushfric_core.LimitSurface(made)
    return made, made.center_of_friction, made.friction_wrench(TWIST), bearing.wrench(TWIST), bearing.facets


def model(support_points, w, mu_c, share, covariance):
    made = pushfric_core.FrictionModel(support_points, w, mu_c, share, 0.1, covariance=covariance)
    moved = pushfric_core.predict(made, CONTACTS, NORMALS, VELOCITIES)
    return made, made.support, made.with_mean, made.length, made.confidence, moved


def pushed(point, normal, velocity):
    return pushfric_core.pushed_motion(SUPPORT, pushfric_core.Touch(0.0, point, normal, None), velocity, 0.3)


def ranking(support_points, center):
    any_center = pushfric_core.Hypothesis("any centre", support_points)
    recognizer = pushfric_core.Recognizer([any_center, pushfric_core.Hypothesis("other", support_points, center)])
    return [recognizer.add(observation) for observation in OBSERVATIONS[:8]]


def line(origin, direction):
    made = pushfric_core.PushingLine(origin, direction, 0.003)
    pushed_object = pushfric_core.PushedObject(OUTLINE, SUPPORT, 0.3, Pose(0.01, 0.0, 0.1))
    return made.touch(OUTLINE, Pose(0.01, 0.0, 0.1)), pushed_object.push(made, 0.28), pushed_object.pose


def observation(contact_point, contact_normal, force, tip_velocity):
    return pushfric_core.Observation(contact_point, contact_normal, TWIST, force=force, tip_velocity=tip_velocity)


def functional(functional, directions, free):
    forces = pushfric_core.SupportForces(POINTS, directions, free)
    return [pushfric_core.functional_rows(functional, forces, *costs) for costs in ((1.0, 1.0), (1.0, 0.0), (0.0, np.inf))]


class Own(pushfric_core.Constraint):
    """A term whose rows lie in memory as they are given."""

    def __init__(self, a):
        self.a = a

    def rows(self, observation, forces):
        return pushfric_core.ConstraintRows(self.a, np.ones(len(self.a)), np.zeros(len(self.a)))


def own_rows(a):
    config = pushfric_core.EstimatorConfig(terms=("moment", Own(np.asarray(a))))
    return pushfric_core.Estimator(POINTS, config).add(OBSERVATION)


def half_planes(normal):
    narrowed = pushfric_core.HalfPlanes(OUTLINE, 0.001)
    found = narrowed.add([region.HalfPlane(normal, 0.001)])
    pushes = pushfric_core.next_pushes(narrowed)
    return found.polygon, found.center, pushes, narrowed.add([region.HalfPlane(normal, 1.0)]).center


STARTS = {"starts": 0.3 * NORMALS, "directions": -NORMALS, "radii": HALVES}
CONTACT = {"contact_points": CONTACTS, "contact_normals": NORMALS}

ROWS = {
    "ConstraintRows": (own_rows, {"a": RNG.normal(size=(3, N))}),
    "functional_rows": (functional, {"functional": POINTS, "directions": FORCES.directions, "free": FORCES.free}),
    "PushingLine": (line, {"origin": (0.3, 0.01), "direction": np.array((-0.8, 0.6)) @ ((0.8, -0.6), (0.6, 0.8))}),
    "believe": (lambda points: pushfric_core.believe(points, OBSERVATIONS[:8]), {"points": POINTS}),
    "Estimator": (estimate, {"points": POINTS, "center": POINTS.mean(axis=0)}),
    "LimitSurface.twist": (SURFACE.twist, {"wrench": WRENCH}),
    "LimitSurface.twists": (SURFACE.twists, {"wrenches": np.outer((1.0, -0.5), WRENCH)}),
    "LimitSurface.load": (SURFACE.load, {"wrench": WRENCH}),
    "LimitSurface.reachable": (lambda **given: SURFACE.reachable(**given, mu_c=0.3), CONTACT),
    "Observation": (
        observation,
        {"contact_point": CONTACTS[0], "contact_normal": NORMALS[0], "force": (0.1, 0.2), "tip_velocity": VELOCITIES[0]},
    ),
    "Outline": (outline, {"vertices": CORNERS[::-1]}),
    "Outline.contains": (OUTLINE.contains, {"points": CENTERS / 3}),
    "Outline.distance_to": (OUTLINE.distance_to, {"point": CENTERS[0]}),
    "Outline.distances_to": (OUTLINE.distances_to, {"points": CENTERS}),
    "Outline.nearest": (OUTLINE.nearest, {"point": CENTERS[0]}),
    "Outline.outward": (lambda **given: OUTLINE.outward(**given, within=0.01), {"points": CONTACTS, "normals": NORMALS}),
    "Outline.first_touch": (OUTLINE.first_touch, {"start": 0.3 * NORMALS[0], "direction": -NORMALS[0]}),
    "Outline.first_touches": (OUTLINE.first_touches, STARTS),
    "FrictionModel": (model, {"support_points": POINTS, "w": W, "mu_c": MU_C, "share": SHARE, "covariance": COVARIANCE}),
    "FrictionModel.centered": (MODEL.centered, {"twists": TWISTS}),
    "FrictionModel.angles": (MODEL.angles, {"twists": TWISTS, "others": RNG.normal(size=(K, 3))}),
    "predict": (lambda **given: prediction.predict(MODEL, **given), CONTACT | {"tip_velocities": VELOCITIES}),
    "motion_cone": (lambda **given: prediction.motion_cone(MODEL, **given), CONTACT),
    "stability": (
        lambda **given: prediction.stability(MODEL, **given),
        CONTACT | {"half_widths": HALVES, "centers": CENTERS, "turns": TURNS},
    ),
    "HalfPlanes": (half_planes, {"normal": (0.6, 0.8)}),
    "slip_pushes": (partial(pushfric_core.slip_pushes, OUTLINE), {"center": (0.01, -0.005)}),
    "Hypothesis": (ranking, {"support_points": POINTS, "center": POINTS.mean(axis=0)}),
    "Hypothesis.turned": (
        lambda points, center, pivot: pushfric_core.Hypothesis("", points, center).turned(0.3, pivot),
        {"points": POINTS, "center": (0.01, 0.02), "pivot": (0.03, 0.01)},
    ),
    "pushed_motion": (pushed, {"point": CONTACTS[0], "normal": NORMALS[0], "velocity": VELOCITIES[0]}),
    "predict_strokes": (
        lambda poses, positions: pushfric_core.predict_strokes(MODEL, OUTLINE, poses, LINES, positions, 0.01),
        {"poses": RNG.uniform(-0.01, 0.01, (6, 3)), "positions": np.full(6, 0.27)},
    ),
    "Support": (known_support, {"points": POINTS, "weights": W[0]}),
    "NamedEllipsoid": (lambda center: pushfric_core.NamedEllipsoid(1.0, 0.03, center).form, {"center": (0.01, 0.02)}),
}
"""For each function that takes arrays: what calls it, and the arrays."""

RESULTS = {"Estimate", "Optimum", "Predictions", "Region", "Stability", "Strokes"}
"""Records that the core makes and nobody else."""

ELSEWHERE = {
    "Touch": "pushed_motion",
    "SupportForces": "functional_rows",
    "Constraint.rows": "ConstraintRows",
    "HalfPlanes.add": "HalfPlanes",
    "LimitSurface.wrench": "Support",
    "Support.friction_wrench": "Support",
    "PushingLine.touch": "PushingLine",
}
"""What is called in the row of another name."""


def in_a_table(width, first):
    """A function that puts an array into consecutive columns of a table that has `width` more."""

    def put(array):
        rows = array[..., None] if array.ndim == 1 else array
        table = np.full((*rows.shape[:-1], rows.shape[-1] + width), 7.25)
        table[..., first : first + rows.shape[-1]] = rows
        found = table[..., first : first + rows.shape[-1]]
        return found[..., 0] if array.ndim == 1 else found

    return put


def backwards(put):
    return lambda array: put(np.flip(array))[(slice(None, None, -1),) * array.ndim]


def read_only(array):
    copy = array.copy()
    copy.setflags(write=False)
    return copy


def every_other(array):
    wide = np.full(tuple(2 * size for size in array.shape), 7.25)
    every = (slice(None, None, 2),) * array.ndim
    wide[every] = array
    return wide[every]


def off_its_place(array):
    """The same numbers at an address that is no multiple of their size."""
    found = np.zeros(array.nbytes + 1, dtype=np.uint8)[1:].view(np.float64).reshape(array.shape)
    found[...] = array
    return found


LAYOUTS = {
    **{f"in a table, {width} more columns": in_a_table(width, width // 2) for width in (1, 2, 3, 5, 6, 7, 14)},
    "read from the end": backwards(np.copy),
    "read from the end of a table": backwards(in_a_table(6, 2)),
    "column by column": np.asfortranarray,
    "every other": every_other,
    "read-only": read_only,
    "another byte order": lambda array: array.astype(array.dtype.newbyteorder()),
    "off its place": off_its_place,
    "a list": np.ndarray.tolist,
}


def bits(result):
    """All numbers in a result, to the bit."""
    if isinstance(result, np.ndarray):
        return result.shape, result.dtype.str, result.tobytes()
    if isinstance(result, float | np.floating):
        return np.float64(result).tobytes()
    if isinstance(result, shapely.Geometry):
        return result.wkb
    if dataclasses.is_dataclass(result):
        return [bits(getattr(result, field.name)) for field in dataclasses.fields(result)]
    if isinstance(result, Sequence) and not isinstance(result, str):
        return [bits(one) for one in result]
    assert isinstance(result, int | str | enum.Enum | None), result
    return result


SAMPLE = (
    "geometry/test_contact",
    "geometry/test_planar",
    "../bench/paper/test_least_squares",
    "estimation/test_region",
    "mechanics/test_prediction",
    "mechanics/test_quasi_static",
)
"""Tests of arithmetic on arrays."""


@pytest.mark.parametrize("name", ROWS)
def test_the_answer_does_not_depend_on_the_layout(name):
    function, given = ROWS[name]
    given = {key: np.array(values, dtype=np.float64, order="C") for key, values in given.items()}
    expected = bits(function(**given))
    for layout, lay in LAYOUTS.items():
        laid = {key: lay(values) for key, values in given.items()}
        assert bits(function(**laid)) == expected, layout
        for key, values in given.items():
            assert np.asarray(laid[key], dtype=np.float64).tobytes() == values.tobytes(), f"{key} was written to: {layout}"


def test_every_public_function_that_takes_arrays_has_a_row():
    assert set(public()) - RESULTS - ELSEWHERE.keys() <= ROWS.keys()
    assert set(ELSEWHERE.values()) <= ROWS.keys()


def test_a_sample_of_the_suite_passes_without_vector_extensions():
    found = np.show_config(mode="dicts")["SIMD Extensions"].get("found")
    if not found:
        pytest.skip("NumPy uses no extensions of this processor")
    tests = [str(CORE / f"{name}.py") for name in (*SAMPLE, "test_memory_layout")]
    env = os.environ | {"NPY_DISABLE_CPU_FEATURES": " ".join(found)}
    command = [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", *tests]
    run = subprocess.run(command, env=env, cwd=CORE, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout[-3000:]
    assert ", 1 skipped" in run.stdout  # this test: there NumPy uses no extensions


def public():
    """All public names that take arrays, and their public methods that do."""
    for name in pushfric_core.__all__:
        thing = getattr(pushfric_core, name)
        if callable(thing) and takes_arrays(thing):
            yield name
        for member, value in vars(thing).items() if inspect.isclass(thing) else ():
            if inspect.isfunction(value) and not member.startswith("_") and takes_arrays(value):
                yield f"{name}.{member}"


def takes_arrays(function):
    try:
        parameters = inspect.signature(function).parameters.values()
    except ValueError:  # a class whose objects are not made by a call
        return False
    return any(has_arrays(one.annotation) for one in parameters)


def has_arrays(annotation):
    return is_array(annotation) or any(map(has_arrays, typing.get_args(annotation)))


def is_array(annotation):
    parts = typing.get_args(annotation)
    array_like = all(part in parts for part in typing.get_args(npt.ArrayLike))
    return array_like or annotation in (Array, tuple[float, float], Twist, Wrench)
