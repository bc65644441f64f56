"""The posterior of the support friction: what the observations say of w and p_CF if the support may be an area, feet, or both.

docs/derivation.md states the likelihood and the priors. Markov chains (`support_chain`) of several powers of the likelihood
sample it. They exchange their states (parallel tempering): the weaker ones wander from one explanation to another.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pushfric_core.errors import warn_unless_compiled
from pushfric_core.geometry.planar import Array
from pushfric_core.records import comparable
from pushfric_core.trajectories.observation import Observation
from pushfric_core.uncertainty import support_chain
from pushfric_core.uncertainty.motion_errors import Motions, motions
from pushfric_core.uncertainty.spread import ellipse_radius

WARMTHS = 1.0, 0.68, 0.45, 0.28, 0.16, 0.08
"""Powers of the likelihood of the chains; the first samples the posterior."""

STRIDE = 20
"""Steps of each chain between two exchanges of states, and two samples."""

WARM_UP = 3000
"""Steps before the first sample."""

ROUND = 8000
"""Steps between two looks at whether the samples suffice."""

ROUNDS = 2
"""Rounds at most."""

AGREEMENT = 0.4
"""The means of p_CF over the two halves of the samples may differ by this share of its standard deviation."""

SLICE = 200
"""Steps of each chain that are taken at once."""

SAMPLES = 64
"""Samples of w that a posterior holds."""

ORDER = 3
"""Highest order of the cosines that make up the logarithm of the pressure."""

NO_FEET = 0.5
"""Prior probability that there are no feet besides the area ..."""

MORE = 0.7
"""... and that there is another foot, if there is one."""

NOISE = 0.35, 1.0
"""Prior standard deviation of the logarithm of the noise's scale, if the tip shows it and if not."""

MISFIT = 0.02, 1.0
"""Prior median of the misfits of the moment, as a share of the support's radius, and standard deviation of their logarithms;
chosen, like PIVOT, on simulated and real pushes together."""

ROUGHNESS = 1.0, 0.7
"""The same for the logarithm of the pressure."""

PIVOT = 1.0, 0.7
"""The same for the unknown force of a support at the centre of rotation, as a share of its weight."""

REACH = 0.55
"""The force of a support is unknown in part within this share of the support's radius from the centre of rotation."""

NODES = np.array((-6.0, -3.5, -2.0, -0.9, 0.0, 0.9, 2.0, 3.5, 6.0))
"""Standard deviations of the turn at which moments are known."""

SEED = 1993
"""Seed of the chains: the same data give the same posterior."""

COMMON = 0.5
"""What makes pushes differ from any support shifts p_CF in all of them by this share, too, which no push shows; chosen on
simulated and real pushes together."""

SMALLEST_ERROR = 1e-3
"""A standard deviation of p_CF of less than this share of the support's size is not believed."""

warn_unless_compiled(support_chain, "the posterior is")


@comparable
@dataclass(frozen=True)
class Posterior:
    """What the observations say of the support friction.

    Attributes:
        w: (n,) mean of the support friction distribution over the support points; feet between them are shared out among the
            nearest, so that p_CF stays.
        center_of_friction: (2,) mean of p_CF [m], object frame.
        covariance: (2, 2) of p_CF [m^2]; the ellipse x' C^-1 x <= 4.605 about the mean contains the truth in 90 % of cases.
        samples: (k, n) equally probable w; none in what a message says.
        feet: mean number of feet besides the area.
        area: mean share of the area in the weight.
        data_points: the number of observations that all of this rests on.
    """

    w: Array
    center_of_friction: Array
    covariance: Array
    samples: Array
    feet: float
    area: float
    data_points: int

    @property
    def radius(self) -> float:
        """Radius of the smallest circle about the mean of p_CF that contains the 90 % ellipse [m]."""
        return ellipse_radius(self.covariance)


