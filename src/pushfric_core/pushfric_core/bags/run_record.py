"""The record of a run (plan, observations, last estimate), and whether the bag agrees with it."""

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from pushfric_core.bags.constants import constants
from pushfric_core.bags.contents import BagMessage
from pushfric_core.bags.samples import observation_from_msg, stamp_from_msg
from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_core.estimation.push_plan import index_of, number_of
from pushfric_core.files.estimator_settings import START_TOPIC, EstimatorSettings
from pushfric_core.files.estimator_settings import TOPIC as SETTINGS_TOPIC
from pushfric_core.trajectories.course import Planned
from pushfric_core.trajectories.ledger import DoubtCode, Ledger
from pushfric_core.trajectories.observation import Observation
from pushfric_core.wording import counted, shortened

if TYPE_CHECKING:
    from pushfric_core.bags.bag import Bag

OBSERVATION, ESTIMATE, PLAN = "observation", "friction_estimate", "plan_progress"
KEYFRAMES = "keyframes/compressed"

TYPES = {
    "object_pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "pusher_state": "pushfric_msgs/msg/PusherState",
    OBSERVATION: "pushfric_msgs/msg/Observation",
    "wrench": "geometry_msgs/msg/WrenchStamped",
    SETTINGS_TOPIC: "std_msgs/msg/String",
    ESTIMATE: "pushfric_msgs/msg/FrictionEstimate",
    PLAN: "pushfric_msgs/msg/PlanProgress",
    START_TOPIC: "pushfric_msgs/msg/EstimationStart",
}
"""Types of the messages on these topics."""

PHASES = constants("PlanProgress")

SAME = 1e-9
"""Values of an observation that differ by no more than this [m, m/s, rad/s] may come from another processor."""

Key = tuple[int, int]  # push id and stamp [ns]

Taken = TypeVar("Taken")


def content(bag: "Bag", message: BagMessage, convert: Callable[[Any], Taken]) -> Taken:
    """The record that a message contains.

    Raises:
        ValueError: the message contains impossible values.
        InvalidInput: the message was recorded with a definition that lacks one of the fields.
    """
    try:
        return convert(bag.deserialize(message))
    except AttributeError as error:
        raise InvalidInput(f"{bag.path}: {message.topic} was recorded with another definition of its type: {error}") from error


class PlanRecord:
    """Follows a plan by its messages, live and from a bag alike.

    Args:
        begin: index of the first push, unless the plan tells of another; None: earlier ones do not count.
    Attributes:
        started, aborted: ids of the pushes of the plan that began, and of those that did not reach their end.
    """

    def __init__(self, begin: int | None = 0) -> None:
        self._begin = begin
        self._last: Any = None  # plan_progress
        self.started: set[int] = set()
        self.aborted: set[int] = set()
        self._done: dict[int, int] = {}  # when pushes were completed, by id [ns]

    def take(self, msg: Any) -> None:
        """Take a message of plan_progress. One that is older than the last is ignored: a restarted node gets some twice."""
        before, stamp = self._last, stamp_from_msg(msg.header.stamp)
        if before is not None and stamp < stamp_from_msg(before.header.stamp):
            return
        self._last = msg
        done = msg.completed + msg.aborted + msg.skipped
        if before is None:
            if self._begin is not None or not done:
                self._begin = max(0, index_of(msg.push_id, msg.count) - done)
        else:
            earlier = before.completed + before.aborted + before.skipped
            if done > earlier and msg.completed > before.completed:
                self._done[before.push_id] = stamp
            elif done > earlier:
                self.aborted.add(before.push_id)
            if before.phase == PHASES["PHASE_PUSHING"] != msg.phase and msg.completed == before.completed:
                self.aborted.add(before.push_id)
        if msg.phase == PHASES["PHASE_PUSHING"]:
            self.started.add(msg.push_id)

    @property
    def planned(self) -> Planned:
        """The plan, as far as it is known."""
        return Planned(self._begin, (self._last and self._last.count) or None, self.aborted)

    @property
    def unfinished(self) -> bool:
        """Whether the end of the plan is not known."""
        return self._last is not None and self._last.phase != PHASES["PHASE_FINISHED"]

    def doubt_empty(self, ledger: Ledger, pushed: Collection[int], settled: float = math.inf) -> None:
        """Doubt the pushes that were completed by a time [ns], but are not among those that gave observations."""
        if empty := sorted(push_id for push_id, stamp in self._done.items() if stamp <= settled and push_id not in pushed):
            ledger.doubt(DoubtCode.NO_OBSERVATIONS, f"no observation came from push {', '.join(map(self.number, empty))}")

    def doubt_end(self, ledger: Ledger) -> None:
        """Doubt a plan that has not ended."""
        if self.unfinished:
            plan = self._last
            text = f"the plan is not finished: it stands at push {self.number(plan.push_id)} of {plan.count}"
            ledger.doubt(DoubtCode.PLAN_UNFINISHED, text, stamp_from_msg(plan.header.stamp))

    def number(self, push_id: int) -> str:
        """The number of a push, for people."""
        return number_of(push_id, self.planned.number)


