"""Predictions of an estimate: where a push takes the object, which pushes hold it, and how far each answer can be trusted."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.geometry.planar import Array, as_array, frozen, left_of, velocity_at
from pushfric_core.geometry.support import Support, center_of_friction, check_points, rms_arm
from pushfric_core.mechanics import quasi_static
from pushfric_core.mechanics.quasi_static import MODES, SUM, ContactMode, Motions
from pushfric_core.records import FieldPlace, comparable
from pushfric_core.trajectories.observation import Observation
from pushfric_core.wording import counted

SHARE = 0.9
"""The truth lies within a spread this often."""

ELLIPSOID = 6.251
"""x' C^-1 x at the edge of the ellipsoid of a normal distribution in space that holds SHARE of it."""

STICKING = 1e6
"""A contact friction coefficient with which no tip slides."""

ELLIPSE = -2 * math.log(1 - SHARE)
"""x' C^-1 x at the edge of the ellipse of a normal distribution in the plane that holds SHARE of it."""


class Kind(StrEnum):
    """The evidence for mu_c."""

    BOUND = "bound"  # pushes that stick, or forces that do: mu_c has no upper end
    SLIP = "slip"  # the motions of pushes
    FORCE = "force"  # forces measured while the tip slid, and the motions


class MuC(NamedTuple):
    """The contact friction coefficient."""

    value: float | None  # None if there is only a bound
    low: Annotated[float, FieldPlace(key="interval")]  # mu_c lies in [low, high] with a probability of 90 %
    high: Annotated[float, FieldPlace(key="interval")]  # infinite if there is only a bound
    kind: Kind


def ellipse_radius(covariance: Array) -> float:
    """Radius of the smallest circle that contains the 90 % ellipse of a covariance (2, 2), about the same middle."""
    return math.sqrt(ELLIPSE * float(np.linalg.eigvalsh(covariance)[-1]))


