"""The inner loops of `linearisation` and `fit`, compiled.

`inner_loops.pxd` declares the types of this module (see `mechanics.least_dissipation`).
"""

import math

import numpy as np
import numpy.typing as npt

from pushfric_core.belief.stretches import TINY
from pushfric_core.geometry.planar import Array, Indices
from pushfric_core.mechanics.least_dissipation import SLIDING, STICKING


def slopes_each(
    points: Array,
    w: Array,
    middle: Array,
    arm: float,
    rounding: float,
    reach: float,
    contacts: Array,
    normals: Array,
    turns: Array,
    stretch: Indices,
    twists: Array,
    modes: npt.NDArray[np.int8],
    forces: Array,
    by_push: Array,
    unknown: Array,
) -> None:
    """Add up, for k stretches of r steps, how n supports move the object.

    If the tip sticks, only the turn about the contact is free. If it slides, the wrench keeps the direction of the cone's edge,
    so that the contact gives way across the force alone, and the object turns; the tip prescribes the contact's velocity along
    the normal, so that a change of it is made up for along the motion.

    Args:
        points: (n, 2) the supports [m].
        w: (n,) support friction distribution.
        middle: (2,) of the supports [m].
        arm: at which a turn counts [m].
        rounding: Coulomb's law has a corner rounded by this much times the turn [m].
        reach: supports nearer to the centre of rotation push partly in an unknown direction [m].
        contacts: (r, 2) [m].
        normals: (r, 2) unit, outward.
        turns: (r,) of the object since the middle of its stretch [rad].
        stretch: (r,) of each step.
        twists: (r, 3) that are foretold.
        modes: (r,) in which the tip meets the object.
        forces: (r, 2) that are foretold.
        by_push: (k, 3, n) zeros; receives the motion, as `Linearised.errors`, for each unit of weight more.
        unknown: (k, 3, 2n) zeros; receives that by pushes along x, and along y, of what pushes in no known direction.
    """
    n = len(points)
    # directions in which the supports push, and the weight that pushes in no known direction
    pushes_x, pushes_y, open_ = np.empty((3, n))
    # motions: in which the contact gives way, a turn about it, and by a unit of force and of moment
    gives, turned, per_force, per_moment = np.empty((4, 3))
    for r in range(len(contacts)):
        at_x, at_y, turn, k = contacts[r, 0], contacts[r, 1], twists[r, 2], stretch[r]
        x, y = twists[r, 0] - turn * at_y, twists[r, 1] + turn * at_x  # velocity of the contact
        rounded, near = rounding * turn, reach * abs(turn) + TINY
        # how the wrench of the supports changes with the motion: it is symmetrical
        of_xx = of_xy = of_yy = of_xt = of_yt = of_tt = 0.0
        for j in range(n):
            ahead, across = at_y - points[j, 1], points[j, 0] - at_x  # velocity of the support per turn about the contact
            push_x, push_y = x + turn * ahead, y + turn * across
            square = push_x * push_x + push_y * push_y
            slowness = 1 / (math.sqrt(square + rounded * rounded) + TINY)
            push_x, push_y, share = push_x * slowness, push_y * slowness, w[j] * slowness
            xx, xy, yy = share * (1 - push_x * push_x), -share * push_x * push_y, share * (1 - push_y * push_y)
            xt, yt = xx * ahead + xy * across, xy * ahead + yy * across
            of_xx, of_xy, of_yy = of_xx + xx, of_xy + xy, of_yy + yy
            of_xt, of_yt, of_tt = of_xt + xt, of_yt + yt, of_tt + ahead * xt + across * yt
            pushes_x[j], pushes_y[j] = push_x, push_y
            open_[j] = w[j] * max(1 - math.sqrt(square) / near, 0.0)
        # the contact gives way along (give_x, give_y) with (give_t): by a force across the tip's, and by a moment
        give_x = give_y = give_t = aside_x = aside_y = by_force = by_both = 0.0
        force = math.sqrt(forces[r, 0] * forces[r, 0] + forces[r, 1] * forces[r, 1])
        if modes[r] == STICKING:
            by_moment = 1 / max(of_tt, TINY)
        elif modes[r] == SLIDING and force > TINY:  # with all the weight at the contact, a turn about it costs nothing
            aside_x, aside_y = -forces[r, 1] / force, forces[r, 0] / force
            least = TINY * (of_xx + of_yy + of_tt / (arm * arm))
            own = of_xx * aside_x * aside_x + 2 * of_xy * aside_x * aside_y + of_yy * aside_y * aside_y + least
            both, of_turn = of_xt * aside_x + of_yt * aside_y, of_tt + least * arm * arm
            determinant = own * of_turn - both * both
            by_force, by_both, by_moment = of_turn / determinant, -both / determinant, own / determinant
            inward = min(x * normals[r, 0] + y * normals[r, 1], -TINY)
            made_up = (aside_x * normals[r, 0] + aside_y * normals[r, 1]) / inward
            give_x, give_y, give_t = aside_x - made_up * x, aside_y - made_up * y, -made_up * turn
        else:
            continue
        # the same motion, and a turn about the contact, at the middle, in the axes of the object half-way through the stretch
        cosine, sine, ahead, across = math.cos(turns[r]), math.sin(turns[r]), at_y - middle[1], middle[0] - at_x
        give_x, give_y = give_x + give_t * ahead, give_y + give_t * across
        gives[0], gives[1] = cosine * give_x - sine * give_y, sine * give_x + cosine * give_y
        turned[0], turned[1] = cosine * ahead - sine * across, sine * ahead + cosine * across
        gives[2], turned[2] = arm * give_t, arm
        for i in range(3):
            per_force[i] = gives[i] * by_force + turned[i] * by_both
            per_moment[i] = gives[i] * by_both + turned[i] * by_moment
        for j in range(n):
            ahead, across, free = at_y - points[j, 1], points[j, 0] - at_x, open_[j]
            push = aside_x * pushes_x[j] + aside_y * pushes_y[j]
            moment = ahead * pushes_x[j] + across * pushes_y[j]
            for i in range(3):
                by_push[k, i, j] -= per_force[i] * push + per_moment[i] * moment
                if free > 0:
                    unknown[k, i, j] += free * (per_force[i] * aside_x + per_moment[i] * ahead)
                    unknown[k, i, n + j] += free * (per_force[i] * aside_y + per_moment[i] * across)


