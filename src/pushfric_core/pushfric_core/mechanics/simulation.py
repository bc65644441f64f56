"""An object that is pushed along a line, by the quasi-static model (section 2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.geometry.contact import PushingLine
from pushfric_core.geometry.outline import Outline, Touch
from pushfric_core.geometry.planar import Array, Pose, Twist, as_array, check_unit, compose, exp, rotation
from pushfric_core.geometry.support import Support
from pushfric_core.mechanics.quasi_static import MODES, ContactMode, motions_of_rows
from pushfric_core.records import comparable
from pushfric_core.trajectories.observation import SLOWEST

STEP = 2.5e-4
"""Longest advance of the tip in one integration step [m]."""

TOUCHING = 1e-7
"""The tip is at the outline if it is nearer than this [m]."""


@comparable
class Motion(NamedTuple):
    """The motion of a pushed object at an instant."""

    twist: Twist  # object frame
    mode: ContactMode
    force: Array  # (2,) of the pusher ON the object, object frame; unit: the support friction of the translating object


def pushed_motion(support: Support, touch: Touch, velocity: npt.ArrayLike, mu_c: float) -> Motion:
    """The motion that balances support friction and contact force.

    Args:
        support: true support friction distribution.
        touch: contact point [m] and outward unit normal, object frame.
        velocity: (2,) of the tip, object frame [m/s]; into the object.
        mu_c: contact friction coefficient, >= 0.
    Raises:
        ValueError: the tip does not move into the object, the normal is not unit, or mu_c is negative.
        SolverFailed: no motion balances the forces, for example if the tip wedges against a corner.

    Example:
        >>> from pushfric_core import TABLE_1, pushed_motion
        >>> known = TABLE_1["wood_rect4"]
        >>> touch = known.outline.first_touch((0.03, -0.1), (0.0, 1.0))
        >>> pushed_motion(known.support, touch, (0.0, 0.02), known.mu_c).mode.value
        'sliding'
    """
    check_unit("the normal", touch.normal)
    if not mu_c >= 0:
        raise ValueError(f"mu_c must be at least 0, got {mu_c:g}")
    velocity, point, normal = map(as_array, (velocity, touch.point, touch.normal))
    approach = float(velocity @ normal)
    if not approach < -SLOWEST:
        raise ValueError(f"the tip must move into the object, got {-approach:g} m/s along the inward normal")
    rows = np.zeros(1, dtype=np.int64), point[None], normal[None], velocity[None]
    moved = motions_of_rows(support.points, support.weights[None], np.array((mu_c,)), *rows)
    return Motion(Twist(*moved.twists[0].tolist()), MODES[moved.modes[0]], moved.forces[0])


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
