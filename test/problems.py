"""Worked problems with known answers, shared by the tests."""

import pathlib
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pushfric_core import Constraint, ConstraintRows, HalfPlanes, Observation, Outline, Support, Touch, Twist, pushed_motion
from pushfric_core.estimation.push_plan import PlannedPush
from pushfric_core.estimation.region import line_of_motion
from pushfric_core.files.csv_files import REQUIRED
from pushfric_core.geometry.planar import Array, Pose, rotation, velocity_at
from pushfric_core.geometry.support import NOT_FREE, FreeRadii, support_forces


class Problem(NamedTuple):
    """An object with a known support, and noiseless observations of it."""

    name: str
    outline: Outline
    truth: Support
    observations: list[Observation]


def square(side: float = 0.1) -> Outline:
    return Outline.rectangle(side, side)


def observations_of(outline: Outline, support: Support, mu_c: float, count: int, rng: np.random.Generator) -> list[Observation]:
    """Noiseless observations: random contacts on the edges, random directions of the tip, motions from the forward model."""
    found: list[Observation] = []
    while len(found) < count:
        edge = int(rng.integers(len(outline.vertices)))
        point = outline.vertices[edge] + rng.uniform(0.05, 0.95) * outline.edges[edge]
        normal = outline.normals[edge]
        velocity = 0.02 * rotation(rng.uniform(-1.0, 1.0)) @ -normal
        motion = pushed_motion(support, Touch(0.0, point, normal, edge), velocity, mu_c)
        speeds = np.linalg.norm(velocity_at(motion.twist, support.points), axis=1)
        if speeds.min() > 1e-3 * speeds.max():  # the model rounds the corner of Coulomb's law, at which a support stands still
            found.append(Observation(tuple(point), tuple(normal), motion.twist, push_id=len(found)))
    return found


def seen_often(
    pushes: list[Observation], rng: np.random.Generator, noise: float = 0.01, times: int = 4
) -> Iterator[Observation]:
    """Each motion, seen so many times with errors of this share of the speed; the tip sticks."""
    for push in pushes:
        tip = velocity_at(push.twist, np.asarray(push.contact_point))
        for _ in range(times):
            errors = noise * np.hypot(*tip) * rng.normal(size=3) * (1, 1, 1 / 0.06)
            yield replace(push, twist=Twist(*(np.array(push.twist) + errors).tolist()), tip_velocity=tuple(tip.tolist()))


def four_feet() -> Problem:
    """A square on unequal corner feet."""
    support = Support(0.04 * np.array(((-1, -1), (1, -1), (1, 1), (-1, 1))), np.array((0.1, 0.2, 0.3, 0.4)))
    return Problem("four feet", square(), support, observations_of(square(), support, 0.5, 40, np.random.default_rng(1)))


def three_feet() -> Problem:
    """A right triangle on three equal feet."""
    outline = Outline(np.array(((0, 0), (0.15, 0), (0, 0.15))))
    support = Support(np.array(((0.03, 0.03), (0.09, 0.03), (0.03, 0.09))), np.full(3, 1 / 3))
    return Problem("three feet", outline, support, observations_of(outline, support, 0.4, 30, np.random.default_rng(2)))


def flat_bar() -> Problem:
    """A rectangle on a 6 x 4 grid of random weights."""
    outline = Outline.rectangle(0.12, 0.06)
    rng = np.random.default_rng(3)
    weights = rng.dirichlet(np.ones(24))
    support = Support(outline.grid(6, 4), weights)
    return Problem("flat bar", outline, support, observations_of(outline, support, 0.3, 80, rng))


PROBLEMS = (four_feet, three_feet, flat_bar)


def moment(weights: Array, points: Array, observation: Observation) -> float:
    """Moment of the support friction about the contact, written out point by point: the tests' own eq. 2."""
    total = 0.0
    for weight, point in zip(weights, points, strict=True):
        vx = observation.twist.vx - observation.twist.omega * point[1]
        vy = observation.twist.vy + observation.twist.omega * point[0]
        speed = (vx**2 + vy**2) ** 0.5
        rx, ry = point[0] - observation.contact_point[0], point[1] - observation.contact_point[1]
        total += -weight * (rx * vy - ry * vx) / speed
    return total


def rows_of(
    constraint: Constraint, observation: Observation, support_points: Array, free: FreeRadii = NOT_FREE
) -> ConstraintRows:
    """The rows that a constraint makes from an observation."""
    return constraint.rows(observation, support_forces(support_points, observation.twist, free))


FULL = Observation(
    (0.0125, -1e-05),
    (0.0, -1.0),
    Twist(1e-05, 0.1, 3.141592653589793),
    7,
    0.002,
    0.3,
    123456789,
    Pose(0.1, 0.2, -0.3),
    (0.5, 1 / 3),
    (0.02, 1 / 7),
    2 / 7000,
)
"""An observation that has all that one can have."""


def contacts_of(observations: Iterable[Observation]) -> Iterator[list[object]]:
    """Contact points, normals and velocities of the tip, as what predicts takes them."""
    for name in ("contact_point", "contact_normal", "tip_velocity"):
        yield [getattr(one, name) for one in observations]


def save_csv(path: pathlib.Path, columns: Iterable[str], *rows: Iterable[object]) -> pathlib.Path:
    """A table of these rows, each number to its last bit; returns its path."""
    path.write_text("".join(f"{','.join(map(str, row))}\n" for row in (columns, *rows)))
    return path


def save_observations(path: pathlib.Path, observations: Iterable[Observation]) -> pathlib.Path:
    """A table of the columns that every observation has; returns its path."""
    return save_csv(path, REQUIRED, *((*o.contact_point, *o.contact_normal, *o.twist, o.push_id) for o in observations))


def narrowed(outline: Outline, margin: float, observations: Iterable[Observation]) -> HalfPlanes:
    """The half-planes of the lines of motion of some observations."""
    half_planes = HalfPlanes(outline, margin)
    for observation in observations:
        half_planes.add(line_of_motion(observation))
    return half_planes


def pushed_as_planned(support: Support, outline: Outline, push: PlannedPush, mu_c: float) -> tuple[Observation, Array]:
    """The observation of a planned push, and the direction of the pusher."""
    normal = outline.normals[push.edge]
    point = outline.vertices[push.edge] + outline.edges[push.edge] * (0.5 + push.offset / outline.lengths[push.edge])
    direction = rotation(push.angle) @ -normal
    motion = pushed_motion(support, Touch(0.0, point, normal, push.edge), 0.02 * direction, mu_c)
    return Observation(tuple(point), tuple(normal), motion.twist), direction
