"""Signs of life: what a node publishes while it works, and what an actuator makes of those it hears.

A thread of its own publishes a node's heartbeats, so that neither a long callback nor a full queue delays them. A heartbeat
shows that the process runs, and says for how long the node's executor, which does its work, has not turned. The owner of a
push must be able to cancel it, so its executor's standstill counts like silence: death and hang have the same limit. Another
node may have much to do; if it hangs, it ends itself (`process.HUNG`).

Deadline and liveliness of the middleware cannot say this. All publishers of a topic share its deadline: as long as one is
alive, none is missed. Liveliness (by topic, a lease of 0.25 s) notices death, SIGSTOP and hang after 0.22 to 0.24 s, as
heartbeats do. But its event counts publishers and does not name them, says neither whose goal it is nor what happened, and the
lease belongs to the match: a client with a longer one would not be heard at all, whatever `owner_timeout` allows. The
middleware rmw_zenoh raises neither event (ros2/rmw_zenoh#934).
"""

import threading
import time
import uuid
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

from rclpy.exceptions import InvalidHandle
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.task import Future
from unique_identifier_msgs.msg import UUID

from pushfric_msgs.msg import Heartbeat as HeartbeatMsg
from pushfric_ros.node_kit.losses import waited, waiting
from pushfric_ros.node_kit.qos import NEWEST, NEWEST_OF_MANY
from pushfric_ros.node_kit.timers import wall_timer

TOPIC = "heartbeat"
PERIOD = 0.05  # [s] of real time

FORGOTTEN = 60.0
"""A goal whose owner has shown no sign of life for this long is unknown again [s]."""

TWINS, TWINS_WITHIN = 3, 2.0
"""If the number of a node falls this many times within this time [s], two nodes share its name. That of a node that is started
again falls once."""

NOBODY = bytes(16)
"""Stands for no goal in place of its id."""


class Heartbeat:
    """Publishes a node's signs of life until the node is destroyed; with the goal that it owns, while it owns one."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._msg = HeartbeatMsg(node=node.get_fully_qualified_name())
        self._out = node.create_publisher(HeartbeatMsg, TOPIC, NEWEST)
        self._turned = time.monotonic()  # when the executor last did
        self._publishing, self._woken, self._over = threading.Lock(), threading.Event(), False
        self._timer = wall_timer(node, PERIOD, self._turn)
        self._thread = threading.Thread(target=self._beat, name="heartbeat", daemon=True)
        self._thread.start()

    def send(self, client: Any, goal: Any, on_feedback: Callable[[Any], None] | None = None) -> Future:
        """Send a goal by the client of an action, as its `send_goal_async` does, and own it from now on."""
        owned = uuid.uuid4().bytes
        self.own(owned)
        return client.send_goal_async(goal, on_feedback, UUID(uuid=list(owned)))

    def own(self, goal: bytes | None) -> None:
        """Own a goal of `push` from now on, and say so at once: its id, 16 bytes; None to own no goal any longer."""
        with self._publishing:
            self._msg.goal = list(goal or NOBODY)
        self._turned = time.monotonic()
        self._publish()

    def end(self) -> None:
        """Show no sign of life any more; the publisher goes with the node, whose executor may be using it."""
        self._timer.cancel()
        self._over = True
        self._woken.set()
        self._thread.join()

    def _turn(self) -> None:
        self._turned = time.monotonic()
        self._woken.set()

    def _beat(self) -> None:
        while True:
            self._woken.wait(1.5 * PERIOD)  # an executor that turns wakes it; then the heartbeat says that it has just turned
            self._woken.clear()
            if self._over:
                return
            try:
                self._publish()
            except InvalidHandle:  # the node was destroyed
                return
            except rclpy_implementation.RCLError:
                if self._node.context.ok():
                    raise
                return

    def _publish(self) -> None:
        with self._publishing:
            self._msg.number += 1
            self._msg.stalled = time.monotonic() - self._turned
            self._out.publish(self._msg)


class Sign(NamedTuple):
    """The last sign of life of a node."""

    number: int
    came: float  # by time.monotonic() [s]
    stalled: float  # for how long the node's executor had not turned when it was sent [s]

    @property
    def age(self) -> float:
        """How long ago it came: for how long the node's process is not known to have run [s]."""
        return time.monotonic() - self.came

    @property
    def idle(self) -> float:
        """For how long the node's executor is not known to have turned [s]."""
        return self.age + self.stalled

    def __str__(self) -> str:
        said = f"last heartbeat, number {self.number}, came {self.age:.2f} s ago"
        # the executor notes its turns as often as heartbeats are sent
        return said if self.stalled < 2 * PERIOD else f"{said} and said that its executor had hung for {self.stalled:.2f} s"


class Listener:
    """The last signs of life of nodes, and of owners of goals."""

    def __init__(self, node: Node) -> None:
        self._nodes: dict[str, Sign] = {}
        self._goals: dict[bytes, Sign] = {}
        self._falls: dict[str, deque[float]] = {}  # when a node's number fell
        self._prefix = node.get_namespace().rstrip("/") + "/"
        self._looked = time.monotonic()
        self._subscription = node.create_subscription(HeartbeatMsg, TOPIC, self._on_heartbeat, NEWEST_OF_MANY)

    def receive(self) -> None:
        """Take all heartbeats that have arrived, so that none that waits in the queue counts as missing."""
        now, since = time.monotonic(), self._looked
        for msg, info in waiting(self._subscription):
            self._hear(msg, info, since)
        self._looked = now

    def node(self, name: str) -> Sign | None:
        """The last sign of a node, whose name is relative to the namespace; None: it has shown none."""
        return self._nodes.get(self._prefix + name)

    def owner(self, goal: bytes) -> Sign | None:
        """The last sign of the owner of a goal; None: it has shown none."""
        return self._goals.get(goal)

    @property
    def twins(self) -> list[str]:
        """The full names that two living nodes share; on another computer, no lock keeps the second one from starting."""
        now = time.monotonic()
        return sorted(name for name, falls in self._falls.items() if len(falls) == TWINS and now - falls[0] < TWINS_WITHIN)

    def _on_heartbeat(self, msg: HeartbeatMsg, info: dict[str, Any]) -> None:
        self._hear(msg, info, self._looked)
        self.receive()

    def _hear(self, msg: HeartbeatMsg, info: dict[str, Any], since: float) -> None:
        """Note a heartbeat, with the time at which the middleware received it, which lies after the last look."""
        now = time.monotonic()
        sign = Sign(msg.number, max(now - waited(info), since), max(msg.stalled, 0.0))
        if msg.node in self._nodes and sign.number <= self._nodes[msg.node].number:
            self._falls.setdefault(msg.node, deque(maxlen=TWINS)).append(now)
        self._nodes[msg.node] = sign
        self._goals = {known: last for known, last in self._goals.items() if now - last.came < FORGOTTEN}
        if (goal := bytes(msg.goal)) != NOBODY:
            self._goals[goal] = sign
