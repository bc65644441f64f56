"""Quasi-static forward model of a push (section 2), and the six objects of Table 1."""

import math
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np

from pushfric_core.contact import PushingLine, friction_cone, tangent
from pushfric_core.errors import SolverFailed
from pushfric_core.outline import Outline, Touch
from pushfric_core.planar import Array, Pose, Twist, compose, exp, left_of, rotation, velocity_at
from pushfric_core.records import comparable
from pushfric_core.support import Support

STEP = 2.5e-4
"""Longest advance of the tip in one integration step [m]."""

STILL = 1e-4
"""A support slower than this fraction of the tip's speed begins to stick: rounds Coulomb's corner, so that Newton converges."""

CONVERGED = 1e-14
"""Newton stops when one more step would lower the dissipation by less than this fraction."""

TOUCHING = 1e-7
"""The tip stands at the outline when nearer than this [m]."""

ITERATIONS = 200
"""Bound on Newton's steps; some ten are usual, some tens where the object rotates about a support."""


class ContactMode(Enum):
    """How the tip meets the object."""

    FREE = "free"
    STICKING = "sticking"
    SLIDING = "sliding"


@comparable
class Motion(NamedTuple):
    """How a pushed object moves at an instant."""

    twist: Twist  # object frame
    mode: ContactMode
    force: Array  # (2,) of the pusher ON the object, object frame; unit: the support friction of the translating object


def pushed_motion(support: Support, touch: Touch, velocity: Array, mu_c: float) -> Motion:
    """The motion that balances support friction and contact force.

    Given the velocity of the contact point, the rotation that leaves no moment about it is the one that dissipates least. Where
    that would need a force outside the friction cone, the tip slides: then the motion dissipates least among those in which a
    force along the edge of the cone does the same work.

    Args:
        support: true support friction distribution.
        touch: contact point [m] and outward unit normal, object frame.
        velocity: (2,) of the tip, object frame [m/s]; into the object.
        mu_c: contact friction coefficient, >= 0.
    Raises:
        ValueError: the tip does not move into the object.
        SolverFailed: no motion balances the forces, as where the tip wedges against a corner.
    """
    velocity = np.asarray(velocity, dtype=float)
    approach = float(velocity @ touch.normal)
    if not approach < 0:
        raise ValueError(f"the tip must move into the object, got {-approach:g} m/s along the inward normal")
    arms = support.points - touch.point
    (omega,), force = _least_dissipation(support.weights, velocity, left_of(arms)[None])
    contact_velocity, mode = velocity, ContactMode.STICKING
    shear = float(force @ tangent(touch.normal))
    if abs(shear) > -mu_c * float(force @ touch.normal):
        mode = ContactMode.SLIDING
        edge = friction_cone(touch.normal, mu_c)[shear > 0]
        across = left_of(edge)
        shifts = np.broadcast_to(across, arms.shape)
        (slip, omega), force = _least_dissipation(support.weights, edge, np.stack((shifts, left_of(arms))))
        contact_velocity = edge + slip * across
        normal_speed = float(contact_velocity @ touch.normal)
        if not normal_speed < 0:
            raise SolverFailed("no sliding motion keeps the tip in contact")
        contact_velocity, omega = contact_velocity * (approach / normal_speed), omega * (approach / normal_speed)
    at_contact = Twist(float(contact_velocity[0]), float(contact_velocity[1]), float(omega))
    vx, vy = velocity_at(at_contact, -touch.point)  # of the object-frame origin
    return Motion(Twist(float(vx), float(vy), at_contact.omega), mode, force)


def _least_dissipation(weights: Array, velocity: Array, modes: Array) -> tuple[Array, Array]:
    """The u (k,) that minimises sum_j w_j |velocity + sum_i u_i modes_ij|, and the force (2,) that then does the work.

    A damped Newton method on a convex function of one or two variables.

    Args:
        weights: (n,).
        velocity: (2,) of all points at u = 0.
        modes: (k, n, 2) what a unit of each u adds to the velocities of the points.
    """
    speed = float(np.hypot(*velocity))
    floor = (STILL * speed) ** 2
    # a trace of curvature keeps the step finite where the dissipation is linear
    trace = np.diag(np.sum(modes**2, axis=(1, 2))) * (1e-9 / speed)
    u = np.zeros(len(modes))
    velocities = np.broadcast_to(velocity, modes.shape[1:])
    speeds = np.sqrt(np.sum(velocities**2, axis=1) + floor)
    for _ in range(ITERATIONS):
        share = weights / speeds
        along = np.sum(modes * velocities, axis=2)  # (k, n)
        gradient = along @ share
        hessian = np.tensordot(modes * share[:, None], modes, axes=((1, 2), (1, 2))) - (along * (share / speeds**2)) @ along.T
        step = -np.linalg.solve(hessian + trace, gradient)
        decrease = -float(gradient @ step)
        value = float(weights @ speeds)
        length = 1.0
        # shorten the step until it gains what it promises, or until what it promises drowns in rounding
        while length * decrease > CONVERGED * value:
            trial = velocity + np.tensordot(u + length * step, modes, axes=1)
            trial_speeds = np.sqrt(np.sum(trial**2, axis=1) + floor)
            if float(weights @ trial_speeds) <= value - 0.1 * length * decrease:
                break
            length /= 2
        else:
            return u, share @ velocities
        u, velocities, speeds = u + length * step, trial, trial_speeds
    raise SolverFailed("the motion of the pushed object did not converge")


