"""The motion of one pushed object after another: the inner loops of `quasi_static`, compiled.

Per unit of speed along a direction d, a contact moves by d + slip left(d), and the object turns about it. Both `stick` and
`slide` minimise what the supports then dissipate, a convex function of slip and turn: the first with the slip 0, the second
freely.

`least_dissipation.pxd` declares the types of this module, and Cython compiles both when the package is built. As plain Python
it gives the same bits (see `solvers.pivoting`).
"""

import math

import numpy as np
import numpy.typing as npt

from pushfric_core.geometry.planar import Array, Indices
from pushfric_core.mechanics.damped_newton import CONVERGED, GAIN, STILL
from pushfric_core.trajectories.observation import SLOWEST

FREE, STICKING, SLIDING = range(3)
"""How a tip meets an object."""

ENDLESS, WEDGED = -1, -2
"""Failures of `push_each`: a motion did not converge, or no sliding motion keeps the tip in contact."""

BISECTIONS = 100
"""Bound on the steps of a search on a line; about six are usual."""

NARROW = 1e-12
"""The search for a turn ends when a step, or the bracket, moves the supports by less than this share of the tip's way."""

FLAT = 1e-9
"""This share of the curvature of a translation and of a turn is added, to keep a step finite if the dissipation is linear."""


class Contact:
    """A contact, the supports that bear weight as seen from it, and what they dissipate at one slip and turn.

    Args:
        points: (n, 2) the supports.
        weights: (s, n) of each sample.
    """

    def __init__(self, points: Array, weights: Array) -> None:
        self.points, self.weights = points, weights
        # components of the arms along left(d) and along d, and the squares of their lengths
        self.w, self.lever, self.reach, self.square = np.empty((4, len(points)))
        self.moment, self.rise = np.empty((2, len(points)))  # shares of the supports in by_turn and turn_turn
        self.size = 0  # number of supports that bear weight
        self.x = self.y = 0.0  # d
        self.slip = self.turn = 0.0
        self.value = self.by_slip = self.by_turn = 0.0  # the dissipation and its derivatives
        self.slip_slip = self.slip_turn = self.turn_turn = 0.0  # and second derivatives
        self.along = 0.0  # force along d; across it is by_slip


def look(contact: Contact, sample: int, at_x: float, at_y: float, x: float, y: float) -> None:
    """See the supports of a sample from a contact at a point; (x, y) has the direction d."""
    length = math.sqrt(x * x + y * y)
    contact.x, contact.y = x / length, y / length
    size = 0
    for j in range(len(contact.points)):
        if contact.weights[sample, j] > 0:
            arm_x, arm_y = contact.points[j, 0] - at_x, contact.points[j, 1] - at_y
            contact.w[size] = contact.weights[sample, j]
            contact.lever[size] = arm_x * contact.y - arm_y * contact.x
            contact.reach[size] = arm_x * contact.x + arm_y * contact.y
            contact.square[size] = arm_x * arm_x + arm_y * arm_y
            size += 1
    contact.size = size


def dissipate(contact: Contact, slip: float, turn: float) -> None:
    """The dissipation and its derivatives at a slip and turn."""
    value = along = by_slip = by_turn = slip_slip = slip_turn = turn_turn = 0.0
    for j in range(contact.size):
        lever, reach = contact.lever[j], contact.reach[j]
        ahead, across = 1 + turn * lever, slip + turn * reach
        speed = math.sqrt(ahead * ahead + across * across + STILL * STILL)
        slowness = 1 / speed
        share = contact.w[j] * slowness
        growth = ahead * lever + across * reach
        across_share, growth_share = across * slowness, growth * slowness
        value += contact.w[j] * speed
        along += share * ahead
        by_slip += share * across
        by_turn += share * growth
        slip_slip += share * (1 - across_share * across_share)
        slip_turn += share * (reach - across_share * growth_share)
        turn_turn += share * (contact.square[j] - growth_share * growth_share)
    contact.slip, contact.turn = slip, turn
    contact.value, contact.along, contact.by_slip, contact.by_turn = value, along, by_slip, by_turn
    contact.slip_slip, contact.slip_turn, contact.turn_turn = slip_slip, slip_turn, turn_turn


