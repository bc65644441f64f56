"""The estimation of one object, from messages to the verdict."""

import dataclasses
from collections import Counter
from collections.abc import Iterable
from typing import Any

from pushfric_core.bags.run_record import PLAN, PlanRecord
from pushfric_core.bags.samples import INPUTS
from pushfric_core.estimation.estimate import Estimate
from pushfric_core.estimation.estimator import check_push
from pushfric_core.estimation.online_estimation import OnlineEstimation
from pushfric_core.estimation.recognition import Recognizer
from pushfric_core.estimation.verdict import Verdict
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.object_file import load_object
from pushfric_core.trajectories.ledger import REFUSED, Ledger
from pushfric_core.trajectories.observation import Observation
from pushfric_core.trajectories.observation_maker import ObservationMaker


class LiveEstimation:
    """All that is made of the messages about one object, with an account of every message.

    Args:
        chosen: the object's name or file.
        settings: of the estimator.
        log: of the node; it says once that input is refused, or that observations contradict each other, or why.
        first: as `begin` of `PlanRecord`.
    Attributes:
        object: its outline and hypotheses.
        excluded: the pushes that are left out.
        maker: of observations.
        made: all observations, also those that are left out.
        online: the estimate, and all that follows from it.
        verdict: on the estimate, as it was last judged.
        problem: why something was refused, or contradicts itself; empty: nothing does.
        refused: number of refusals.
    Raises:
        InvalidInput: the object cannot be loaded.
    """

    def __init__(self, chosen: str, settings: EstimatorSettings, log: Any, first: int | None) -> None:
        self.chosen, self.object = chosen, load_object(chosen)
        self.excluded, self._settings, self._log = set(settings.excluded), settings, log
        self.maker = ObservationMaker(self.object.outline, settings.trajectory, settings.with_forces)
        self.made: list[Observation] = []
        self.verdict, self.problem, self.refused = Verdict(), "", 0
        self._plan = PlanRecord(first)
        self._refused_messages: Counter[str] = Counter()  # by kind of the ledger
        self._noted: set[tuple[str, int]] = set()  # codes and stamps of the doubts that the log has
        self._estimate_anew()

    def _estimate_anew(self) -> None:
        model, settings = self.object, self._settings
        estimator = settings.new_estimator(model.support_points)
        recognizer = Recognizer(model.hypotheses, settings.estimator) if model.hypotheses else None
        self.online = OnlineEstimation(model.outline, estimator, settings.region.region_margin, recognizer, self.refuse)

    @property
    def pushes(self) -> set[int]:
        """The pushes that pusher states or observations have told of so far."""
        return self.maker.trajectory.pushes | {observation.push_id for observation in self.made}

    @property
    def settings(self) -> EstimatorSettings:
        """The settings, with the pushes that are left out now."""
        return dataclasses.replace(self._settings, excluded=tuple(sorted(self.excluded)))

    def observations(self, topic: str, msg: Any, received: int | None) -> list[Observation]:
        """The observations that a message completes, or is.

        Args:
            topic: its relative name.
            msg: the message.
            received: when it came [ns]; None: not known.
        Raises:
            ValueError: the message is impossible.
            PushfricError: so is the observation.
        """
        if topic == PLAN:
            self._plan.take(msg)
            return []
        return self.maker.add(INPUTS[topic][1](msg), received)

    def learn(self, observation: Observation) -> None:
        """Take an observation in one go, in all respects, unless its push is left out."""
        self.made.append(observation)
        if observation.push_id not in self.excluded:
            self.online.learn(observation)

    def take(self, observation: Observation) -> bool:
        """Estimate w again, with one more observation; return whether it could be used."""
        self.made.append(observation)
        return observation.push_id not in self.excluded and self.online.take(observation)

    def exclude(self, push_id: int) -> Estimate:
        """Leave a push out, also its observations that are still to come; return what is left.

        Raises:
            ValueError: there is no observation of that push.
        """
        left = self.online.exclude(push_id)
        self.excluded.add(push_id)
        return left

    def keep(self, push_id: int) -> Estimate:
        """Keep a push in, or take it back; return the estimate with it.

        Raises:
            ValueError: nothing has told of that push.
        """
        check_push(push_id, self.pushes | self.excluded)
        self._settings = dataclasses.replace(self._settings, kept=tuple(sorted({*self._settings.kept, push_id})))
        if push_id in self.excluded:
            self.excluded.remove(push_id)
            self._learn_again()
        return self.online.keep(push_id)

    def leave_out(self, pushes: Iterable[int]) -> None:
        """Leave these pushes out, whether they have given an observation or not."""
        self.excluded.update(pushes)
        self._learn_again()

    def _learn_again(self) -> None:
        """Take all observations again, in the order in which a bag has them."""
        self._estimate_anew()
        made, self.made = self.made, []
        for observation in made:
            self.learn(observation)

    def judge(self) -> Verdict:
        """Judge the estimate again."""
        self.verdict = self.online.verdict()
        estimate, problem = self.online.estimate, ""
        if estimate is not None and estimate.contradiction is not None:
            problem = "; ".join(map(str, self.verdict.reasons))
            if not self.problem:
                self._log.error(problem)
        self.problem = problem
        return self.verdict

    def refuse(self, what: str, error: Exception) -> None:
        """Log once, not at camera rate, that input was refused; the estimate stays as it was."""
        self.refused += 1
        if not self.problem:
            self._log.error(f"{what} refused: {error}")
        self.problem = str(error)

    def refuse_message(self, topic: str, error: Exception) -> None:
        """Refuse a message."""
        self._refused_messages[INPUTS[topic][0]] += 1
        self.refuse(topic, error)

    def ledger(self) -> Ledger:
        """The account of every message so far; the log says once what is in doubt."""
        ledger = self.maker.ledger(self._plan.planned, ended=False)
        for kind, number in self._refused_messages.items():
            ledger.accounts[kind].enter(REFUSED, number)
        ledger.doubt_refused()
        used = Counter(one.push_id for one in self.online.observations)
        made = Counter(one.push_id for one in self.made)
        self._plan.doubt_empty(ledger, made, self.maker.settled)
        rejected = {one.push_id for one in self.verdict.rejected}
        ledger.settle(made, used, self.excluded, rejected, self._plan.started, self._plan.aborted)
        for doubt in ledger.doubts:
            if (doubt.code, doubt.stamp) not in self._noted:
                self._log.warning(doubt.text)
                self._noted.add((doubt.code, doubt.stamp))
        return ledger