def sum_each(middle: Array, arm: float, turns: Array, stretch: Indices, motions: Array, sums: Array) -> None:
    """Add up the motions of the steps of each stretch, in the axes of the object half-way through it.

    Args:
        middle, arm, turns, stretch: as for `slopes_each`.
        motions: (r, 3) of the object-frame origin.
        sums: (k, 3) zeros; receives the velocity of the middle, and the arm times the turn.
    """
    for r in range(len(motions)):
        k, cosine, sine = stretch[r], math.cos(turns[r]), math.sin(turns[r])
        x, y = motions[r, 0] - motions[r, 2] * middle[1], motions[r, 1] + motions[r, 2] * middle[0]
        sums[k, 0] += cosine * x - sine * y
        sums[k, 1] += sine * x + cosine * y
        sums[k, 2] += arm * motions[r, 2]


def whiten_each(roots: Array, values: Array) -> None:
    """Solve, for k lower triangular roots (k, 3, 3), root x = values (k, 3, c), and put x in the values' place."""
    for k in range(len(roots)):
        for j in range(values.shape[2]):
            x = values[k, 0, j] / roots[k, 0, 0]
            y = (values[k, 1, j] - roots[k, 1, 0] * x) / roots[k, 1, 1]
            values[k, 0, j], values[k, 1, j] = x, y
            values[k, 2, j] = (values[k, 2, j] - roots[k, 2, 0] * x - roots[k, 2, 1] * y) / roots[k, 2, 2]


def rescaled(errors: Array, own: Array, share: Array, freedom: Indices, nu: float, left: float, scale: float) -> float:
    """The scale [m] of a Student distribution of errors, once more from what it was taken for.

    Args:
        errors: (k, 3) [m].
        own: (k, 3, 3) covariances that they have besides [m^2].
        share: (k,) variance of the errors as a share of the squared scale.
        freedom: (k,) dimensions of the errors.
        nu: degrees of freedom of the distribution.
        left: degrees of freedom of all errors together.
        scale: that was found before [m].
    """
    total = 0.0
    for k in range(len(errors)):
        x, y, z, more = errors[k, 0], errors[k, 1], errors[k, 2], scale * scale * share[k]
        xx, yy, zz = own[k, 0, 0] + more, own[k, 1, 1] + more, own[k, 2, 2] + more
        xy, xz, yz = own[k, 0, 1], own[k, 0, 2], own[k, 1, 2]
        of_x, of_xy, of_xz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        square = x * x * of_x + y * y * (xx * zz - xz * xz) + z * z * (xx * yy - xy * xy)
        square += 2 * (x * y * of_xy + x * z * of_xz + y * z * (xy * xz - xx * yz))
        size = max(square, 0.0) / (xx * of_x + xy * of_xy + xz * of_xz)  # of exact data, rounding may leave less than 0
        total += (nu + freedom[k]) / (nu + size) * size
    return scale * math.sqrt(total / left)


def student(off: Array, freedom: Indices, nu: float, weights: Array) -> float:
    """The negative log likelihood of errors of unit variance with a Student distribution, but for a constant.

    Args:
        off: (3k + f,) the errors of k stretches, and those of f forces.
        freedom: (k,) dimensions of the stretches' errors.
        nu: degrees of freedom of the distribution.
        weights: (3k + f,) receives the weights of the errors: small for outliers.
    """
    told = 0.0
    for k in range(len(freedom)):
        x, y, z = off[3 * k], off[3 * k + 1], off[3 * k + 2]
        square = x * x + y * y + z * z
        told += (nu + freedom[k]) * math.log1p(square / nu)
        for j in range(3 * k, 3 * k + 3):
            weights[j] = (nu + freedom[k]) / (nu + square)
    for j in range(3 * len(freedom), len(off)):
        square = off[j] * off[j]
        told += (nu + 1) * math.log1p(square / nu)
        # a force that is no larger than mu_c allows says nothing
        weights[j] = (nu + 1) / (nu + square) if square > 0 else 0.0
    return told / 2
