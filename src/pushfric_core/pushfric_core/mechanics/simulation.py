"""Quasi-static forward model of a push (section 2)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.errors import SolverFailed
from pushfric_core.geometry.contact import PushingLine, friction_cone, tangent
from pushfric_core.geometry.outline import Outline, Touch
from pushfric_core.geometry.planar import Array, Pose, Twist, as_array, compose, exp, left_of, rotation, velocity_at
from pushfric_core.geometry.support import Support
from pushfric_core.records import comparable

STEP = 2.5e-4
"""Longest advance of the tip in one integration step [m]."""

STILL = 1e-4
"""A support slower than this fraction of the tip's speed begins to stick; this rounds Coulomb's law for Newton's method."""

CONVERGED = 1e-14
"""Newton stops when one more step would lower the dissipation by less than this fraction."""

TOUCHING = 1e-7
"""The tip is at the outline if it is nearer than this [m]."""

ITERATIONS = 200
"""Cap on Newton's steps; about ten are usual, some tens if the object rotates about a support."""


class ContactMode(Enum):
    """How the tip meets the object."""

    FREE = "free"
    STICKING = "sticking"
    SLIDING = "sliding"


@comparable
class Motion(NamedTuple):
    """The motion of a pushed object at an instant."""

    twist: Twist  # object frame
    mode: ContactMode
    force: Array  # (2,) of the pusher ON the object, object frame; unit: the support friction of the translating object


def pushed_motion(support: Support, touch: Touch, velocity: npt.ArrayLike, mu_c: float) -> Motion:
    """The motion that balances support friction and contact force.

    Given the velocity of the contact point, the rotation without a moment about it is the one that dissipates least. If that
    needs a force outside the friction cone, the tip slides. Then the motion dissipates least among those in which a force along
    the edge of the cone does the same work.

    Args:
        support: true support friction distribution.
        touch: contact point [m] and outward unit normal, object frame.
        velocity: (2,) of the tip, object frame [m/s]; into the object.
        mu_c: contact friction coefficient, >= 0.
    Raises:
        ValueError: the tip does not move into the object.
        SolverFailed: no motion balances the forces, for example if the tip wedges against a corner.

    Example:
        >>> from pushfric_core import TABLE_1, pushed_motion
        >>> known = TABLE_1["wood_rect4"]
        >>> touch = known.outline.first_touch((0.03, -0.1), (0.0, 1.0))
        >>> pushed_motion(known.support, touch, (0.0, 0.02), known.mu_c).mode.value
        'sliding'
    """
    velocity, point, normal = map(as_array, (velocity, touch.point, touch.normal))
    approach = float(velocity @ normal)
    if not approach < 0:
        raise ValueError(f"the tip must move into the object, got {-approach:g} m/s along the inward normal")
    arms = support.points - point
    (omega,), force = _least_dissipation(support.weights, velocity, left_of(arms)[None])
    contact_velocity, mode = velocity, ContactMode.STICKING
    shear = float(force @ tangent(normal))
    if abs(shear) > -mu_c * float(force @ normal):
        mode = ContactMode.SLIDING
        edge = friction_cone(normal, mu_c)[shear > 0]
        across = left_of(edge)
        shifts = np.broadcast_to(across, arms.shape)
        (slip, omega), force = _least_dissipation(support.weights, edge, np.stack((shifts, left_of(arms))))
        contact_velocity = edge + slip * across
        normal_speed = float(contact_velocity @ normal)
        if not normal_speed < 0:
            raise SolverFailed("no sliding motion keeps the tip in contact")
        contact_velocity, omega = contact_velocity * (approach / normal_speed), omega * (approach / normal_speed)
    at_contact = Twist(float(contact_velocity[0]), float(contact_velocity[1]), float(omega))
    vx, vy = velocity_at(at_contact, -point)  # of the object-frame origin
    return Motion(Twist(float(vx), float(vy), at_contact.omega), mode, force)


def _least_dissipation(weights: Array, velocity: Array, modes: Array) -> tuple[Array, Array]:
    """The u (k,) that minimises sum_j w_j |velocity + sum_i u_i modes_ij|, and the force (2,) that does the work at it.

    A damped Newton method on a convex function of one or two variables.

    Args:
        weights: (n,).
        velocity: (2,) of all points at u = 0.
        modes: (k, n, 2) what a unit of each u adds to the velocities of the points.
    """
    speed = float(np.hypot(*velocity))
    floor = (STILL * speed) ** 2
    # a trace of curvature keeps the step finite if the dissipation is linear
    trace = np.diag(np.sum(modes**2, axis=(1, 2))) * (1e-9 / speed)
    u = np.zeros(len(modes))
    flat = modes.reshape(len(modes), -1)
    velocities = np.broadcast_to(velocity, modes.shape[1:])
    speeds = np.sqrt(np.sum(velocities**2, axis=1) + floor)
    for _ in range(ITERATIONS):
        share = weights / speeds
        along = np.sum(modes * velocities, axis=2)  # (k, n)
        gradient = along @ share
        hessian = (modes * share[:, None]).reshape(flat.shape) @ flat.T - (along * (share / speeds**2)) @ along.T
        step = -np.linalg.solve(hessian + trace, gradient)
        decrease = -float(gradient @ step)
        value = float(weights @ speeds)
        length = 1.0
        # shorten the step until it gains what was expected, or until the expected gain is lost in rounding
        while length * decrease > CONVERGED * value:
            trial = velocity + ((u + length * step)[None] @ flat).reshape(modes.shape[1:])
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

    Example:
        >>> from pushfric_core import TABLE_1, Pose, PushedObject, PushingLine
        >>> known = TABLE_1["wood_rect4"]
        >>> pushed = PushedObject(known.outline, known.support, known.mu_c, Pose(0.0, 0.0, 0.0))
        >>> pushed.push(PushingLine((0.0, -0.1), (0.0, 1.0), 0.003), position=0.075).value
        'sticking'
        >>> round(pushed.pose.y, 3)
        0.01
    """

    outline: Outline
    support: Support
    mu_c: float
    pose: Pose

    def push(self, line: PushingLine, position: float) -> ContactMode:
        """Move the tip along a line to stroke `position` [m], and the object out of its way.

        At each step, the rest of the push is measured from where the tip would touch the object, so that the errors of the
        integration do not add up.

        Returns:
            How the tip met the object last; FREE if it did not.
        Raises:
            SolverFailed: no motion balances the forces.
        """
        mode = ContactMode.FREE
        if line.passed(self.outline, self.pose):
            return mode
        while (touch := line.touch(self.outline, self.pose)) and position - touch.distance > TOUCHING:
            depth = min(position - touch.distance, STEP)
            halfway = compose(self.pose, exp(self._motion(line, touch, self.pose).twist, depth / 2))
            # the midpoint rule: the motion at half a step is used for the whole step
            motion = self._motion(line, line.touch(self.outline, halfway) or touch, halfway)
            self.pose = compose(self.pose, exp(motion.twist, depth))
            mode = motion.mode
        return mode

    def _motion(self, line: PushingLine, touch: Touch, pose: Pose) -> Motion:
        """The motion per metre of stroke."""
        return pushed_motion(self.support, touch, rotation(-pose.theta) @ as_array(line.direction), self.mu_c)
