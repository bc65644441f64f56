"""The likeliest mistake in the data of a run: each mistake is undone, and the evidence for the result is compared.

The motion of an observation is a point on a sphere: the direction of (v at the middle of the support points, rms arm * omega).
At a contact, friction allows the motions on which its moment about the contact vanishes (eq. 4), a curve on that sphere. So a
hypothesis gives a density: the distance from its curve has a Student distribution, whose scale is fitted to the run; a push is,
with a small probability, unlike all others; and the map that undoes the mistake counts with the area that it stretches. The w
of each hypothesis is fitted by reweighted least squares, and each parameter that is fitted costs half the logarithm of the
number of observations (Schwarz, "Estimating the dimension of a model", 1978). docs/derivation.md has the equations.
"""

import copy
import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array, left_of
from pushfric_core.geometry.support import rms_arm
from pushfric_core.solvers import least_weights
from pushfric_core.trajectories.observation import Observation
from pushfric_core.uncertainty.reasons import Reason, ReasonCode, contacts_displaced, line_off_sideways

FEWEST = 6
"""With fewer pushes, nothing is compared: any mistake leaves some w that explains them."""

COMPARED = 100
"""At most this many observations, evenly drawn, are compared."""

EFFECTIVE = 2.0
"""All observations of a push together count as this many: they share errors."""

BELIEVED, CHANGED = 6.0, 4.0
"""A mistake, and a change of the object, are reported if they are e to this times as likely as none, 400 and 50 times ..."""

POOR_MISFIT = 0.12
"""... or merely likelier, if without a mistake motions are off by more than this [rad], which good runs never are."""

FREEDOM = 3
"""Degrees of freedom of the Student distribution of distances from the curve."""

BAD_PUSH = 0.03
"""Probability of a push unlike all others, whose motion may be any."""

SCALES = np.geomspace(0.004, 1.5, 40)
"""Scales of the distances that are tried [rad]."""

USUAL, SPREAD = 0.04, 0.5
"""Median of the scale, in simulated and real runs [rad], and standard deviation of its logarithm."""

GRADUAL = 0.05
"""Within this share of the support's size about the centre of rotation, friction turns gradually from one way to the other."""

LEAST_SLOPE = 0.15
"""Slopes of the moment, in units of the support's size, count as this at least: where it hardly depends on the motion, it says
little."""

EVEN_WEIGHT = 0.02
"""Weight of even weights in a fit, as a share of that of the data: it keeps the fit defined."""

STEPS, MORE_STEPS = 4, 2
"""Steps of the reweighted least squares: from even weights, and from those of a similar fit."""

TURNS = 4
"""Number of times that unknowns and weights are found in turns."""

FINGERS = (0.012, 0.025)
"""Half distances of two fingers that are tried [m]."""

REACH = 0.06
"""Frames and contacts are looked for this far off [m]."""

SHIFTED, AFTER = 2, 6
"""A change is looked for before the last SHIFTED to AFTER pushes; the others show what the object was."""

LARGER = 0.75
"""Support points that span less than this share of the contacts leave a part of the object out."""

STEP = 1e-4
"""Step of a numerical slope."""

DAMPING = 1e-4
"""Keeps a step defined, and changes of the weights small."""

SLOWEST = 1e-6
"""Contacts move at this share of the tip's speed at least, in any unit of time."""

DEGREE = math.pi / 180


class Explanation(NamedTuple):
    """A hypothesis that explains the data better than no mistake."""

    reason: Reason
    gain: float  # logarithm of how much likelier it is than no mistake
    since: int | None = None  # a change: the first push after it
    shift: tuple[float, float] | None = None  # ... and by how much it shifts p_CF [m]
    size: float = math.inf  # by how much contacts or the motion's frame are off [m]; infinite if that is no length


class Comparison(NamedTuple):
    """The hypotheses that are believed, likeliest first; none: no mistake shows."""

    explanations: tuple[Explanation, ...] = ()
    misfit: float | None = None  # without a mistake, by how much motions are off [rad]; None: nothing was compared


class _Fit(NamedTuple):
    """How a hypothesis fits."""

    evidence: float
    scale: float  # [rad]
    w: Array