class Sampling:
    """A posterior in the making: `advance` until it is done, then `result`.

    Args:
        observations: at least one, in any order.
        support_points: (n, 2) [m], object frame.
        start: (n,) a w to begin with; the other chain begins with even pressure.
    """

    def __init__(self, observations: Sequence[Observation], support_points: Array, start: Array) -> None:
        self._middle = support_points.mean(axis=0)
        self._points = np.ascontiguousarray(support_points - self._middle)
        self._count = len(observations)
        self._size = float(np.ptp(self._points, axis=0).max())
        radius = max(math.sqrt(float(np.mean(np.sum(self._points**2, axis=1)))), 1e-6)
        self._places = _Places(self._points)
        self._motions = motions(observations, self._middle, radius)
        self._random = np.random.default_rng(SEED)
        self._chains = [_chain(self._motions, self._points, radius, self._places.hull, self._places.extent) for _ in WARMTHS]
        bearing = np.argsort(-start, kind="stable")[: support_chain.MOST_FEET - 4]
        bearing = bearing[start[bearing] > 1e-3]
        for number, chain in enumerate(self._chains):
            if number % 2:
                chain.start(3.0, np.zeros((0, 2)), np.zeros(0))
            else:
                chain.start(0.02, self._points[bearing], 4 * start[bearing])
        self._steps = 0  # of each chain
        self._samples: list[tuple[Array, Array, Array]] = []
        self._misfits: list[float] = []
        self.done = False

    def advance(self) -> None:
        """Take the next steps of each chain, some milliseconds."""
        for _ in range(SLICE // STRIDE):
            for chain, warmth in zip(self._chains, WARMTHS, strict=True):
                taken = 0
                while taken < STRIDE:
                    taken += support_chain.walk(chain, STRIDE - taken, warmth, self._random.random(STRIDE * 32))
            self._exchange()
            self._steps += STRIDE
            if self._steps > WARM_UP:
                self._samples.append(self._chains[0].weights())
                self._misfits.append(self._chains[0].misfit())
        rounds, rest = divmod(self._steps - WARM_UP, ROUND)
        if rounds > 0 and rest < SLICE:
            if rounds == ROUNDS or self._agree():
                self.done = True
            else:
                first = len(self._samples) // 3
                self._samples, self._misfits = self._samples[first:], self._misfits[first:]

    def finish(self) -> Posterior:
        """Advance until it is done, about a second, and return the result."""
        while not self.done:
            self.advance()
        return self.result()

    def _exchange(self) -> None:
        """Exchange the states of neighbouring chains by Metropolis's rule."""
        for number in range(len(WARMTHS) - 1):
            one, other = self._chains[number], self._chains[number + 1]
            gain = (WARMTHS[number] - WARMTHS[number + 1]) * (other.fit - one.fit)
            if math.log(1.0 - self._random.random()) < gain:
                self._chains[number], self._chains[number + 1] = other, one

    def _agree(self) -> bool:
        centers = self._centers(self._samples)
        halves = np.array_split(centers, 2)
        apart = halves[0].mean(axis=0) - halves[1].mean(axis=0)
        return bool(apart @ np.linalg.solve(np.cov(centers.T) + 1e-18 * np.eye(2), apart) <= AGREEMENT**2)

    def _centers(self, samples: list[tuple[Array, Array, Array]]) -> Array:
        return np.array([area @ self._points + weights @ feet for area, feet, weights in samples])

    def result(self) -> Posterior:
        """The posterior."""
        samples = self._samples
        centers = self._centers(samples)
        unseen = COMMON**2 * float(np.mean(self._misfits)) + (SMALLEST_ERROR * self._size) ** 2
        covariance = np.cov(centers.T) + unseen * np.eye(2)
        w = np.array([area + self._places.shared(feet, weights) for area, feet, weights in samples])
        chosen = w[np.linspace(0, len(w) - 1, SAMPLES).round().astype(int)]
        mean = w.mean(axis=0)
        center = centers.mean(axis=0) + self._middle
        for array in (mean, center, covariance, chosen):
            array.setflags(write=False)
        feet = float(np.mean([len(weights) for _, _, weights in samples]))
        area_share = float(np.mean([area.sum() for area, _, _ in samples]))
        return Posterior(mean, center, covariance, chosen, feet, area_share, self._count)


def _chain(seen: Motions, points: Array, radius: float, hull: Array, extent: float) -> support_chain.Chain:
    bearings = np.arctan2(seen.normals[:, 1], seen.normals[:, 0])
    sides = np.column_stack([np.ones(len(bearings))] + [trig(k * bearings) for k in (1, 2) for trig in (np.cos, np.sin)])
    own = math.log(MISFIT[0] * radius), MISFIT[1]
    priors = np.array(
        (
            (0.0, NOISE[0] if seen.seen else NOISE[1]),
            own,
            own,
            (math.log(ROUGHNESS[0]), ROUGHNESS[1]),
            (math.log(PIVOT[0]), PIVOT[1]),
            own,
        )
    )
    numbers = np.arange(support_chain.MOST_FEET + 1)
    with np.errstate(divide="ignore"):
        log_numbers = np.where(
            numbers == 0, math.log(NO_FEET), math.log((1 - NO_FEET) * (1 - MORE)) + (numbers - 1) * math.log(MORE)
        )
    return support_chain.Chain(
        np.ascontiguousarray(seen.displacements),
        np.ascontiguousarray(seen.errors),
        np.ascontiguousarray(seen.contacts),
        np.ascontiguousarray(sides),
        seen.pushes,
        seen.links,
        points,
        _modes(points),
        extent,
        hull,
        NODES,
        REACH * radius,
        priors,
        log_numbers,
    )


def _modes(points: Array) -> Array:
    """(n, b) cosines over the support points, the smoother ones larger: the logarithm of the pressure is made up of these."""
    low, size = points.min(axis=0), np.maximum(np.ptp(points, axis=0), 1e-9)
    x, y = ((points - low) / size).T * math.pi
    modes = []
    for total in range(1, ORDER + 1):
        for order in range(total + 1):
            mode = np.cos(order * x) * np.cos((total - order) * y)
            mode -= mode.mean()
            if (size_of := float(np.sqrt(np.mean(mode**2)))) > 1e-9:
                modes.append(mode / (size_of * total))
    return np.column_stack(modes) if modes else np.zeros((len(points), 1))


class _Places:
    """Where feet may be, and which support points stand for them."""

    def __init__(self, points: Array) -> None:
        # imported late: who estimates without a posterior does without it
        from scipy.spatial import ConvexHull, Delaunay, QhullError

        self._points = points
        try:
            hull = ConvexHull(points)
            self._triangles: Delaunay | None = Delaunay(points)
        except (QhullError, ValueError):  # fewer than three, or all on a line: feet are at the points
            self.hull, self.extent, self._triangles = np.zeros((0, 3)), 1.0, None
        else:
            self.extent = float(hull.volume)  # in the plane, the area
            self.hull = np.ascontiguousarray(np.column_stack((hull.equations[:, :2], 1e-9 - hull.equations[:, 2])))

    def shared(self, feet: Array, weights: Array) -> Array:
        """The weights (k,) of feet (k, 2) on the support points (n,)."""
        shares = np.zeros(len(self._points))
        if not len(feet):
            return shares
        nearest = np.argmin(np.sum((feet[:, None] - self._points) ** 2, axis=2), axis=1)
        if self._triangles is None:
            np.add.at(shares, nearest, weights)
            return shares
        simplices = self._triangles.find_simplex(feet, tol=1e-9)
        for foot, weight, simplex, near in zip(feet, weights, simplices, nearest, strict=True):
            if simplex < 0:
                shares[near] += weight
                continue
            transform = self._triangles.transform[simplex]
            first = np.maximum(transform[:2] @ (foot - transform[2]), 0.0)
            parts = np.append(first, max(1 - first.sum(), 0.0))
            shares[self._triangles.simplices[simplex]] += weight * parts / parts.sum()
        return shares
