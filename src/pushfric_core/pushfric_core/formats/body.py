"""An object as simulators and planners take it: its outline, feet, masses and friction coefficients, and what they rest on."""

import re
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import shapely

from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array, cross, left_of
from pushfric_core.geometry.support import Support
from pushfric_core.mechanics.limit_surface import SurfaceError, support_error, surface_samples
from pushfric_core.mechanics.prediction import FrictionModel

GRAVITY = 9.81
"""[m/s^2]"""

PUSHER_RADIUS = 0.005
"""Default radius of the tip [m]."""

HEIGHT = 0.04
"""Default height of the object [m]."""

MASS = 1.0
"""Default mass of the object [kg]; quasi-static motions do not depend on it."""

TABLE_FRICTION = 0.35
"""Coefficient of the table if nothing is known of it; quasi-static motions do not depend on it."""

STICKS = 10.0
"""With this coefficient no tip slides. Simulators cannot take the much larger ones of a model whose tip always sticks."""

FOOT_RADIUS = 1e-3
"""Radius of the spheres on which the object slides [m]."""

CLEARANCE = 2 * FOOT_RADIUS
"""Height of the shell's bottom over the table, which it does not touch [m]."""

SHELL_MASS = 1e-3
"""Mass of a link that rests on no foot, as a share of the object's: simulators want one."""

GYRATION = 0.01
"""Radius of gyration of every link [m]; point masses would make the equations of motion singular."""

DENTS = 1e-3
"""A polygon counts as convex if its hull is larger by no more than this share; measured outlines have small dents."""


TOLERANCE = SurfaceError(load=0.01, twist=np.radians(0.7))
"""Feet may err by this much. After 50 mm, they end about 0.2 mm (median) from where the support would."""

FIRM = 1e3
"""The total force and the centre of friction count this much more than the wrench of one motion."""

NOTHING = 1e-3
"""Share of the load below which a foot is left out."""


class Feet(NamedTuple):
    """Feet, and how far their limit surface is from that of the support for which they stand."""

    support: Support
    error: SurfaceError


def few_feet(support: Support) -> Feet:
    """Some of the support points, reweighted, with the same total force and centre of friction and nearly the same surface.

    One point after another is added: the one that lowers the residual of the wrenches most steeply. After each, the weights are
    the nonnegative least squares of the wrenches over motions of all directions (orthogonal matching pursuit). If nearly all
    rests on one point, the feet are the support points themselves.

    Args:
        support: of the object.
    """
    from scipy.optimize import nnls  # takes longer to load than the rest of this package

    bearing = support.weights > 0
    points, weights = support.points[bearing], support.weights[bearing]
    if not np.ptp(points, axis=0).any():  # its limit surface encloses no volume
        return Feet(Support(points[:1], np.ones(1)), SurfaceError(0.0, 0.0))
    wrenches = _wrenches(points, support)
    goal = wrenches @ weights
    steepness = np.linalg.norm(wrenches, axis=0)
    chosen: list[int] = []
    residual = goal
    while len(chosen) < len(points):
        gain = wrenches.T @ residual / steepness
        gain[chosen] = -np.inf
        chosen.append(int(np.argmax(gain)))
        found, _ = nnls(wrenches[:, chosen], goal)
        residual = goal - wrenches[:, chosen] @ found
        bears = found > NOTHING * found.sum()
        if np.count_nonzero(bears) > 1:
            feet = Support(points[chosen][bears], found[bears] / found[bears].sum())
            error = support_error(feet, support)
            if error.load <= TOLERANCE.load and error.twist <= TOLERANCE.twist:
                return Feet(feet, error)
    return Feet(Support(points, weights / weights.sum()), SurfaceError(0.0, 0.0))


def _wrenches(points: Array, support: Support) -> Array:
    """The share of a unit of weight at each point in the wrenches of s motions, the force and the first moments (3s + 3, n).

    Moments are about p_CF, in units that make the limit surface about round.
    """
    _, twists = surface_samples(support)
    velocities = left_of(points) * twists[:, None, 2:] + twists[:, None, :2]
    speeds = np.linalg.norm(velocities, axis=2, keepdims=True)
    directions = velocities / np.where(speeds > 0, speeds, 1.0)
    center = support.center_of_friction
    arms = (points - center) / (support.weights @ np.linalg.norm(support.points - center, axis=1))
    firm = FIRM * np.vstack((np.ones(len(points)), arms.T))
    return np.concatenate((directions[..., 0], directions[..., 1], cross(arms, directions), firm))


class Load(NamedTuple):
    """The load that presses the object on the table."""

    mass: float  # [kg]
    table_friction: float  # coefficient
    gravity: float  # [m/s^2]
    assumed: tuple[str, ...]  # names of the figures that nobody gave