@comparable
@dataclass
class PushedObject:
    """An object on the table that a straight push moves.

    Args:
        outline: object frame.
        support: true support friction distribution.
        mu_c: contact friction coefficient.
        pose: where it lies in the table frame.
    """

    outline: Outline
    support: Support
    mu_c: float
    pose: Pose

    def push(self, line: PushingLine, position: float) -> ContactMode:
        """Bring the tip to stroke `position` [m] and move the object out of its way.

        What is left to push is measured anew at each step from where the tip would touch the object, so the errors of the
        integration do not add up.

        Returns:
            How the tip met the object last; FREE where it did not.
        Raises:
            SolverFailed: no motion balances the forces.
        """
        mode = ContactMode.FREE
        while (touch := line.touch(self.outline, self.pose)) and position - touch.distance > TOUCHING:
            depth = min(position - touch.distance, STEP)
            halfway = compose(self.pose, exp(self._motion(line, touch, self.pose).twist, depth / 2))
            # the midpoint rule: the motion half a step on stands for the whole step
            motion = self._motion(line, line.touch(self.outline, halfway) or touch, halfway)
            self.pose = compose(self.pose, exp(motion.twist, depth))
            mode = motion.mode
        return mode

    def _motion(self, line: PushingLine, touch: Touch, pose: Pose) -> Motion:
        """The motion per metre of stroke."""
        return pushed_motion(self.support, touch, rotation(-pose.theta) @ np.asarray(line.direction), self.mu_c)


class PoseNoise(NamedTuple):
    """Standard deviations of the error of a pose in a single frame, before any smoothing."""

    position: float  # of each coordinate [m]
    angle: float  # [rad]


FEET = PoseNoise(1e-4, math.radians(0.12))
"""How well the objects on felt feet are seen; with it, simulated pushes fit as well as those of the paper."""

FLAT = PoseNoise(3.5e-4, math.radians(0.45))
"""The same of the flat objects, which are the smallest."""


@comparable
class TableObject(NamedTuple):
    """An object of Table 1: what is true of it, how it is seen, and the grid of support points its estimation starts from."""

    outline: Outline
    support: Support
    mu_c: float
    grid: tuple[int, int]  # columns and rows
    inset: float  # of the grid [m]
    pushes: tuple[int, ...]  # along each edge, from the lower one counter-clockwise
    noise: PoseNoise

    @property
    def support_points(self) -> Array:
        """Hypothesised support points (n, 2) [m]."""
        return self.outline.grid(*self.grid, self.inset)


def _on_feet(
    length: float, width: float, feet: list[tuple[float, float]], mu_c: float, grid: tuple[int, int], pushes: tuple[int, ...]
) -> TableObject:
    """Felt feet that bear equal loads; the outer lines of the grid run `INSET` inside the edges, as the feet do."""
    support = Support(np.array(feet), np.full(len(feet), 1 / len(feet)))
    return TableObject(Outline.rectangle(length, width), support, mu_c, grid, INSET, pushes, FEET)


def _flat(length: float, width: float, offset: float, mu_c: float) -> TableObject:
    """A flat bottom, never quite flat: slightly crowned, it presses on an ellipse, parabolically less from the middle outwards.

    A weight on top shifts the centre of friction along x by `offset` [m].
    """
    outline = Outline.rectangle(length, width)
    points = outline.grid(25, 15, inset=0.001)
    pressure = 1 - np.sum((2 * points / (length, width)) ** 2, axis=1)
    points, pressure = points[pressure > 0], pressure[pressure > 0]
    shift = offset * pressure.sum() / (pressure @ points[:, 0] ** 2)
    weights = pressure * (1 + shift * points[:, 0])
    return TableObject(outline, Support(points, weights / weights.sum()), mu_c, (6, 4), 0.002, (5, 2, 5, 2), FLAT)


INSET = 0.01
"""Distance of the felt feet from the edges [m]."""

_CORNERS = [(-0.0535, -0.022), (0.0535, -0.022), (-0.0535, 0.022), (0.0535, 0.022)]

TABLE_1 = {
    "delrin_square3": _on_feet(0.076, 0.076, [(-0.028, -0.014), (0.028, -0.014), (0.0, 0.028)], 0.2, (6, 6), (5, 5, 5, 5)),
    "wood_rect3": _on_feet(0.127, 0.064, [(-0.02675, -0.022), (-0.02675, 0.022), (0.0535, 0.0)], 0.3, (5, 3), (7, 0, 7, 0)),
    "wood_rect4": _on_feet(0.127, 0.064, _CORNERS, 0.3, (5, 3), (7, 0, 7, 0)),
    "rubber_rect4": _on_feet(0.127, 0.064, _CORNERS, 0.9, (5, 3), (7, 0, 7, 0)),
    "delrin_rect_center": _flat(0.083, 0.051, 0.0, 0.2),
    "delrin_rect_right": _flat(0.083, 0.051, 0.007, 0.2),
}
"""The six objects of Table 1. Materials give mu_c as measured for Table 3; the paper does not say where the feet are, only that
the corners of the grid correspond to them (section 5.1.2) and where p_CF lies."""