class RunRecord:
    """Takes the messages of a run about itself, in any order among topics, and compares them with what the bag gives.

    Args:
        bag: the bag.
        namespace: of the cell.
    Attributes:
        topics: full names of the topics to read; those that the bag lacks, or has with another type, are not among them.
        plan: what became of the plan.
    """

    def __init__(self, bag: "Bag", namespace: str) -> None:
        self._bag = bag
        wanted = (OBSERVATION, ESTIMATE, PLAN, START_TOPIC)
        self._names = bag.summary.names(namespace, {name: TYPES[name] for name in wanted})
        self.topics: Collection[str] = self._names.keys()
        self._observations: dict[Key, Observation] = {}
        self._repeated = 0
        self._unread: set[str] = set()  # topics with messages that cannot be read
        self._last: BagMessage | None = None  # estimate
        self._objects: list[str] = []  # by the name or file of each that an estimate was begun of
        self.plan = PlanRecord()

    def take(self, message: BagMessage) -> None:
        """Take a message of one of the topics."""
        name = self._names[message.topic]
        try:
            if name == OBSERVATION:
                observation = content(self._bag, message, observation_from_msg)
                key = observation.push_id, observation.stamp
                self._repeated += key in self._observations
                self._observations[key] = observation
            elif name == ESTIMATE:
                self._last = message
            elif name == PLAN:
                content(self._bag, message, self.plan.take)
            else:
                self._objects += content(self._bag, message, lambda msg: [str(msg.object)] * (msg.continuation == 0))
        except (ValueError, PushfricError):
            self._unread.add(name)

    def close(
        self,
        ledger: Ledger,
        made: Sequence[Observation] | None,
        settings: EstimatorSettings,
        recorded: EstimatorSettings | None,
        earlier: int,
    ) -> None:
        """Note in a ledger what does not add up.

        Args:
            ledger: of the bag.
            made: the observations that the bag gives of the object that was recorded, those of excluded pushes, too; None: not
                known.
            settings: what they were made with.
            recorded: the run's own settings; None: not known.
            earlier: number of observations that the run went on from.
        """
        if self._repeated:
            text = f"{counted(self._repeated, 'observation was', 'observations were')} recorded more than once"
            ledger.doubt(DoubtCode.RUN_DIFFERS, text)
        alike = recorded is None or (
            recorded.trajectory == settings.trajectory and recorded.with_forces == settings.with_forces
        )
        one_estimate = len(self._objects) <= 1
        if made is not None and alike and one_estimate and OBSERVATION not in self._unread and self._observations:
            self._compare_observations(ledger, made)
        if one_estimate and not {OBSERVATION, ESTIMATE} & self._unread:
            self._compare_estimate(ledger, recorded or settings, earlier)
        if made is not None:
            if len(set(self._objects)) > 1:
                first, *_, last = map(shortened, self._objects)
                ledger.doubt(DoubtCode.RUN_DIFFERS, f"the run went on from {first} to {last}: the pushes are not of one object")
            self.plan.doubt_empty(ledger, {one.push_id for one in made})
        self.plan.doubt_end(ledger)

    def _compare_observations(self, ledger: Ledger, made: Sequence[Observation]) -> None:
        """Each observation that the run made must come out of the bag's poses and pusher states again, and no other."""
        again = {(one.push_id, one.stamp): one for one in made}
        recorded = self._observations
        end = max(stamp for _, stamp in recorded) if self.plan.unfinished else None
        missing = [key for key in recorded if key not in again]
        # an interrupted run may end before the observation that its last poses give
        added = [key for key in again if key not in recorded and (end is None or key[1] <= end)]
        moved = [key for key in recorded if key in again and not _alike(recorded[key], again[key])]
        what = f"of the {counted(len(recorded), 'observation')} that the run recorded"
        for keys, text in (
            (missing, f"{what}, {len(missing)} do not come out of its poses and pusher states again"),
            (moved, f"{what}, {len(moved)} come out of its poses and pusher states otherwise"),
            (added, f"its poses and pusher states give {counted(len(added), 'observation')} that the run did not record"),
        ):
            if keys:
                first = min(stamp for _, stamp in keys)
                lost = len(missing) if keys is missing else 0
                ledger.doubt(DoubtCode.RUN_DIFFERS, f"{text}, {self._pushes(keys)}", first, lost)

    def _compare_estimate(self, ledger: Ledger, settings: EstimatorSettings, earlier: int) -> None:
        """The last estimate cannot rest on more observations than the bag holds."""
        if self._last is None:
            return
        try:
            rests_on, rejected = content(
                self._bag, self._last, lambda msg: (int(msg.data_points), {one.push_id for one in msg.rejected})
            )
        except (ValueError, InvalidInput):
            return
        out = rejected | set(settings.excluded)
        held = earlier + sum(push_id not in out for push_id, _ in self._observations)
        if rests_on > held:
            text = f"the last estimate of the run rests on {rests_on} observations, but the bag holds {held} of them"
            ledger.doubt(DoubtCode.RUN_DIFFERS, text, self._last.log_time_ns, rests_on - held)

    def _pushes(self, keys: Iterable[Key]) -> str:
        """The pushes of some observations, in words."""
        ids = sorted({push_id for push_id, _ in keys})
        more = f" and {len(ids) - 8} more" if len(ids) > 8 else ""
        return f"in push {', '.join(map(self.plan.number, ids[:8]))}{more}"


def _alike(one: Observation, other: Observation) -> bool:
    """Whether two observations have the same contact, normal, motion and tip."""
    for name in ("contact_point", "contact_normal", "twist", "tip_velocity"):
        a, b = getattr(one, name), getattr(other, name)
        if a != b and (a is None or b is None or any(abs(x - y) > SAME for x, y in zip(a, b, strict=True))):
            return False
    return True
