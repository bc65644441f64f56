"""The other nodes of the cell, as the experiment knows them."""

import math
import time
from collections import defaultdict
from functools import partial

from rclpy.node import Node
from rclpy.task import Future

from pushfric_core.bags.samples import stamp_from_msg
from pushfric_core.cell.node_settings import PlanConfig
from pushfric_core.estimation.push_plan import PlannedPush
from pushfric_core.wording import counted
from pushfric_msgs.msg import CenterOfFrictionRegion, ContactFriction, EstimatorProgress, Observation
from pushfric_msgs.srv import SelectPush
from pushfric_ros.node_kit.diagnostics import Awaited, Diagnostics
from pushfric_ros.node_kit.heartbeat import Listener
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE

NOT_OBSERVED = "no observation came from it"

ASK_AGAIN = 3.0  # an estimator that has not answered, or goes on from a bag, is asked again after so long [s of wall time]

BEFORE_SLIPS = 3  # pushes for p_CF, before every other one that is chosen is for mu_c


class EstimatorAccount:
    """How far the estimator has come, which push it proposes, and which pushes it must leave out. A run may go without one.

    Args:
        node: the experiment's.
        topics: of the node.
        chooses: whether the estimator's results choose the pushes.
    Attributes:
        settled: the time up to which it has processed everything [ns].
        pushed: when the last push ended [ns].
        unwanted: aborted pushes whose observations it has not said yet that it leaves out, once it has made all of them.
    """

    def __init__(self, node: Node, topics: Diagnostics, chooses: bool) -> None:
        self.settled = self.pushed = -1
        self._newest = self._heard = -1  # its newest observation, and the newest that has come here [ns]
        self._judged = False  # whether it has judged all of them
        self._observed = defaultdict[int, set[int]](set)  # push -> the stamps of its observations [ns]
        self._region: CenterOfFrictionRegion | None = None
        self._mu_c = ContactFriction()
        self.unwanted: list[int] = []
        self._exclude = node.create_client(SelectPush, "estimator/exclude_push")
        self._answer: Future | None = None  # on the first unwanted push
        self._asked = -math.inf  # when it was asked for that [s of wall time]
        if chooses:
            topics.subscribe(CenterOfFrictionRegion, "center_of_friction_region", partial(setattr, self, "_region"), LATCHED)
            topics.subscribe(ContactFriction, "contact_friction", partial(setattr, self, "_mu_c"), LATCHED)
        # not a topic without which the node is unwell
        self._progress = node.create_subscription(EstimatorProgress, "estimator_progress", self._on_progress, LATCHED)
        node.create_subscription(Observation, "observation", self._on_observation, RELIABLE)

    @property
    def complete(self) -> bool:
        """Whether it has processed and judged all that was seen, and knows what to leave out."""
        estimated = (self.settled >= self.pushed and self._judged) or not self._progress.get_publisher_count()
        return estimated and not self.unwanted

    @property
    def heard(self) -> bool:
        """Whether its newest observation has come here, too, and so all before it."""
        return self._heard >= self._newest

    def lacks(self, push_id: int) -> str | None:
        """The lack of observations of this push: of all of them, or of half of what others gave; None: there are enough."""
        found, most = len(self._observed[push_id]), max(1, *map(len, self._observed.values()))
        if 2 * found >= most or not self._progress.get_publisher_count():
            return None
        return f"only {counted(found, 'observation')} came from it, up to {most} from others" if found else NOT_OBSERVED

    def ask_exclusions(self) -> None:
        """Tell it what to leave out, if it is time; again, if it died before it answered, or was still reading its bag."""
        if self._answer is not None and self._answer.done():
            push, left_out = self.unwanted.pop(0), self._answer.result().success
            self._answer = None
            if left_out or not self._observed[push]:  # if nothing was observed of it, a refusal is as well
                self._asked = -math.inf
            else:
                self.unwanted.append(push)
        due = self.unwanted and self.settled >= self.pushed and time.monotonic() - self._asked > ASK_AGAIN
        if due and self._progress.get_publisher_count() and self._exclude.service_is_ready():
            self._answer, self._asked = self._exclude.call_async(SelectPush.Request(push_id=self.unwanted[0])), time.monotonic()

    def knows(self, index: int) -> bool:
        """Whether all that chooses the push of this index is known, from the whole last push."""
        known = self._region is not None and stamp_from_msg(self._region.header.stamp) == self._newest
        known = known and (index < BEFORE_SLIPS or stamp_from_msg(self._mu_c.header.stamp) == self._newest)
        return known and self.settled >= self.pushed

    def next_push(self, index: int) -> PlannedPush | None:
        """The next push, once its choice `knows` enough; None if no push is of use.

        It is the one that shrinks the region of p_CF most; but from the fourth on, as long as mu_c has no value, every other
        push is one that slips.
        """
        assert self._region is not None
        shrink, slip = self._region.next_pushes[:1], []
        if index >= BEFORE_SLIPS and self._mu_c.kind in (ContactFriction.KIND_UNKNOWN, ContactFriction.KIND_BOUND):
            turn = (index - BEFORE_SLIPS) // 2
            slip = self._region.slip_pushes[turn : turn + 1]
        chosen = [*slip, *shrink] if (index - BEFORE_SLIPS) % 2 == 0 else [*shrink, *slip]
        return next((PlannedPush(one.edge, one.offset, one.angle) for one in chosen), None)

    def _on_progress(self, msg: EstimatorProgress) -> None:
        newest = stamp_from_msg(msg.header.stamp)
        if self._newest < 0:  # what was observed before this node was there does not come any more
            self._heard = max(self._heard, newest)
        self.settled, self._newest, self._judged = stamp_from_msg(msg.settled_until), newest, msg.judged

    def _on_observation(self, msg: Observation) -> None:
        stamp = stamp_from_msg(msg.header.stamp)
        self._observed[msg.push_id].add(stamp)
        self._heard = max(self._heard, stamp)