def turn_only(contact: Contact, turn: float) -> None:
    """The derivatives by the turn, at a turn without a slip: the same bits as those of `dissipate`, in half the time."""
    by_turn = turn_turn = 0.0
    still = STILL * STILL
    for j in range(contact.size):  # apart from the sums, so that two supports are computed at once
        lever, reach = contact.lever[j], contact.reach[j]
        ahead, across = 1 + turn * lever, turn * reach
        slowness = 1 / math.sqrt(ahead * ahead + across * across + still)
        share, growth = contact.w[j] * slowness, ahead * lever + across * reach
        growth_share = growth * slowness
        contact.moment[j] = share * growth
        contact.rise[j] = share * (contact.square[j] - growth_share * growth_share)
    for j in range(contact.size):
        by_turn += contact.moment[j]
        turn_turn += contact.rise[j]
    contact.by_turn, contact.turn_turn = by_turn, turn_turn


def stick(contact: Contact) -> None:
    """Find the turn that dissipates least without a slip, at which no moment about the contact is left.

    Newton's method on the moment, which grows with the turn. If a step leaves the bracket, or is more than half as long as the
    last one, the bracket is halved instead.
    """
    low, high, square = math.inf, -math.inf, 0.0
    for j in range(contact.size):
        if contact.square[j] > 0:
            own = -contact.lever[j] / contact.square[j]  # at this turn, the support by itself moves slowest
            low, high = min(low, own), max(high, own)
            square += contact.w[j] * contact.square[j]
    if low > high:
        low = high = 0.0  # all the weight at the contact: it does not turn
    turn, last = (low + high) / 2, high - low
    # not by the bracket: a support beside the contact makes that as wide as it likes
    narrow = NARROW / math.sqrt(square) if square > 0 else 0.0
    for _ in range(BISECTIONS):
        if not (last > narrow and high - low > narrow):
            break
        turn_only(contact, turn)
        if contact.by_turn > 0:
            high = turn
        else:
            low = turn
        following = low
        if contact.turn_turn > 0:
            following = turn - contact.by_turn / contact.turn_turn
            if abs(following - turn) <= narrow:  # so short a step may end beyond the bracket
                turn = following
                break
        # near a support that almost stands still, Newton's steps are short and hardly shrink
        if not (low < following < high and abs(following - turn) <= last / 2):
            following = (low + high) / 2
        last, turn = abs(following - turn), following
    dissipate(contact, 0.0, turn)


def slide(contact: Contact, steps: int) -> bool:
    """Find the slip and turn that dissipate least, by a damped Newton method; False if that takes too many steps."""
    translation = turning = 0.0
    for j in range(contact.size):
        translation += FLAT
        turning += FLAT * contact.square[j]
    dissipate(contact, 0.0, 0.0)
    for _ in range(steps):
        slip, turn, value = contact.slip, contact.turn, contact.value
        a, b, c = contact.slip_slip + translation, contact.slip_turn, contact.turn_turn + turning
        determinant = a * c - b * b
        if not determinant > 0:
            return True  # all the weight at the contact: to turn about it costs nothing
        by_slip, by_turn = (b * contact.by_turn - c * contact.by_slip), (b * contact.by_slip - a * contact.by_turn)
        by_slip, by_turn = by_slip / determinant, by_turn / determinant
        decrease = -(contact.by_slip * by_slip + contact.by_turn * by_turn)
        if not decrease > CONVERGED * value:
            return True
        # shorten the step until it gains what was expected, or until the expected gain is lost in rounding
        length = 1.0
        dissipate(contact, slip + by_slip, turn + by_turn)
        while not value - contact.value >= GAIN * length * decrease:
            length /= 2
            if length * decrease <= CONVERGED * value:
                dissipate(contact, slip, turn)
                return True
            dissipate(contact, slip + length * by_slip, turn + length * by_turn)
    return False


