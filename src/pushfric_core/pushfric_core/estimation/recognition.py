"""Recognition: which of several hypotheses about an object explains the observations best (section 5.2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from pushfric_core.estimation.estimate import Estimate
from pushfric_core.estimation.estimator import Estimator, EstimatorConfig
from pushfric_core.geometry.planar import Array, as_array, rotation
from pushfric_core.records import comparable
from pushfric_core.solvers.program import Status
from pushfric_core.trajectories.observation import Observation
from pushfric_core.trajectories.observations import Observations

EXACT = 1e-9
"""A fit error up to this [m, unit force] is rounding: the data agree with the hypothesis exactly."""


@comparable
@dataclass(frozen=True)
class Hypothesis:
    """A hypothesis: an object, or how it may lie.

    Args:
        name: label in the ranking.
        support_points: (n, 2) hypothesised supports in the object frame [m] (section 5.2.2).
        center_of_friction: p_CF (2,) [m] if the hypothesis includes it (section 5.2.1).

    Example:
        >>> import numpy as np
        >>> from pushfric_core import Hypothesis
        >>> heavy = Hypothesis("heavy", np.array([(-0.05, 0.0), (0.05, 0.0)]), center_of_friction=np.array((-0.02, 0.0)))
        >>> round(float(heavy.turned(np.pi, (0.0, 0.0)).center_of_friction[0]), 3)
        0.02
    """

    name: str
    support_points: Array
    center_of_friction: Array | None = None

    def turned(self, angle: float, pivot: npt.ArrayLike) -> Hypothesis:
        """The hypothesis rotated by `angle` [rad] about the point `pivot` (2,) [m]; the object frame stays where it is."""
        place = as_array(pivot)

        def turned(xy: Array) -> Array:
            return np.asarray((as_array(xy) - place) @ rotation(angle).T + place)

        center = self.center_of_friction
        return Hypothesis(self.name, turned(self.support_points), None if center is None else turned(center))


@dataclass(frozen=True)
class Ranked:
    """How well one hypothesis explains the data.

    Attributes:
        name: of the hypothesis.
        fit_error: optimum of its program [m, unit force]; infinite if no w satisfies its hard constraints.
        ratio: its fit error divided by the best one: 1 for the best and its equals; infinite for others if the best is zero.
        contradiction: which hard constraints no w satisfies, in words; None if the hypothesis is feasible.
    """

    name: str
    fit_error: float
    ratio: float
    contradiction: str | None = None

    @property
    def feasible(self) -> bool:
        """Whether some w satisfies the hard constraints of the hypothesis."""
        return self.contradiction is None


@dataclass(frozen=True)
class Ranking:
    """All hypotheses after the last observation; it never changes later.

    Attributes:
        hypotheses: in order of fit error, the infeasible ones last; those that are equal, in the order given.
        data_points: number of observations used.
        stamp: of the newest observation [ns]; 0 if unknown.

    Example:
        >>> import numpy as np
        >>> from pushfric_core import Hypothesis, Observation, Recognizer, Twist
        >>> points = np.array([(-0.05, -0.02), (0.05, -0.02), (0.0, 0.03)])
        >>> recognizer = Recognizer([Hypothesis(f"p_CF at {x}", points, np.array((x, 0.0))) for x in (-0.02, 0.02)])
        >>> ranking = recognizer.add(Observation((0.0, -0.03), (0.0, -1.0), Twist(0.0, 0.02, -0.2)))
        >>> ranking.best, ranking.data_points
        ('p_CF at 0.02', 1)
    """

    hypotheses: tuple[Ranked, ...]
    data_points: int
    stamp: int

    @property
    def best(self) -> str | None:
        """Name of the hypothesis that fits best; None if no hypothesis is feasible."""
        return self.hypotheses[0].name if self.hypotheses[0].feasible else None


class Recognizer:
    """Ranks hypotheses by the fit errors of their programs, each of which starts from its own last optimum.

    Args:
        hypotheses: at least one.
        config: the constraints, the same for all; `cor_radius` auto depends on the support points of each hypothesis.
    Raises:
        ValueError: no hypotheses, two with the same name, or one that `Estimator` refuses.

    Example:
        >>> import numpy as np
        >>> from pushfric_core import Hypothesis, Observation, Recognizer, Twist
        >>> points = np.array([(-0.05, -0.02), (0.05, -0.02), (0.0, 0.03)])
        >>> recognizer = Recognizer([Hypothesis(f"p_CF at {x}", points, np.array((x, 0.0))) for x in (-0.02, 0.02)])
        >>> recognizer.add(Observation((0.0, -0.03), (0.0, -1.0), Twist(0.0, 0.02, -0.2))).best
        'p_CF at 0.02'
    """

    def __init__(self, hypotheses: Sequence[Hypothesis], config: EstimatorConfig | None = None) -> None:
        names = [hypothesis.name for hypothesis in hypotheses]
        if not names:
            raise ValueError("hypotheses must hold at least one, got none")
        if len(set(names)) < len(names):
            raise ValueError(f"hypotheses must differ in name, got {', '.join(names)}")
        same = replace(config or EstimatorConfig(), tie_break=False, screening=False)  # only fit errors count
        self._estimators = {one.name: Estimator(one.support_points, same, one.center_of_friction) for one in hypotheses}

    @property
    def observations(self) -> Observations:
        """The observations in all programs, in order of arrival."""
        return next(iter(self._estimators.values())).observations

    def add(self, observation: Observation) -> Ranking:
        """Take an observation and rank again.

        Raises:
            UninformativePush: it rotates exactly about a support point of one of the hypotheses. Then no hypothesis takes it,
                because fit errors can be compared only over the same observations.
        """
        for estimator in self._estimators.values():
            estimator.check(observation)
        return _ranking({name: estimator.add(observation) for name, estimator in self._estimators.items()})

    def exclude(self, push_id: int) -> Ranking:
        """Take all observations of a push out, and rank again.

        Raises:
            ValueError: there is no observation of that push.
        """
        return _ranking({name: estimator.exclude(push_id) for name, estimator in self._estimators.items()})


def _ranking(estimates: dict[str, Estimate]) -> Ranking:
    errors = {
        name: math.inf if estimate.status is Status.INFEASIBLE else estimate.solution.objective
        for name, estimate in estimates.items()
    }
    best = min(errors.values())
    # sorting keeps the order of those that fit equally
    order = sorted(errors, key=lambda name: max(errors[name], EXACT))
    ranked = tuple(Ranked(name, errors[name], _ratio(errors[name], best), estimates[name].contradiction) for name in order)
    same = next(iter(estimates.values()))  # all have the same observations
    return Ranking(ranked, same.data_points, same.stamp)


def _ratio(error: float, best: float) -> float:
    if EXACT < best < math.inf:
        return error / best
    return 1.0 if error <= EXACT else math.inf