def compare(points: Array, observations: Sequence[Observation]) -> Comparison:
    """Compare what may be wrong with the data of a run.

    Args:
        points: (n, 2) support points [m].
        observations: of the run, in order.
    """
    if len({one.push_id for one in observations}) < FEWEST or len(points) < 3:
        return Comparison()
    run = _Run(points, observations)
    same = run.fitted(run.twists)
    run.w = same.w
    found = _explained(run)
    compared = [one._replace(gain=one.gain - same.evidence) for one in found]
    sure = same.scale <= POOR_MISFIT
    reported = [one for one in compared if one.gain > sure * (BELIEVED if one.since is None else CHANGED)]
    return Comparison(_unlike(sorted(reported, key=lambda one: -one.gain)), same.scale)


def _unlike(explanations: Iterable[Explanation]) -> tuple[Explanation, ...]:
    """The first of each code."""
    first: dict[ReasonCode, Explanation] = {}
    for one in explanations:
        first.setdefault(one.reason.code, one)
    return tuple(first.values())


LINEAR: tuple[tuple[ReasonCode, tuple[tuple[float, float, float], ...], str], ...] = (
    (
        ReasonCode.OMEGA_NEGATED,
        ((1, 0, 0), (0, 1, 0), (0, 0, -1)),
        "omega has the wrong sign: counter-clockwise, seen from above, is positive; negate omega",
    ),
    (
        ReasonCode.SPEEDS_IN_MILLIMETRES,
        ((1e-3, 0, 0), (0, 1e-3, 0), (0, 0, 1)),
        "vx and vy are in millimetres: give them in metres per unit of time",
    ),
    (
        ReasonCode.OMEGA_IN_DEGREES,
        ((1, 0, 0), (0, 1, 0), (0, 0, DEGREE)),
        "omega is in degrees: give it in radians per unit of time",
    ),
    (ReasonCode.SPEEDS_SWAPPED, ((0, 1, 0), (1, 0, 0), (0, 0, 1)), "vx and vy are swapped: swap their columns"),
    (
        ReasonCode.COLUMNS_MIXED,
        ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
        "the columns of the motion are mixed up: they seem to hold omega, vx, vy; expected vx, vy, omega",
    ),
    (
        ReasonCode.COLUMNS_MIXED,
        ((0, 0, 1), (1, 0, 0), (0, 1, 0)),
        "the columns of the motion are mixed up: they seem to hold vy, omega, vx; expected vx, vy, omega",
    ),
    (
        ReasonCode.MIRRORED,
        ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
        "the motion is mirrored, along y: the camera's image is, or an axis points the other way",
    ),
    (
        ReasonCode.MIRRORED,
        ((-1, 0, 0), (0, 1, 0), (0, 0, -1)),
        "the motion is mirrored, along x: the camera's image is, or an axis points the other way",
    ),
    (
        ReasonCode.CONTACTS_RECEDE,
        ((-1, 0, 0), (0, -1, 0), (0, 0, -1)),
        "the motion is that of the table against the object, or in another frame: vx, vy, omega must be the velocity of the "
        "object-frame origin, in the object frame",
    ),
)
"""Mistakes that a linear map undoes: code, matrix from the motion that was given to the right one, and what to do."""