@comparable
@dataclass(frozen=True)
class FrictionModel:
    """How an object slides: samples of what w and mu_c may be. A single sample is an estimate taken as exact.

    Args:
        support_points: (n, 2) object frame [m].
        w: (s, n) support friction distributions, >= 0, each with sum 1.
        mu_c: (s,) contact friction coefficients, >= 0 and finite.
        share: (s,) weights of the samples, sum 1.
        misfit: 90 % of new observations are off by less than this share of the tip's way, apart from what the samples differ
            in: a motion as (v at p_CF, length * omega).
        sliding_misfit: the same where the tip slides.
        stroke_misfit: the same of whole strokes, in which the noise of observations cancels.
        covariance: (2, 2) of p_CF about the truth [m^2]; None: the pushes do not show it, or nothing was learned from pushes.
        kind: what mu_c rests on; None: it is given.
        data_points: number of observations that the model was learned from.
    Raises:
        ValueError: shapes that do not fit, or values that make no sense.

    Example:
        >>> from pushfric_core import TABLE_1, FrictionModel
        >>> known = TABLE_1["wood_rect4"]
        >>> model = FrictionModel.of(known.support, known.mu_c)
        >>> model.center_of_friction.tolist(), model.median_mu_c
        ([0.0, 0.0], 0.3)
    """

    support_points: Array
    w: Array
    mu_c: Array
    share: Annotated[Array, FieldPlace("weights")]
    misfit: float = 0.0
    sliding_misfit: float = 0.0
    stroke_misfit: float = 0.0
    covariance: Array | None = None
    kind: Annotated[Kind | None, FieldPlace("")] = None
    data_points: Annotated[int, FieldPlace("")] = 0

    def __post_init__(self) -> None:
        points = check_points(self.support_points)
        w, mu_c = frozen(self.w), frozen(self.mu_c)
        quasi_static.check_samples(points, w, mu_c)
        share = frozen(self.share)
        if share.shape != (len(w),) or not (share >= 0).all() or not abs(share.sum() - 1) < SUM:
            raise ValueError(f"share must have shape ({len(w)},), nonnegative with sum 1, got {share.tolist()}")
        for name in ("misfit", "sliding_misfit", "stroke_misfit"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be finite and not negative, got {getattr(self, name)}")
        for name, array in (("support_points", points), ("w", w), ("mu_c", mu_c), ("share", share)):
            object.__setattr__(self, name, array)
        if self.covariance is not None:
            object.__setattr__(self, "covariance", frozen(self.covariance))

    def __repr__(self) -> str:
        x, y = 1e3 * self.center_of_friction
        samples = f"{counted(len(self.w), 'sample')} over {counted(len(self.support_points), 'support point')}"
        return f"<FrictionModel: p_CF ({x:z.2f}, {y:z.2f}) mm, mu_c {self.median_mu_c:.3f}, {samples}>"

    @classmethod
    def of(cls, support: Support, mu_c: float) -> FrictionModel:
        """The model of a single sample, without a misfit."""
        return cls(support.points, support.weights[None], np.array((mu_c,)), np.ones(1))

    @cached_property
    def support(self) -> Support:
        """The mean of the support friction distributions."""
        mean = self.share @ self.w
        return Support(self.support_points, mean / mean.sum())

    def drawn(self, count: int) -> list[FrictionModel]:
        """Models of a single sample each, in proportion to the weights: those at evenly spaced quantiles, always the same.

        Raises:
            ValueError: count < 1.
        """
        if count < 1:
            raise ValueError(f"count must be at least 1, got {count}")
        levels = (np.arange(count) + 0.5) / count
        rows = np.minimum(np.searchsorted(np.cumsum(self.share), levels), len(self.w) - 1)
        return [self._with(self.w[k], float(self.mu_c[k])) for k in rows]

    @cached_property
    def mean(self) -> FrictionModel:
        """The model of a single sample: the mean friction, which is the mean of w and the median of mu_c."""
        return self._with(self.support.weights, self.median_mu_c)

    def _with(self, w: Array, mu_c: float) -> FrictionModel:
        """The same with a single sample."""
        return replace(self, w=w[None], mu_c=np.array((mu_c,)), share=np.ones(1), covariance=None, kind=None, data_points=0)

    @property
    def with_mean(self) -> tuple[Array, Array]:
        """w (s + 1, n) and mu_c (s + 1,) of the samples, the last ones of their mean; of a single sample, only its own."""
        if len(self.w) == 1:
            return self.w, self.mu_c
        return np.vstack((self.w, self.support.weights)), np.append(self.mu_c, self.median_mu_c)

    @property
    def confidence(self) -> float | None:
        """Radius about p_CF that holds the true one with a probability of 90 % [m]; None without a covariance."""
        return None if self.covariance is None else ellipse_radius(self.covariance)

    @property
    def samples(self) -> list[dict[str, Any]]:
        """Its samples as files name them: `w`, `mu_c` and `weight` of each."""
        rows = zip(self.w.tolist(), self.mu_c.tolist(), self.share.tolist(), strict=True)
        return [{"w": w, "mu_c": mu_c, "weight": weight} for w, mu_c, weight in rows]

    @cached_property
    def intervals(self) -> Array:
        """(n, 2) low and high: each w_j lies between them in 90 % of the samples."""
        return np.quantile(self.w, ((1 - SHARE) / 2, (1 + SHARE) / 2), axis=0).T

    @cached_property
    def known_mu_c(self) -> MuC | None:
        """mu_c with its interval, as far as pushes have shown it."""
        if self.kind is None:
            return None
        if self.kind is Kind.BOUND:
            return MuC(None, float(np.quantile(self.mu_c, 1 - SHARE)), math.inf, self.kind)
        low, high = np.quantile(self.mu_c, ((1 - SHARE) / 2, (1 + SHARE) / 2)).tolist()
        return MuC(self.median_mu_c, low, high, self.kind)

    @property
    def limit(self) -> str | None:
        """Where its predictions may not hold, in words; None: nowhere that is known."""
        known = self.known_mu_c
        if known is None or known.value is not None:
            return None
        return f"mu_c is only known to be at least {known.low:.2f}: if the tip slides, the predictions may not hold"

    @cached_property
    def median_mu_c(self) -> float:
        """The median contact friction coefficient."""
        return float(np.quantile(self.mu_c, 0.5))

    @cached_property
    def center_of_friction(self) -> Array:
        """p_CF (2,) of the mean [m]."""
        return center_of_friction(self.support.points, self.support.weights)

    @cached_property
    def length(self) -> float:
        """Arm at which a rotation counts as much as a translation, and a moment as much as a force [m].

        The rms distance of the support points from their middle; 1 if there is only one point.
        """
        return rms_arm(self.support_points) or 1.0

    def angles(self, twists: npt.ArrayLike, others: npt.ArrayLike) -> Array:
        """Angles (...) between twists (..., 3) as (v at p_CF, length * omega) [rad]; pi/2 if one of the two is zero."""
        a, b = self.centered(twists), self.centered(others)
        sizes = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
        cosines = np.sum(a * b, axis=-1) / np.where(sizes > 0, sizes, 1.0)
        return np.asarray(np.arccos(np.clip(cosines, -1.0, 1.0)))

    def centered(self, twists: npt.ArrayLike) -> Array:
        """Twists (..., 3) as (v at p_CF, length * omega) [m/s]."""
        twists = as_array(twists)
        omega = twists[..., 2:]
        return np.concatenate((twists[..., :2] + omega * left_of(self.center_of_friction), self.length * omega), axis=-1)


@comparable
class Predictions(NamedTuple):
    """The effect of k pushes: the motion of the mean friction, and how those of the samples scatter about it.

    Example:
        >>> from pushfric_core import TABLE_1, FrictionModel, predict
        >>> known = TABLE_1["wood_rect4"]
        >>> found = predict(FrictionModel.of(known.support, known.mu_c), [(0.0, -0.032)], [(0.0, -1.0)], [(0.0, 0.02)])
        >>> found.modes[0].value, float(found.spread[0])
        ('sticking', 0.0)
    """

    twists: Array  # (k, 3) of the object-frame origin, object frame, per the unit of time of the tip's velocity
    modes: tuple[ContactMode, ...]  # how the tip meets the object in each push
    forces: Array  # (k, 2) of the pusher ON the object, object frame; unit: the support friction of the translating object
    spread: Array  # (k,) 90 % of measured twists lie within this angle of the predicted one [rad], see FrictionModel.angles
    samples: Motions  # of each push and sample
    covariance: Array  # (k, 3, 3) of the measured twist about the predicted one: of the samples, and of the misfit


def predict(
    model: FrictionModel, contact_points: npt.ArrayLike, contact_normals: npt.ArrayLike, tip_velocities: npt.ArrayLike
) -> Predictions:
    """How the object moves under each of k pushes, at that instant.

    If the tip moves away from the object, or along it, the object stays at rest: the mode is FREE, and the twist zero.

    Args:
        model: of the object.
        contact_points: (k, 2) object frame [m].
        contact_normals: (k, 2) unit, outward.
        tip_velocities: (k, 2) object frame [m per any unit of time].
    Raises:
        ValueError: shapes that do not fit, or values that are not finite.
        SolverFailed: a motion did not converge.

    Example:
        >>> from pushfric_core import TABLE_1, FrictionModel, predict
        >>> known = TABLE_1["wood_rect4"]
        >>> model = FrictionModel.of(known.support, known.mu_c)
        >>> found = predict(model, [(0.0, -0.032)], [(0.0, -1.0)], [(0.0, 0.02)])
        >>> found.modes[0].value, round(float(found.twists[0, 1]), 4)
        ('sticking', 0.02)
    """
    w, mu_c = model.with_mean
    moved = quasi_static.motions(model.support_points, w, mu_c, contact_points, contact_normals, tip_velocities)
    twists, modes, forces = moved.twists[:, -1], moved.modes[:, -1], moved.forces[:, -1]
    count = len(model.w)
    samples = Motions(moved.twists[:, :count], moved.modes[:, :count], moved.forces[:, :count])
    moves = modes != quasi_static.FREE
    off = np.where(moves, _misfits(model, modes) * np.linalg.norm(as_array(tip_velocities), axis=-1), 0.0)
    spread = np.where(moves, _spread(model, samples.twists, twists, off), 0.0)
    covariance = scattered(samples.twists, twists, model.share) + of_misfit(model, off)
    return Predictions(twists, tuple(MODES[mode] for mode in modes), forces, spread, samples, covariance)


def _misfits(model: FrictionModel, modes: npt.NDArray[np.int8]) -> Array:
    """The misfit of each mode (k,)."""
    return np.asarray(np.where(modes == quasi_static.SLIDING, model.sliding_misfit, model.misfit))


def _spread(model: FrictionModel, samples: Array, twists: Array, off: Array) -> Array:
    """Angles (k,) about twists (k, 3) that hold 90 % of motions, by what the samples (k, s, 3) scatter and by `off` (k,)."""
    scatter = _quantile(model.angles(samples, twists[:, None]), model.share, SHARE)
    by_misfit = np.arctan2(off, np.linalg.norm(model.centered(twists), axis=-1))
    return np.asarray(np.minimum(np.hypot(scatter, by_misfit), np.pi))


def scattered(samples: Array, about: Array, share: Array) -> Array:
    """The mean squares and products (k, 3, 3) of the differences of samples (k, s, 3) from (k, 3); shares (s,)."""
    differences = samples - about[:, None]
    return np.asarray(np.swapaxes(differences, 1, 2) * share @ differences)


def of_misfit(model: FrictionModel, off: Array, angles: npt.ArrayLike = 0.0) -> Array:
    """The covariances (k, 3, 3) of the origin's motions that are off by less than `off` (k,) [m] in 90 of 100 cases.

    The errors have no preferred direction as (v at p_CF, length * omega).

    Args:
        model: of the object.
        off: (k,) [m].
        angles: (k,) of the object in the frame of the motions [rad].
    """
    x, y = model.center_of_friction
    c, s = np.cos(angles), np.sin(angles)
    back = np.zeros((*np.shape(off), 3, 3))
    back[:, range(3), range(3)] = 1.0, 1.0, 1 / model.length
    back[:, 0, 2], back[:, 1, 2] = (s * x + c * y) / model.length, (s * y - c * x) / model.length
    return np.asarray((off**2 / ELLIPSOID)[:, None, None] * (back @ np.swapaxes(back, 1, 2)))


@comparable
class MotionCone(NamedTuple):
    """The edges of the motion cones of k contacts: motions with the tip on the verge of sliding, the contact at unit speed."""

    right: Array  # (k, 3) it slides towards -t beyond
    left: Array  # (k, 3) it slides towards +t beyond


def motion_cone(model: FrictionModel, contact_points: npt.ArrayLike, contact_normals: npt.ArrayLike) -> MotionCone:
    """The motion cones of k contacts: means over the samples. Raises as `predict`.

    Example:
        >>> from pushfric_core import TABLE_1, FrictionModel, motion_cone
        >>> known = TABLE_1["wood_rect4"]
        >>> cone = motion_cone(FrictionModel.of(known.support, known.mu_c), [(0.0, -0.032)], [(0.0, -1.0)])
        >>> cone.left.shape, cone.right.shape
        ((1, 3), (1, 3))
    """
    cones = quasi_static.motion_cones(model.support_points, model.w, model.mu_c, contact_points, contact_normals)
    mean = np.einsum("s,kseD->keD", model.share, cones)
    return MotionCone(mean[:, 0], mean[:, 1])


@comparable
class Stability(NamedTuple):
    """Whether pushes with an edge or two fingers hold the object.

    Example:
        >>> from pushfric_core import TABLE_1, FrictionModel, stability
        >>> known = TABLE_1["wood_rect4"]
        >>> model = FrictionModel.of(known.support, known.mu_c)
        >>> held = stability(model, [(0.0, -0.032)], [(0.0, -1.0)], [0.03], centers=[(-0.02, -0.032)], turns=[1.0])
        >>> held.stable.tolist(), held.probabilities.tolist()
        ([False], [0.0])
    """

    stable: npt.NDArray[np.bool_]  # (k,)
    margins: Array  # (k,) median over the samples; see quasi_static.holding_margins
    probabilities: Array  # (k,) share of the samples in which the object does not slip


def stability(
    model: FrictionModel,
    contact_points: npt.ArrayLike,
    contact_normals: npt.ArrayLike,
    half_widths: npt.ArrayLike,
    centers: npt.ArrayLike,
    turns: npt.ArrayLike,
) -> Stability:
    """Which of k pushes with an edge or two fingers hold the object while they turn it about a centre of rotation.

    All centres of one contact with a margin above zero are the set of those that hold.

    Args:
        model: of the object.
        contact_points: (k, 2) middles of the contact intervals, object frame [m].
        contact_normals: (k, 2) unit, outward.
        half_widths: (k,) of the intervals [m].
        centers: (k, 2) of rotation, object frame [m].
        turns: (k,) +1 counter-clockwise, -1 clockwise.
    Raises:
        ValueError: shapes that do not fit, values that are not finite, or a turn other than +1 and -1.

    Example:
        >>> from pushfric_core import TABLE_1, FrictionModel, stability
        >>> known = TABLE_1["wood_rect4"]
        >>> model = FrictionModel.of(known.support, known.mu_c)
        >>> held = stability(model, [(0.0, -0.032)], [(0.0, -1.0)], [0.03], centers=[(-1.0, -0.032)], turns=[1.0])
        >>> held.stable.tolist()
        [True]
    """
    centers, turns = as_array(centers), as_array(turns)
    if centers.ndim != 2 or centers.shape[1] != 2 or turns.shape != centers.shape[:1]:
        raise ValueError(f"centers and turns must have shapes (k, 2) and (k,), got {centers.shape} and {turns.shape}")
    if not (np.abs(turns) == 1).all():
        raise ValueError("turns must be +1 or -1")
    twists = np.column_stack((-turns[:, None] * left_of(centers), turns))
    samples = quasi_static.holding_margins(
        model.support_points, model.w, model.mu_c, contact_points, contact_normals, half_widths, twists, model.length
    )
    margins = _quantile(samples, model.share, 0.5)
    held = np.sum((samples >= 0) * model.share, axis=1)
    return Stability(margins >= 0, margins, np.minimum(held, 1.0))


@comparable
class Foretold(NamedTuple):
    """How far m observations are off from what a model foretells, and how far that claims to be off."""

    angles: Array  # (m,) between the motions [rad], see FrictionModel.angles
    spreads: Array  # (m,) that 90 % of the angles are claimed to stay below [rad]


def foretold(model: FrictionModel, observations: Sequence[Observation]) -> Foretold:
    """Compare m >= 1 observations with what the mean friction foretells, as `predicted_motions` does."""
    measured = np.array([observation.twist for observation in observations])
    moved = predicted_motions(model.mean, observations)
    twists = moved.twists[:, 0]
    speeds = [math.hypot(*(one.tip_velocity or velocity_at(one.twist, one.contact_point))) for one in observations]
    off = _misfits(model, moved.modes[:, 0]) * np.array(speeds)
    return Foretold(model.angles(twists, measured), _spread(model, predicted_motions(model, observations).twists, twists, off))


def predicted_motions(model: FrictionModel, observations: Sequence[Observation]) -> Motions:
    """Motions (m, s) that the samples of a model predict for m >= 1 observations, object frame [m/s, rad/s].

    Where the tip's velocity is known, it is the tip that pushes; else, or where the tip was seen to leave, the contact moves as
    it was measured to, so that mu_c does not matter. If that moves away from the pusher, the object stays at rest.

    Raises:
        SolverFailed: a motion did not converge.
    """
    points = np.array([observation.contact_point for observation in observations])
    normals = np.array([observation.contact_normal for observation in observations])
    measured = np.array([observation.twist for observation in observations])
    velocities = measured[:, :2] + measured[:, 2:] * left_of(points)
    tips = np.array([observation.tip_velocity or (0.0, 0.0) for observation in observations])
    pushed = np.sum(tips * normals, axis=1) < 0
    count = len(model.w)
    mu_c = np.where(pushed[:, None], model.mu_c, STICKING)
    moving = np.where(pushed[:, None], tips, velocities)
    points, normals, moving = (np.repeat(part, count, axis=0) for part in (points, normals, moving))
    samples = np.tile(np.arange(count), len(mu_c))
    moved = quasi_static.motions_of_rows(model.support_points, model.w, mu_c.ravel(), samples, points, normals, moving)
    return moved.of_samples(count)


def _quantile(values: Array, share: Array, level: float) -> Array:
    """The least of the values (k, s) at or below which a share of `level` lies, for samples of the given shares (s,); (k,)."""
    order = np.argsort(values, axis=1)
    reached = np.cumsum(share[order], axis=1) >= level - SUM
    return np.asarray(np.take_along_axis(values, np.take_along_axis(order, reached.argmax(axis=1)[:, None], 1), 1)[:, 0])