class Others:
    """Whether the other nodes receive what a push shows, by clocks that agree, and are of this cell.

    Args:
        node: the experiment's.
        config: which nodes are awaited, and by how much clocks may differ.
        lifeless: age of the last heartbeat of a node that is not well [s].
        plan: full name of the topic that a cell has one publisher of.
    Attributes:
        awaited: the nodes that must report that they are well.
    """

    def __init__(self, node: Node, config: PlanConfig, lifeless: float, plan: str) -> None:
        self._node, self._config, self._lifeless, self._plan = node, config, lifeless, plan
        self.awaited, self._life = Awaited(node, config.awaits), Listener(node)
        # by the source of stamps: how far they are ahead of this node's time [s], and the remedy
        self._offsets: dict[str, tuple[float, str]] = {}

    def compare_clock(self, whose: str, stamp: int, remedy: str) -> None:
        """Note the stamp [ns] of a message that has just come."""
        now = self._node.get_clock().now().nanoseconds
        if now:  # simulated time has begun
            self._offsets[whose] = (stamp - now) / 1e9, remedy

    def unwell(self) -> str | None:
        """The nodes that have not reported OK yet, or whose heartbeat has stopped; None if there is none."""
        self._life.receive()
        signs = {name: self._life.node(name) for name in self._config.awaits}
        lifeless = {name for name, sign in signs.items() if sign is not None and sign.age > self._lifeless}
        return ", ".join(sorted(lifeless.union(self.awaited.missing))) or None

    def foreign_clock(self) -> str | None:
        """Which stamps differ from this node's time, by how much, and what to do; None if all agree."""
        for whose, (offset, remedy) in self._offsets.items():
            if abs(offset) > self._config.clock_tolerance:
                way = "ahead of" if offset > 0 else "behind"
                return f"the clock of {whose} is {abs(offset):.0f} s {way} this computer's: {remedy}"
        return None

    def namesake(self) -> str | None:
        """Whether another cell or node has a name that is used here; on another computer, no lock keeps it from starting."""
        if self._life.twins:
            return f"two nodes named {self._life.twins[0]} are running on this ROS domain: end one of them"
        if len(self._node.get_publishers_info_by_topic(self._plan)) < 2:
            return None
        return (
            f"another cell named {self._node.get_namespace()} is running on this ROS domain: end it, or rename one of the two"
        )
