"""Observations of a simulated object that is pushed at random: many, quickly, and the same on every run."""

from collections.abc import Iterator

import numpy as np

from pushfric_core import TABLE_1, Observation
from pushfric_core.geometry.planar import Array, Twist, cross, left_of
from pushfric_core.geometry.support import support_forces
from pushfric_core.program.constraints import ConstraintRows, Moment, NormalForce, stack

OBJECT = TABLE_1["delrin_rect_center"]
"""A flat bottom with the highest pressure in its middle, which no grid of support points fits exactly."""

MU_C = 0.4
"""Contact friction coefficient: the force lies inside this cone, so the tip sticks."""

ADVANCE = 0.01
"""The contact moves this far between the two poses whose difference is the twist [m]."""

POSE_NOISE = np.array((1e-4, 1e-4, 1e-3))
"""Standard deviation of that difference [m, m, rad]; the first is also that of the contact along the edge."""

BATCH = 512
"""Number of motions drawn at once; a push can cause more than a third of them."""

GRIDS = {15: (5, 3), 24: (6, 4), 36: (6, 6), 100: (10, 10), 400: (20, 20)}
"""Columns and rows of the grid of support points, by the number of points."""


def support_points(n: int) -> Array:
    """A grid of n points over the object: (n, 2) [m]."""
    return OBJECT.outline.grid(*GRIDS[n], OBJECT.inset)


def data_points(n: int, seed: int) -> Iterator[ConstraintRows]:
    """The rows of observations, without end, as the estimator's defaults make them: the moment, and f . n >= 0 as a hard row.

    Args:
        n: number of hypothesised support points.
        seed: of the pushes and their noise.
    """
    points, constraints = support_points(n), (Moment(), NormalForce())
    for observation in observations(np.random.default_rng(seed)):
        forces = support_forces(points, observation.twist)
        yield stack([constraint.rows(observation, forces) for constraint in constraints], n)


def observations(rng: np.random.Generator) -> Iterator[Observation]:
    """Observations without end: motions and contacts in balance, to which the noise of the poses is added.

    The motion is drawn at random. The contact follows from it: it is where the line of the pushing force enters the outline.
    """
    outline, (points, weights) = OBJECT.outline, (OBJECT.support.points, OBJECT.support.weights)
    gyration = weights @ np.sum(points**2, axis=1)
    while True:
        # a force that passes the centre at a distance makes the object rotate about a point some gyration / distance away
        distance = rng.uniform(0, outline.size.max() / 2, BATCH)
        bearing = rng.uniform(-np.pi, np.pi, BATCH)
        center = (gyration / distance)[:, None] * np.stack((np.cos(bearing), np.sin(bearing)), axis=1)
        omega = rng.choice((-1.0, 1.0), BATCH)
        velocities = omega[:, None, None] * left_of(points - center[:, None])
        unit_forces = velocities / np.hypot(velocities[..., 0], velocities[..., 1])[..., None]  # against the friction
        force = np.einsum("j,bji->bi", weights, unit_forces)
        moment = cross(points, unit_forces) @ weights
        found = []
        for vertex, edge, normal in zip(outline.vertices, outline.edges, outline.normals, strict=True):
            along = (moment - cross(vertex, force)) / cross(edge, force)  # (vertex + along * edge) x force = moment
            contact = vertex + along[:, None] * edge
            speed = omega[:, None] * left_of(contact - center)
            possible = np.abs(force @ left_of(normal)) <= -MU_C * (force @ normal)
            possible &= (along > 0) & (along < 1) & (speed @ normal < 0)
            found += [(k, contact[k], normal, ADVANCE / np.hypot(*speed[k])) for k in np.flatnonzero(possible)]
        for k, contact, normal, duration in sorted(found, key=lambda one: one[0]):
            noise = rng.normal(0.0, POSE_NOISE)
            blurred = contact + rng.normal(0.0, POSE_NOISE[0]) * left_of(normal)
            twist = duration * omega[k] * np.array((*-left_of(center[k]), 1.0)) + noise
            yield Observation(tuple(blurred.tolist()), tuple(normal.tolist()), Twist(*twist.tolist()))
