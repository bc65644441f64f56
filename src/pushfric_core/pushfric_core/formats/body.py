"""An object as simulators and planners take it: its outline, feet, masses and friction coefficients, and what they rest on."""

import re
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import shapely

from pushfric_core.formats.feet import Feet, few_feet
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array
from pushfric_core.mechanics.prediction import FrictionModel
from pushfric_core.mechanics.surface_models import NamedEllipsoid, named_ellipsoid

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


class Load(NamedTuple):
    """The load that presses the object on the table."""

    mass: float  # [kg]
    table_friction: float  # coefficient
    gravity: float  # [m/s^2]
    assumed: tuple[str, ...] = ()  # names of the figures that nobody gave

    @property
    def total_friction(self) -> float:
        """Support friction of the translating object [N]."""
        return self.table_friction * self.mass * self.gravity


def load_of(mass: float | None, table_friction: float | None, gravity: float, total_friction: float | None) -> Load:
    """The load from what is known of it. Of the mass, the coefficient and the measured total friction, two give the third.

    Args:
        mass: of the object [kg].
        table_friction: coefficient of the table.
        gravity: [m/s^2].
        total_friction: measured support friction of the translating object [N].
    Raises:
        ValueError: a figure is not positive and finite, or all three are given.
    """
    given = {"mass": mass, "table_friction": table_friction, "gravity": gravity, "total_friction": total_friction}
    for name, value in given.items():
        if value is not None and not 0 < value < np.inf:
            raise ValueError(f"{name} must be positive and finite, got {value:g}")
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
    Raises:
        ValueError: the object is not higher than its feet, or the tip has no radius.
    """

    name: str
    outline: Outline
    friction: FrictionModel
    load: Load
    height: float = HEIGHT
    pusher_radius: float = PUSHER_RADIUS
    rests_on: str = ""

    def __post_init__(self) -> None:
        if not CLEARANCE < self.height < np.inf:
            raise ValueError(f"height must be more than {CLEARANCE:g} m, got {self.height:g}")
        if not 0 < self.pusher_radius < np.inf:
            raise ValueError(f"pusher_radius must be positive and finite, got {self.pusher_radius:g}")

    @property
    def file_name(self) -> str:
        """The name with only those characters that every file system takes."""
        return re.sub(r"[^\w.-]+", "_", self.name)

    @property
    def mu_c(self) -> float:
        """The contact friction coefficient."""
        return min(self.friction.mean_mu_c, STICKS)

    @cached_property
    def feet(self) -> Feet:
        """Feet in place of the mean support. Each bears its weight's share of the mass, on a vertical slide of its own.

        So its normal force is exact however many feet there are; feet of one rigid body would share the load in an unknown way
        if there were more than three.
        """
        return few_feet(self.friction.support)

    @cached_property
    def ellipsoid(self) -> NamedEllipsoid:
        """The ellipsoid for planners [N, N m]."""
        unit = named_ellipsoid(self.friction.support)
        total = self.load.total_friction
        return NamedEllipsoid(total * unit.f_max, total * unit.m_max, unit.center)

    @cached_property
    def box(self) -> tuple[Array, Array] | None:
        """Centre (2,) and sides (2,) of an outline that is a rectangle along the axes; None of another one."""
        low, size = self.outline.lower, self.outline.size
        return (low + size / 2, size) if self.outline.polygon.equals(shapely.box(*low, *(low + size))) else None

    @cached_property
    def pieces(self) -> list[Array]:
        """Convex polygons (n, 2), counter-clockwise, that make up the outline."""
        polygon = self.outline.polygon
        pieces: list[shapely.Polygon] = []
        for triangle in [polygon] if _convex(polygon) else shapely.constrained_delaunay_triangles(polygon).geoms:
            joined = ((k, piece.union(triangle)) for k, piece in enumerate(pieces))
            k, piece = next(((k, whole) for k, whole in joined if _convex(whole)), (len(pieces), triangle))
            pieces[k : k + 1] = [piece]
        return [np.array(shapely.orient_polygons(piece.convex_hull).exterior.coords)[:-1] for piece in pieces]

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
            *notes,
        ]


def _convex(shape: shapely.Geometry) -> bool:
    return shape.geom_type == "Polygon" and bool(shape.convex_hull.area <= (1 + DENTS) * shape.area)