def slide_along(
    contact: Contact, sample: int, x: float, y: float, normal_x: float, normal_y: float, mu_c: float, steps: int
) -> bool:
    """`slide` under a force along an edge of the friction cone: that towards +t, or for -mu_c towards -t."""
    look(contact, sample, x, y, -normal_x - mu_c * normal_y, -normal_y + mu_c * normal_x)
    return slide(contact, steps)


def push_each(
    contact: Contact,
    mu_c: Array,
    samples: Indices,
    points: Array,
    normals: Array,
    velocities: Array,
    steps: int,
    twists: Array,
    modes: npt.NDArray[np.int8],
    forces: Array,
) -> int:
    """Push r objects, one after another.

    Args:
        contact: knows the supports.
        mu_c: (r,).
        samples: (r,) of the friction.
        points: (r, 2) of the contacts.
        normals: (r, 2).
        velocities: (r, 2) of the tips.
        steps: most steps of Newton's method.
        twists: (r, 3) takes the motions; all three are zero before.
        modes: (r,) takes how the tips meet the objects.
        forces: (r, 2) takes the forces of the pusher ON the object.
    Returns:
        The number of objects, or what is wrong with the last whose motion was not found; such an object stays at rest.
    """
    outcome = len(samples)
    for r in range(len(samples)):
        sample, x, y, normal_x, normal_y = samples[r], points[r, 0], points[r, 1], normals[r, 0], normals[r, 1]
        velocity_x, velocity_y = velocities[r, 0], velocities[r, 1]
        approach = velocity_x * normal_x + velocity_y * normal_y
        if not approach < -SLOWEST:
            continue
        modes[r] = STICKING
        look(contact, sample, x, y, velocity_x, velocity_y)
        stick(contact)
        speed = math.sqrt(velocity_x * velocity_x + velocity_y * velocity_y)
        forces[r, 0] = contact.along * contact.x - contact.by_slip * contact.y
        forces[r, 1] = contact.along * contact.y + contact.by_slip * contact.x
        pressure, shear = -forces[r, 0] * normal_x - forces[r, 1] * normal_y, forces[r, 1] * normal_x - forces[r, 0] * normal_y
        if abs(shear) > mu_c[r] * pressure:
            # sticking would need a force outside the friction cone: the object moves as on the cone's edge on that side
            modes[r] = SLIDING
            if not slide_along(contact, sample, x, y, normal_x, normal_y, math.copysign(mu_c[r], shear), steps):
                outcome, modes[r] = ENDLESS, FREE
                continue
            forces[r, 0] = contact.along * contact.x - contact.by_slip * contact.y
            forces[r, 1] = contact.along * contact.y + contact.by_slip * contact.x
            velocity_x, velocity_y = contact.x - contact.slip * contact.y, contact.y + contact.slip * contact.x
            inward = velocity_x * normal_x + velocity_y * normal_y
            if not inward < 0:
                outcome, modes[r] = WEDGED, FREE
                continue
            speed = approach / inward
            velocity_x, velocity_y = velocity_x * speed, velocity_y * speed
        omega = contact.turn * speed
        twists[r, 0], twists[r, 1], twists[r, 2] = velocity_x + omega * y, velocity_y - omega * x, omega
    return outcome


def cone_each(contact: Contact, mu_c: Array, samples: Indices, points: Array, normals: Array, steps: int, cones: Array) -> int:
    """The motions (r, 2, 3) at the edges of r friction cones, towards -t first, the contact at unit speed.

    The arguments and what is returned: as for `push_each`.
    """
    for r in range(len(samples)):
        for side in range(2):
            edge = mu_c[r] if side else -mu_c[r]
            if not slide_along(contact, samples[r], points[r, 0], points[r, 1], normals[r, 0], normals[r, 1], edge, steps):
                return ENDLESS
            speed = math.sqrt(1 + contact.slip * contact.slip)
            omega = contact.turn / speed
            cones[r, side, 0] = (contact.x - contact.slip * contact.y) / speed + omega * points[r, 1]
            cones[r, side, 1] = (contact.y + contact.slip * contact.x) / speed - omega * points[r, 0]
            cones[r, side, 2] = omega
    return len(samples)