def _explained(run: "_Run") -> Iterable[Explanation]:
    """Every hypothesis, with its evidence as gain."""
    price = 0.5 * math.log(run.size)
    for code, matrix, text in LINEAR:
        yield Explanation(
            Reason(code, text), run.fitted(run.twists @ np.array(matrix).T, run.stretch(np.array(matrix))).evidence
        )
    of_object = run.moved_origin(-run.contacts)
    text = (
        "vx and vy are the velocity of the contact, or of another point that moves over the object: give that of the "
        "object-frame origin"
    )
    yield Explanation(Reason(ReasonCode.TWIST_OF_CONTACT, text), run.fitted(of_object, run.area(of_object)).evidence)
    text = "the object was pushed with two fingers or an edge: give half_width, half of their distance, with each observation"
    evidence = max(run.fitted(run.twists, half_width=half_width).evidence for half_width in FINGERS)
    yield Explanation(Reason(ReasonCode.TWO_FINGERS, text), evidence)

    def origin(d: Array) -> tuple[Array, Array]:
        return run.moved_origin(d), run.contacts

    fit, d = run.nested(origin, 2, lambda d: run.area(run.moved_origin(d)))
    x, y = (-1e3 * d).tolist()
    text = (
        f"the motion seems to be that of a point at ({x:.0f}, {y:.0f}) mm, not of the object-frame origin: give poses and "
        "velocities of the frame in which outline and contacts are given"
    )
    yield Explanation(Reason(ReasonCode.ORIGIN_OFF, text), fit.evidence - 2 * price, size=math.hypot(*d))
    along = left_of(run.normals)
    fit, d = run.nested(lambda d: (run.twists, run.contacts + d[0] * along), 1)
    yield Explanation(line_off_sideways(float(d[0])), fit.evidence - price, size=math.hypot(*d))
    fit, d = run.nested(lambda d: (run.twists, run.contacts + d), 2)
    yield Explanation(contacts_displaced(*d.tolist()), fit.evidence - 2 * price, size=math.hypot(*d))
    if (wider := run.wider_points()) is not None:
        text = (
            "the support points leave a part of the object out, on which it seems to rest: check their unit, or give some "
            "further out"
        )
        yield Explanation(Reason(ReasonCode.SUPPORT_TOO_SMALL, text), run.over(wider).fitted(run.twists).evidence - price)
    change = run.changed()
    if change is not None:
        evidence, since, shift = change
        reason = Reason(ReasonCode.OBJECT_CHANGED, "")
        yield Explanation(reason, evidence - 3 * price - math.log(AFTER - SHIFTED + 1), since, shift)


