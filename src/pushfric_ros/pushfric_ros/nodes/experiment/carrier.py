"""The goals that the experiment has the pusher carry out."""

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.node import Node

from pushfric_msgs.action import Push
from pushfric_msgs.msg import PusherState
from pushfric_ros.node_kit.heartbeat import Heartbeat
from pushfric_ros.nodes.experiment.operator import Operator
from pushfric_ros.nodes.experiment.reports import ReportedPusher, SeenObject


class Carrier:
    """Has the pusher carry out goals, and stops it when the object or the operator gives reason to.

    Args:
        node: the experiment's, whose heartbeat shows that it owns a goal.
        action: of the pusher.
        pusher, seen, operator: the pusher, the object and the operator, as they are known.
    """

    def __init__(self, node: Node, action: ActionClient, pusher: ReportedPusher, seen: SeenObject, operator: Operator) -> None:
        self._heartbeat, self._action = Heartbeat(node), action
        self._pusher, self._object, self._operator = pusher, seen, operator

    async def carry(self, goal: Push.Goal) -> str | None:
        """Have the pusher carry out a goal, and own it meanwhile; return what went wrong, or None."""
        problem = await self._owned(goal)
        self._heartbeat.own(None)
        return problem

    async def _owned(self, goal: Push.Goal) -> str | None:
        pusher = self._pusher
        # feedback tells that the actuator has the goal
        answered = self._heartbeat.send(self._action, goal, lambda _: pusher.has_goal())
        pusher.has_goal()
        _, forgotten = await self._operator.until(answered.done, pusher.forgotten)
        if not answered.done():
            return f"the pusher does not answer: {forgotten}"
        handle = answered.result()
        if not handle.accepted:
            return "the pusher refused it"
        result = handle.get_result_async()
        pusher.has_goal()
        self._object.follow()
        over, forgotten, reason = await self._operator.until(result.done, pusher.forgotten, self._reason_to_stop)
        if stopped := not (over or forgotten):
            pusher.blind = self._object.unseen
            handle.cancel_goal_async()
            _, forgotten = await self._operator.until(result.done, pusher.forgotten)
        if not result.done():
            return f"the pusher forgot it: {forgotten}"
        if result.result().status == GoalStatus.STATUS_SUCCEEDED:
            return None
        return reason if stopped else str(result.result().result.message)

    def _reason_to_stop(self) -> str | None:
        """Why the pusher must not go on forward; None if it may."""
        if self._pusher.state.push_id == PusherState.NO_PUSH:
            return None
        return self._operator.choice.value if self._operator.choice is not None else self._object.astray
