"""A person at the pusher of a running cell: what the commands stop, reset, status, echo and jog share."""

import contextlib
import os
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from pushfric_core.errors import PushfricError
from pushfric_msgs.action import Push
from pushfric_msgs.msg import PusherState
from pushfric_ros.node_kit.heartbeat import Heartbeat
from pushfric_ros.node_kit.lock import who_runs
from pushfric_ros.node_kit.qos import RELIABLE
from pushfric_ros.node_kit.timers import wall_timer
from pushfric_ros.node_kit.visit import COMMAND_LINE, SERVING_NOTHING, Visit, enclave

ANSWER_TIMEOUT = 5.0
"""How long the actuator may take to answer [s]."""


class NoAnswer(PushfricError):
    """No actuator answers, or it answers that it will not."""


def line(state: PusherState) -> str:
    from pushfric_ros.messages.conversions import MODE_NAMES  # takes longer to load than all that a stop needs

    push = "" if state.push_id == PusherState.NO_PUSH else f", push {state.push_id}"
    doubt = " (in doubt" + (f", reported {state.age:.1f} s ago)" if state.age else ")") if state.in_doubt else ""
    place = f"{state.position * 1e3:z.3f} mm{doubt}"
    return f"{MODE_NAMES.get(state.mode, state.mode)} at {place}, {state.speed * 1e3:z.2f} mm/s{push}"


class Person(contextlib.AbstractContextManager["Person"]):
    """The person's own node, for as long as one command takes."""

    def __init__(self, namespace: str) -> None:
        make = partial(Node, f"person_{os.getpid()}", namespace=namespace, **SERVING_NOTHING)
        self._visit = Visit(make, enclave(namespace, COMMAND_LINE))
        self._node = self._visit.node
        self._state: PusherState | None = None
        self._health: dict[str, DiagnosticStatus] = {}  # of each node
        self._node.create_subscription(PusherState, "pusher_state", partial(setattr, self, "_state"), RELIABLE)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._note, RELIABLE)
        self._actuator = f"{self._node.get_namespace().rstrip('/')}/actuator"

    def __exit__(self, *_: object) -> None:
        self._visit.close()

    def _note(self, report: DiagnosticArray) -> None:
        self._health |= {status.name: status for status in report.status}

    @contextlib.contextmanager
    def hearing(self, kind: type, topic: str, qos: Any, take: Callable[[Any], None]) -> Iterator[None]:
        """Have a function take each message of a topic, while this person waits for anything."""
        subscription = self._node.create_subscription(kind, topic, take, qos)
        try:
            yield
        finally:
            self._node.destroy_subscription(subscription)

    def spin(self, seconds: float) -> None:
        """Wait this long [s], and take the messages that come."""
        self._visit.spin_once(seconds)

    def say_stop(self, seconds: float | None = None) -> None:
        """Publish a stop on the topic, which also reaches nodes that serve no service, once somebody listens.

        Args:
            seconds: how long that is awaited.
        Raises:
            NoAnswer: nobody listens to the topic.
        """
        out = self._node.create_publisher(Empty, "stop", RELIABLE)
        self._wait(out.get_subscription_count, f"nobody listens to {out.topic_name}; {who_runs()}", seconds)
        out.publish(Empty())

    @contextlib.contextmanager
    def repeating(self, topic: str, message: Any, qos: Any, seconds: float) -> Iterator[None]:
        """Publish a message again and again, while this person waits for anything; first wait so long [s] for a listener.

        Raises:
            NoAnswer: nobody listens to the topic.
        """
        out = self._node.create_publisher(type(message), topic, qos)
        timer = wall_timer(self._node, 0.05, lambda: out.publish(message))
        try:
            self._wait(out.get_subscription_count, f"nobody listens to {out.topic_name}", seconds)
            yield
        finally:
            self._node.destroy_timer(timer)
            self._node.destroy_publisher(out)

    def call(self, service: str) -> str:
        """The answer of a Trigger service.

        Raises:
            NoAnswer: nobody answers, or the answer is a refusal.
        """
        client = self._node.create_client(Trigger, service)
        try:
            self._wait(client.service_is_ready, f"no service {self._node.resolve_service_name(service)}; {who_runs()}")
            answer = self._future(client.call_async(Trigger.Request()), f"{client.srv_name} does not answer")
        finally:
            self._node.destroy_client(client)
        if not answer.success:
            raise NoAnswer(f"{self._node.resolve_service_name(service)}: {answer.message}")
        return str(answer.message)

    def state(self, new: bool = False) -> PusherState:
        """The last state; with `new`, one that was not returned before.

        Raises:
            NoAnswer: no state comes.
        """
        if new:
            self._state = None
        self._wait(lambda: self._state, f"no pusher_state comes; {who_runs()}")
        assert self._state is not None
        return self._state

    def health(self) -> dict[str, str]:
        """The actuator's diagnostics.

        Raises:
            NoAnswer: none come.
        """
        self._wait(lambda: self._actuator in self._health, "no diagnostics of the actuator come")
        last = self._health[self._actuator]
        return {"message": last.message, **{value.key: value.value for value in last.values}}

    def jog(self, distance: float, speed: float) -> str:
        """Move the pusher by a distance [m] at a speed [m/s], and own the goal until it is done.

        Raises:
            NoAnswer: the actuator does not answer or refuses, or the pusher does not arrive.
        """
        try:
            client = ActionClient(self._node, Push, "push")
        except ValueError as error:
            raise NoAnswer("the permissions of the command line do not allow to push (SROS 2)") from error
        heartbeat = Heartbeat(self._node)
        try:
            self._wait(client.server_is_ready, f"no action push; {who_runs()}")
            goal = Push.Goal(push_id=PusherState.NO_PUSH, distance=distance, speed=speed)
            sent = heartbeat.send(client, goal)
            try:
                handle = self._future(sent, "no answer to the jog")
                if not handle.accepted:
                    self._health.clear()  # those from before do not know of it
                    raise NoAnswer(f"the actuator refuses: {self.health()['last refusal']}")
                seconds = abs(distance) / speed * 4 + ANSWER_TIMEOUT
                result = self._future(handle.get_result_async(), "the jog does not end", seconds).result
            except BaseException:  # Ctrl-C, above all
                if self._visit.spin_until(sent.done, ANSWER_TIMEOUT) and (handle := sent.result()).accepted:
                    handle.cancel_goal_async()
                    self._visit.spin_until(handle.get_result_async().done, ANSWER_TIMEOUT)
                raise
        finally:
            heartbeat.end()
            client.destroy()
        if result.outcome != Push.Result.OUTCOME_REACHED:
            raise NoAnswer(result.message)
        return f"{result.message}: {result.travelled * 1e3:.3f} mm"

    def _future(self, future: Future, otherwise: str, seconds: float | None = None) -> Any:
        self._wait(future.done, otherwise, seconds)
        return future.result()

    def _wait(self, condition: Callable[[], object], otherwise: str, seconds: float | None = None) -> None:
        if not self._visit.spin_until(condition, ANSWER_TIMEOUT if seconds is None else seconds):
            raise NoAnswer(otherwise)