def load_of(mass: float | None, table_friction: float | None, gravity: float, total_friction: float | None) -> Load:
    """The load from what is known of it. Of the mass, the coefficient and the measured total friction, two give the third.

    Args:
        mass: of the object [kg].
        table_friction: coefficient of the table.
        gravity: [m/s^2].
        total_friction: measured support friction of the translating object [N].
    Raises:
        ValueError: all three are given.
    """
    if mass and table_friction and total_friction:
        raise ValueError(f"expected mass or table_friction, not both: the total friction is measured, {total_friction:g} N")
    assumed = []
    if table_friction is None and mass and total_friction:
        table_friction = total_friction / (mass * gravity)
    elif table_friction is None:
        table_friction = TABLE_FRICTION
        assumed.append("table friction")
    if mass is None and total_friction:
        mass = total_friction / (table_friction * gravity)
    elif mass is None:
        mass = MASS
        assumed.append("mass")
    return Load(mass, table_friction, gravity, tuple(assumed))


@dataclass(frozen=True)
class ExportedBody:
    """The object. Lengths are in its frame, SI units throughout.

    Attributes:
        name: of the object.
        outline: object frame.
        friction: its model; simulators take the mean.
        load: what presses it on the table.
        height: of its top above the table [m].
        pusher_radius: of the round tip [m].
        rests_on: what the model was made from, in words.
    """

    name: str
    outline: Outline
    friction: FrictionModel
    load: Load
    height: float = HEIGHT
    pusher_radius: float = PUSHER_RADIUS
    rests_on: str = ""

    @property
    def file_name(self) -> str:
        """The name with only those characters that every file system takes."""
        return re.sub(r"[^\w.-]+", "_", self.name)

    @property
    def mu_c(self) -> float:
        """The contact friction coefficient."""
        return min(self.friction.median_mu_c, STICKS)

    @cached_property
    def feet(self) -> Feet:
        """Feet in place of the mean support. Each bears its weight's share of the mass, on a vertical slide of its own.

        So its normal force is exact however many feet there are; feet of one rigid body would share the load in an unknown way
        if there were more than three.
        """
        return few_feet(self.friction.support)

    @property
    def footing(self) -> list[tuple[float, float, float]]:
        """The place of each foot [m], and its share of the mass [kg]."""
        feet, mass = self.feet.support, self.load.mass
        return [(x, y, share * mass) for (x, y), share in zip(feet.points.tolist(), feet.weights.tolist(), strict=True)]

    @cached_property
    def box(self) -> tuple[Array, Array] | None:
        """Centre (3,) and sides (3,) of the shell over a rectangle along the axes; None of another outline."""
        low, size = self.outline.lower, self.outline.size
        if not self.outline.polygon.equals(shapely.box(*low, *(low + size))):
            return None
        middle, high = (CLEARANCE + self.height) / 2, self.height - CLEARANCE
        return np.array((*(low + size / 2), middle)), np.array((*size, high))

    @cached_property
    def prisms(self) -> list[Array]:
        """Convex prisms that make up the shell: their corners (2n, 3), below and then above, counter-clockwise."""
        polygon = self.outline.polygon
        pieces: list[shapely.Polygon] = []
        for triangle in [polygon] if _convex(polygon) else shapely.constrained_delaunay_triangles(polygon).geoms:
            joined = ((k, piece.union(triangle)) for k, piece in enumerate(pieces))
            k, piece = next(((k, whole) for k, whole in joined if _convex(whole)), (len(pieces), triangle))
            pieces[k : k + 1] = [piece]
        rings = [shapely.orient_polygons(piece.convex_hull).exterior.coords[:-1] for piece in pieces]
        return [np.array([(x, y, z) for z in (CLEARANCE, self.height) for x, y in ring]) for ring in rings]

    def comments(self, *notes: str) -> list[str]:
        """The lines with which a file begins, the last ones those of its format."""
        feet, load = self.feet, self.load
        bearing = np.count_nonzero(self.friction.support.weights)
        return [
            " ".join(self.rests_on.split()),
            f"{len(feet.support.weights)} feet for {bearing} support points: the load that makes the object slide differs by"
            f" {100 * feet.error.load:.2g} % (rms), its motion by {np.degrees(feet.error.twist):.2g} degrees (median).",
            f"Mass {load.mass:.4g} kg, table friction {load.table_friction:.4g}; assumed:"
            f" {' and '.join(load.assumed) or 'neither'}. Slow motions depend on neither.",
            *([] if self.friction.limit is None else [f"{self.friction.limit}."]),
            *notes,
        ]


def _convex(shape: shapely.Geometry) -> bool:
    return shape.geom_type == "Polygon" and bool(shape.convex_hull.area <= (1 + DENTS) * shape.area)
