"""All that a live run estimates of one object: w, p_CF and mu_c, the region of p_CF, and which hypothesis fits."""

from collections.abc import Callable, Generator

from shapely import Polygon

from pushfric_core.errors import PushfricError
from pushfric_core.estimation.estimate import Estimate
from pushfric_core.estimation.estimator import Estimator
from pushfric_core.estimation.push_choice import RankedPush, next_pushes, slip_pushes
from pushfric_core.estimation.push_plan import PlannedPush
from pushfric_core.estimation.recognition import Ranking, Recognizer
from pushfric_core.estimation.region import HalfPlanes, Region, line_of_motion
from pushfric_core.estimation.verdict import Verdict, verdict_on
from pushfric_core.geometry.outline import Outline
from pushfric_core.trajectories.observation import Observation
from pushfric_core.trajectories.observations import Observations

Refuse = Callable[[str, PushfricError], None]


class OnlineEstimation:
    """Takes observations in steps, so that each result can be published before the next one is computed.

    Args:
        outline: of the object.
        estimator: without observations.
        margin: by how much the half-planes of the region are widened [m].
        recognizer: without observations; None if there are no hypotheses about the object.
        refuse: called with what cannot be used of an observation, and why; the results stay as they were.
    Attributes:
        estimate: the last one; None without observations.
        ranking: of the hypotheses; None before the first one.
    """

    def __init__(
        self, outline: Outline, estimator: Estimator, margin: float, recognizer: Recognizer | None, refuse: Refuse
    ) -> None:
        self._outline, self._margin = outline, margin
        self._estimator, self._recognizer, self._refuse = estimator, recognizer, refuse
        self._half_planes = HalfPlanes(outline, margin)
        self._chosen: tuple[Polygon, list[RankedPush], list[PlannedPush]] | None = None  # pushes, and the region they are for
        self._left_out: set[int] = set()  # pushes that the region does not use
        self._unranked: set[int] = set()  # pushes that the ranking does not use
        self.estimate: Estimate | None = None
        self.ranking: Ranking | None = None

    @property
    def observations(self) -> Observations:
        """The observations that the estimate rests on."""
        return self._estimator.observations

    @property
    def newest(self) -> Observation | None:
        """The newest observation, even if its push is rejected; None without any."""
        return self._estimator.newest

    @property
    def settled(self) -> bool:
        """Whether all observations have been judged."""
        return self._estimator.settled

    @property
    def usable(self) -> bool:
        """Whether there is an estimate that no hard constraint contradicts."""
        return self.estimate is not None and self.estimate.contradiction is None

    def verdict(self) -> Verdict:
        """Whether the last estimate may be used, by what was last judged; of no estimate, nothing is said."""
        return Verdict() if self.estimate is None else verdict_on(self.estimate, self._estimator.judgement)

    def learn(self, observation: Observation) -> None:
        """Take an observation in one go, in all respects."""
        if self.take(observation):
            self.narrow(observation)
            self.recognize(observation)

    def take(self, observation: Observation) -> bool:
        """Estimate w again, with one more observation; return whether it could be used."""
        try:
            self.estimate = self._estimator.add(observation)
        except PushfricError as error:
            self._refuse("observation", error)
            return False
        return True

    def narrow(self, observation: Observation) -> None:
        """Narrow the region down with an observation that was taken; start over if other pushes are left out."""
        rejected = self._rejected()
        if rejected != self._left_out:
            self._narrow_again()
        elif observation.push_id not in rejected:
            self._cut(observation)

    def recognize(self, observation: Observation) -> bool:
        """Rank the hypotheses again, with a new observation, by the estimate's pushes; return whether the ranking is new."""
        before = self.ranking
        if observation.push_id not in self._rank_again() | self._rejected():
            self._rank(observation)
        return self.ranking is not before

    def settling(self) -> Generator[None, None, None]:
        """Let all that is said rest on all observations, now that no other follows at once; pauses after each step."""
        if self.estimate is not None:
            self.estimate = yield from self._estimator.settling()
            if self._rejected() != self._left_out:
                self._narrow_again()
                self._rank_again()

    def exclude(self, push_id: int) -> Estimate:
        """Take all observations of a push out of everything; return what is left, perhaps without any observations.

        Raises:
            ValueError: there is no observation of that push.
        """
        left = self._estimator.exclude(push_id)
        self._unrank(push_id)
        return self._begin_again(left)

    def keep(self, push_id: int) -> Estimate:
        """Keep a push in, or take it back, even if it is unlike the others; return the estimate with it."""
        return self._begin_again(self._estimator.keep(push_id))

    def _begin_again(self, estimate: Estimate) -> Estimate:
        """Let all that is said follow the pushes of this estimate."""
        self.estimate = estimate if estimate.data_points else None
        self._narrow_again()
        self._rank_again()
        return estimate

    def region(self) -> Region:
        """Where p_CF can lie by the half-planes of the pushes that are not left out."""
        return self._half_planes.region()

    def next_pushes(self) -> list[RankedPush]:
        """The pushes that are expected to shrink the region most, best first."""
        return self._choice()[1]

    def slip_pushes(self) -> list[PlannedPush]:
        """The pushes that slip, for mu_c, best first."""
        return self._choice()[2]

    def _choice(self) -> tuple[Polygon, list[RankedPush], list[PlannedPush]]:
        region = self._half_planes.polygon
        if self._chosen is None or self._chosen[0] is not region:
            self._chosen = region, next_pushes(self._half_planes), slip_pushes(self._outline, self.region().center)
        return self._chosen

    def _rejected(self) -> set[int]:
        return {one.push_id for one in self._estimator.rejected}

    def _narrow_again(self) -> None:
        self._left_out = self._rejected()
        self._half_planes = HalfPlanes(self._outline, self._margin)
        for observation in self._estimator.observations:
            self._cut(observation)

    def _rank_again(self) -> set[int]:
        """Rank by the pushes that are not left out now, if they have changed; return those that came back."""
        rejected = self._rejected()
        for push_id in sorted(rejected - self._unranked):
            self._unrank(push_id)
        back, self._unranked = self._unranked - rejected, rejected
        for observation in self._estimator.observations if back else ():
            if observation.push_id in back:
                self._rank(observation)
        return back

    def _rank(self, observation: Observation) -> None:
        if self._recognizer is None:
            return
        try:
            self.ranking = self._recognizer.add(observation)
        except PushfricError as error:
            self._refuse("observation, for recognition,", error)

    def _unrank(self, push_id: int) -> None:
        # recognition may have refused all observations of that push
        if self._recognizer is not None and any(one.push_id == push_id for one in self._recognizer.observations):
            self.ranking = self._recognizer.exclude(push_id)

    def _cut(self, observation: Observation) -> None:
        try:
            self._half_planes.add(line_of_motion(observation))
        except PushfricError as error:
            self._refuse("observation, for the region of p_CF,", error)