class _Run:
    """The data of a run, as arrays of N observations."""

    def __init__(self, points: Array, observations: Sequence[Observation]) -> None:
        chosen = [
            observations[k] for k in np.linspace(0, len(observations) - 1, min(len(observations), COMPARED)).round().astype(int)
        ]
        self.contacts = np.array([one.contact_point for one in chosen])
        self.normals = np.array([one.contact_normal for one in chosen])
        self.twists = np.array([one.twist for one in chosen])
        self._tips = np.array([one.tip_velocity or (0.0, 0.0) for one in chosen])
        self._told = self._tips.any(axis=1)  # whose tip's velocity is known
        arrived = dict.fromkeys(one.push_id for one in chosen)
        self._pushes = list(arrived)
        places = {push: place for place, push in enumerate(arrived)}
        self._place = np.array([places[one.push_id] for one in chosen])
        self._weights = np.minimum(1.0, EFFECTIVE / np.bincount(self._place)[self._place])
        self.size = float(self._weights.sum())
        self._middle = points.mean(axis=0)
        self._arm = rms_arm(points) or 1.0
        self._points = points
        self.w = np.full(len(points), 1 / len(points))  # that explains the data best if nothing is wrong

    def over(self, points: Array) -> "_Run":
        """The same data over other support points, measured in the same units."""
        other = copy.copy(self)
        other._points = points
        return other

    # --- maps of the motion ---

    def moved_origin(self, d: Array) -> Array:
        """The twists (N, 3) of the points that lie at d from those whose twists were given."""
        twists = self.twists.copy()
        twists[:, :2] += twists[:, 2:] * left_of(np.broadcast_to(d, (len(twists), 2)))
        return twists

    def stretch(self, matrix: Array) -> Array:
        """Logarithms (N,) of the areas to which a linear map of the twist stretches areas of directions."""
        return self.area(self.twists @ matrix.T) + math.log(abs(float(np.linalg.det(matrix))))

    def area(self, twists: Array) -> Array:
        """The same for maps to these twists (N, 3) that preserve volume."""
        return np.asarray(
            -3 * np.log(np.linalg.norm(self._scaled(twists), axis=1) / np.linalg.norm(self._scaled(self.twists), axis=1))
        )

    def _scaled(self, twists: Array) -> Array:
        """(v at the middle, arm * omega) (N, 3)."""
        velocities = twists[:, :2] + twists[:, 2:] * left_of(self._middle)
        return np.column_stack((velocities, self._arm * twists[:, 2]))

    # --- fits ---

    def fitted(self, twists: Array, area: Array | float = 0.0, half_width: float = 0.0, contacts: Array | None = None) -> _Fit:
        """The w that explains these motions best, and the evidence for them."""
        curves = _Curves(self, twists, self.contacts if contacts is None else contacts)
        w = curves.explained(half_width)
        return self._judged(curves, w, area, half_width)

    def _judged(self, curves: "_Curves", w: Array, area: Array | float, half_width: float = 0.0) -> _Fit:
        distances, slack = curves.distances(w, half_width)
        evidence, scale = self._evidence(np.hypot(distances, curves.wrong_way(w)), slack if half_width else None)
        return _Fit(evidence + self.followed(curves.speeds) + float(np.sum(self._weights * area)), scale, w)

    def followed(self, speeds: Array) -> float:
        """Evidence that contacts with these outward speeds (N,) follow the tip, whose unit of time may be another one."""
        if self._told.sum() < FEWEST:
            return 0.0
        return self._evidence(self.mismatches(speeds), weights=self._weights * self._told)[0]

    def mismatches(self, speeds: Array) -> Array:
        """By how much contacts with these outward speeds (N,) miss the tip, over its speed; zero where that is unknown.

        The unit of time of the tip may be another one.
        """
        missed = np.zeros(len(speeds))
        if self._told.sum() >= FEWEST:
            tips, normals = self._tips[self._told], self.normals[self._told]
            tip_speeds, size = np.sum(tips * normals, axis=1), np.linalg.norm(tips, axis=1)
            ratios = speeds[self._told] / np.where(tip_speeds == 0, np.inf, tip_speeds)
            factor = max(float(np.median(ratios)), SLOWEST)
            missed[self._told] = np.clip((speeds[self._told] / factor - tip_speeds) / size, -10, 10)
        return missed

    def _off(self, curves: "_Curves", w: Array) -> Array:
        """Distances from the curves, and mismatches with the tip (2 N,)."""
        return np.concatenate((curves.distances(w)[0], self.mismatches(curves.speeds)))

    def _evidence(self, distances: Array, slack: Array | None = None, weights: Array | None = None) -> tuple[float, float]:
        """Logarithm of the density of distances (N,) [rad], evenly spread over +-slack if that is given, and its scale."""
        x, scales = distances, SCALES[:, None]
        weights = self._weights if weights is None else weights
        if slack is None:
            logs = STUDENT - np.log(scales) - (FREEDOM + 1) / 2 * np.log1p((x / scales) ** 2 / FREEDOM)
        else:
            inside = _student((x + slack) / scales) - _student((x - slack) / scales)
            logs = np.log(np.maximum(inside, 1e-12) / (2 * slack))
        pushes = len(self._pushes)
        totals = np.zeros((len(SCALES), pushes))
        np.add.at(totals.T, self._place, (weights * logs).T)
        masses = np.bincount(self._place, weights=weights, minlength=pushes)
        unlike = math.log(BAD_PUSH) - math.log(math.pi) * masses
        prior = -0.5 * (np.log(SCALES / USUAL) / SPREAD) ** 2
        evidence = np.logaddexp(math.log(1 - BAD_PUSH) + totals, unlike).sum(axis=1) + prior
        best = int(evidence.argmax())
        return float(evidence[best]), float(SCALES[best])

    def nested(
        self,
        model: Callable[[Array], tuple[Array, Array]],
        unknowns: int,
        area: Callable[[Array], Array | float] = lambda d: 0.0,
    ) -> tuple[_Fit, Array]:
        """The unknowns (k,) of a model of twists and contacts that explain the data best, in turns with w."""
        d, best, found, w = np.zeros(unknowns), None, np.zeros(unknowns), self.w
        for last in (False,) * TURNS + (True,):
            twists, contacts = model(d)
            curves = _Curves(self, twists, contacts)
            w = curves.explained(start=w)
            fit = self._judged(curves, w, area(d))
            if best is None or fit.evidence > best.evidence:
                best, found = fit, d
            if last:
                break
            here = self._off(curves, w)
            slopes = np.column_stack(
                [(self._off(_Curves(self, *model(d + STEP * unit)), w) - here) / STEP for unit in np.eye(unknowns)]
            )
            # the weights give way, so that the unknowns need not follow them step by step
            giving = curves.by_weights(w)
            slopes = np.column_stack((slopes, np.concatenate((giving, np.zeros_like(giving)))))
            step = self._least_squares(slopes, here, np.concatenate((self._weights, self._weights)))
            d = np.clip(d - step[:unknowns], -REACH, REACH)
        assert best is not None
        return best, found

    def _least_squares(self, slopes: Array, values: Array, weights: Array | None = None) -> Array:
        """The robust solution of slopes @ x = values."""
        typical = max(float(np.median(np.abs(values))), SCALES[0])
        share = (self._weights if weights is None else weights) / (1 + (values / (1.5 * typical)) ** 2)
        squares = (slopes.T * share) @ slopes
        return np.asarray(np.linalg.solve(squares + DAMPING * np.eye(len(squares)), (slopes.T * share) @ values))

    def wider_points(self) -> Array | None:
        """Support points over all that the contacts enclose; None if the support points do already."""
        size = np.ptp(self.contacts, axis=0)
        if (np.ptp(self._points, axis=0) > LARGER * size).any() or not size.min() > 0:
            return None
        try:
            hull = np.array(_hull(self.contacts))
            return Outline(hull).grid(8, 8, 0.0)
        except ValueError:
            return None

    def changed(self) -> tuple[float, int, tuple[float, float]] | None:
        """The likeliest shift of p_CF before one of the last pushes: evidence, first push after it, shift [m]."""
        count = len(self._pushes)
        best: tuple[float, int, tuple[float, float]] | None = None
        curves = _Curves(self, self.twists, self.contacts)
        for first in range(max(count - AFTER, FEWEST - 1), count - SHIFTED + 1):
            before = self._place < first
            earlier = curves.of(before)
            w = earlier.explained(start=self.w)
            load = w + 0.2 / len(w)
            arms = self._points - w @ self._points
            loaded = load[:, None] * arms
            tilt = loaded @ np.linalg.pinv(loaded.T @ arms)
            after, shift = curves.of(~before), np.zeros(2)
            for _ in range(STEPS):
                here = after.distances(_tilted(w, tilt @ shift))[0]
                slopes = np.column_stack(
                    [(after.distances(_tilted(w, tilt @ (shift + STEP * unit)))[0] - here) / STEP for unit in np.eye(2)]
                )
                shift = shift - self._least_squares(slopes, here, self._weights[~before])
            moved = _tilted(w, tilt @ shift)
            distances = np.empty(len(before))
            distances[before], distances[~before] = earlier.distances(w)[0], after.distances(moved)[0]
            wrong = np.where(before, curves.wrong_way(w), curves.wrong_way(moved))
            evidence = self._evidence(np.hypot(distances, wrong))[0] + self.followed(curves.speeds)
            if best is None or evidence > best[0]:
                x, y = (moved @ self._points - w @ self._points).tolist()
                best = evidence, self._pushes[first], (x, y)
        return best


class _Curves:
    """The moments about the contacts, and their slopes along the sphere, per unit weight of each support point."""

    def __init__(self, run: _Run, twists: Array, contacts: Array) -> None:
        scaled = run._scaled(twists)
        self._directions = u = scaled / np.linalg.norm(scaled, axis=1, keepdims=True)
        self._normals, self._weights, self._arm = run.normals, run._weights, run._arm
        at = (run._points - run._middle) / run._arm
        vx, vy = u[:, :1] - u[:, 2:] * at[:, 1], u[:, 1:2] + u[:, 2:] * at[:, 0]
        speed = np.sqrt(vx * vx + vy * vy + GRADUAL**2)
        self._fx, self._fy = fx, fy = -vx / speed, -vy / speed
        ax, ay = ((run._points[:, k] - contacts[:, k : k + 1]) / run._arm for k in (0, 1))
        self._moments = ax * fy - ay * fx
        # of the moment, with the velocity of the support point
        by_x = (ax * fx * fy + ay * (1 - fx * fx)) / speed
        by_y = (-ax * (1 - fy * fy) - ay * fx * fy) / speed
        self._slopes = by_x, by_y, by_y * at[:, 0] - by_x * at[:, 1]
        velocities = twists[:, :2] + twists[:, 2:] * left_of(contacts)
        self.speeds = np.sum(velocities * run.normals, axis=1)  # of the contacts, outward
        self._outward = np.maximum(self.speeds / np.maximum(np.linalg.norm(velocities, axis=1), 1e-12), 0.0)

    def of(self, chosen: npt.NDArray[np.bool_]) -> "_Curves":
        """Those of some observations."""
        other = copy.copy(self)
        for name in ("_directions", "_normals", "_weights", "_fx", "_fy", "_moments", "_outward", "speeds"):
            setattr(other, name, getattr(self, name)[chosen])
        other._slopes = tuple(slope[chosen] for slope in self._slopes)
        return other

    def distances(self, w: Array, half_width: float = 0.0) -> tuple[Array, Array]:
        """Distances of the motions from the curves (N,) [rad], and the reach of these for contacts anywhere within a width."""
        slope = self._slope(w)
        slack = half_width / self._arm * np.abs(self._pressed(w)) / slope
        return self._moments @ w / slope, np.maximum(slack, SCALES[0])

    def by_weights(self, w: Array) -> Array:
        """How distances change with each weight (N, n), at the cost of all others."""
        changes = self._moments / self._slope(w)[:, None]
        return np.asarray(changes - (changes @ w)[:, None])

    def wrong_way(self, w: Array) -> Array:
        """Sines (N,) of the angles by which contacts recede, and pushers pull."""
        size = np.hypot(self._fx @ w, self._fy @ w)
        return np.asarray(np.maximum(self._outward, np.maximum(-self._pressed(w) / np.maximum(size, 1e-9), 0.0)))

    def _pressed(self, w: Array) -> Array:
        """Friction along the normals: that of the pusher is opposite."""
        return np.asarray((self._fx @ w) * self._normals[:, 0] + (self._fy @ w) * self._normals[:, 1])

    def _slope(self, w: Array) -> Array:
        slope = np.column_stack([one @ w for one in self._slopes])
        slope -= np.sum(slope * self._directions, axis=1, keepdims=True) * self._directions
        return np.asarray(np.sqrt(np.sum(slope**2, axis=1) + LEAST_SLOPE**2))

    def explained(self, half_width: float = 0.0, start: Array | None = None) -> Array:
        """The w (n,) that brings the motions nearest to their curves."""
        n = self._moments.shape[1]
        w = np.full(n, 1 / n) if start is None else start
        even = np.eye(n) - 1 / n
        for _ in range(STEPS if start is None else MORE_STEPS):
            slope = self._slope(w)
            distances, slack = self.distances(w, half_width)
            beyond = np.abs(distances) - (slack if half_width else 0.0)
            typical = max(float(np.median(np.maximum(beyond, 0.0))), float(SCALES[0]))
            share = self._weights / (1 + (np.maximum(beyond, 0.0) / (1.5 * typical)) ** 2) / slope**2
            if half_width:
                share = share * (0.05 + (beyond > 0))
            w = least_weights((self._moments.T * share) @ self._moments + EVEN_WEIGHT**2 * share.mean() * even, w)
        return w


def _tilted(w: Array, change: Array) -> Array:
    """Weights with a change (n,); none becomes negative, so that p_CF stays on the support."""
    moved = np.maximum(w + change, 0.0)
    return np.asarray(moved / moved.sum())


def _hull(points: Array) -> list[tuple[float, float]]:
    import shapely

    return list(shapely.MultiPoint(points).convex_hull.exterior.coords)[:-1]


def _student(x: Array) -> Array:
    """Distribution function of the Student distribution with FREEDOM degrees."""
    y = x / math.sqrt(3)
    return np.asarray(0.5 + (y / (1 + y * y) + np.arctan(y)) / math.pi)


STUDENT = math.lgamma((FREEDOM + 1) / 2) - math.lgamma(FREEDOM / 2) - 0.5 * math.log(FREEDOM * math.pi)
"""Logarithm of its density at zero."""
