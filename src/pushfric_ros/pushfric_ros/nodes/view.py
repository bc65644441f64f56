"""The view node: shows a run to browsers, and passes on what their visitors ask for."""

import math
import pathlib
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from rclpy.client import Client
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.task import Future
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import Empty, String
from std_srvs.srv import Trigger

from pushfric_core.bags.run_record import KEYFRAMES
from pushfric_core.bags.samples import observation_from_msg, pose_sample_from_msg, stamp_from_msg
from pushfric_core.cell.node_settings import SWITCHES, ObjectConfig, ShownConfig, ViewConfig
from pushfric_core.errors import PushfricError
from pushfric_core.files.estimator_settings import TOPIC as SETTINGS_TOPIC
from pushfric_core.files.object_file import load_object
from pushfric_core.geometry.planar import Pose
from pushfric_core.page.run_server import PUSH_SERVICES, SERVICES, Server
from pushfric_core.page.server import Request
from pushfric_core.page.story import Change, Story
from pushfric_msgs.msg import FrictionEstimate, Observation, PlanProgress, PusherState
from pushfric_msgs.srv import SelectPush
from pushfric_ros.messages.conversions import MODE_NAMES, pose_to_msg, report_from_msg
from pushfric_ros.node_kit.diagnostics import Diagnostics, Health, Level
from pushfric_ros.node_kit.parameters import declare
from pushfric_ros.node_kit.process import PATIENT, run_node
from pushfric_ros.node_kit.qos import LATCHED, LATCHED_QUEUE, RELIABLE, SENSOR_DATA
from pushfric_ros.node_kit.timers import wall_timer

UNSEEN_PERIOD = 1.0
"""Time between readings of the messages that came while nobody looked [s]."""

LEVELS = {
    DiagnosticStatus.OK: "ok",
    DiagnosticStatus.WARN: "warning",
    DiagnosticStatus.ERROR: "error",
    DiagnosticStatus.STALE: "stale",
}


class ViewNode(Node):
    """Serves a page that shows the run.

    It subscribes to estimates and keyframes from the start, for visitors who come late; to other images, poses and pusher
    states only while somebody looks.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("view", **kwargs)
        model, config = declare(self, ObjectConfig), declare(self, ViewConfig)
        self._story = Story(load_object(model.object), self.get_namespace())
        self._asked: deque[Callable[[], None]] = deque()  # what the server's thread asks this thread to do
        self._wake = self.create_guard_condition(partial(_do_all, self._asked))
        shown = declare(self, ShownConfig)
        told = partial(self._ask, self._carry_out), partial(self._ask, self._look)
        self._server = Server(config, *told, pathlib.Path(shown.report) if shown.report else None)
        self._server.show(self._story.begin() | {"report": shown.report, "played": shown.played})
        tell_pose = partial(self._tell, lambda msg: {"pose": list(pose_sample_from_msg(msg).pose)})
        self.at_times: dict[str, tuple[type, QoSProfile, Callable[[Any], None]]] = {
            "overlay/compressed": (CompressedImage, SENSOR_DATA, lambda msg: self._server.picture(bytes(msg.data))),
            "object_pose": (PoseWithCovarianceStamped, SENSOR_DATA, tell_pose),
            "pusher_state": (PusherState, RELIABLE, partial(self._tell, _pusher)),
        }
        """The topics that are received only while somebody looks: types, qualities of service and callbacks."""
        self._watched: list[Subscription] = []  # the subscriptions to them
        self._looking = False
        self._unread: deque[Callable[[], None]] = deque()  # in the order in which they came
        self._read = partial(_do_all, self._unread)
        self._unshown: set[type] = set()  # types of the messages of which the log says so
        wall_timer(self, UNSEEN_PERIOD, self._read)
        self._stop_out = self.create_publisher(Empty, "stop", RELIABLE)
        self._hand_out = self.create_publisher(PoseStamped, "hand", RELIABLE)
        self._switch_out = self.create_publisher(String, "switch", RELIABLE)
        self._services_of: dict[str, Client] = {
            what: self.create_client(kind, name)
            for kind, services in ((Trigger, SERVICES), (SelectPush, PUSH_SERVICES))
            for what, name in services.items()
        }
        self._diagnostics = topics = Diagnostics(self, self._health)
        story = self._story
        # from the start, even if nobody looks: a visitor who comes late gets all of it
        self._needed = [
            topics.subscribe(kind, topic, partial(self._receive, kind, partial(self._tell, told)), qos, raw=True)
            for kind, topic, told, qos in (
                (FrictionEstimate, "friction_estimate", self._on_estimate, LATCHED_QUEUE),
                (Observation, "observation", lambda msg: story.on_observation(observation_from_msg(msg)), RELIABLE),
                (PlanProgress, "plan_progress", story.on_plan, LATCHED_QUEUE),
                (String, SETTINGS_TOPIC, lambda msg: story.on_settings(msg.data), LATCHED),
                (String, "pusher_fault", lambda msg: story.on_fault(msg.data), LATCHED),
            )
        ][:2]
        keep = partial(self._receive, CompressedImage, self._on_keyframe)
        topics.subscribe(CompressedImage, KEYFRAMES, keep, RELIABLE, raw=True)
        self.create_subscription(DiagnosticArray, "/diagnostics", partial(self._tell, self._on_diagnostics), RELIABLE)

    @property
    def url(self) -> str:
        """The address of the page."""
        return self._server.url

    def destroy_node(self) -> None:
        """Take leave of the visitors, too."""
        self._server.close()
        super().destroy_node()

    def _tell(self, told: Callable[[Any], Change], msg: Any) -> None:
        """Tell the visitors what a message changes."""
        self._attempt(type(msg), lambda: told(msg), self._server.show)

    def _attempt(self, kind: type, read: Callable[[], Any], use: Callable[[Any], None]) -> None:
        """Read a message of this type, which may make no sense, or be of another version, and use what it says."""
        try:
            found = read()
        except (ValueError, PushfricError, rclpy_implementation.RMWError) as error:
            if kind not in self._unshown:  # the logger's own `once` would be for messages of all types together
                self._unshown.add(kind)
                self.get_logger().error(f"{kind.__name__} not shown: {error}")
        else:
            use(found)

    def _receive(self, kind: type, act: Callable[[Any], None], data: bytes) -> None:
        """Take the bytes of a message: in their order, at once if somebody looks, else later."""
        self._unread.append(lambda: self._attempt(kind, lambda: deserialize_message(data, kind), act))
        if self._looking:
            self._read()

    def _ask(self, do: Callable[[Any], None], what: Any) -> None:
        """In the server's thread: have something done in this node's."""
        self._asked.append(lambda: do(what))
        self._wake.trigger()

    def _look(self, looking: bool) -> None:
        """Begin to receive what moves and to read all at once, or stop."""
        self._looking = looking
        self._read()
        for subscription in self._watched:
            self.destroy_subscription(subscription)
        self._watched = []
        for topic, (kind, qos, callback) in self.at_times.items() if looking else ():
            self._watched.append(self.create_subscription(kind, topic, callback, qos))

    def _on_diagnostics(self, msg: DiagnosticArray) -> Change:
        """The health of the cell's nodes, and of no others."""
        prefix = f"{self.get_namespace().rstrip('/')}/"
        return {
            f"node/{status.name.removeprefix(prefix)}": {
                "level": LEVELS.get(status.level, "error"),
                "message": status.message,
                "values": {value.key: value.value for value in status.values},
            }
            for status in msg.status
            if status.name.startswith(prefix)
        }

    def _on_estimate(self, msg: FrictionEstimate) -> Change:
        return self._story.on_estimate(None if msg.status == FrictionEstimate.STATUS_NO_DATA else report_from_msg(msg))

    def _on_keyframe(self, msg: CompressedImage) -> None:
        jpeg = bytes(msg.data)
        self._server.show(self._story.on_picture(stamp_from_msg(msg.header.stamp), len(jpeg)), jpeg)

    def _carry_out(self, request: Request) -> None:
        """Call the service that a visitor's request means; a stop also goes out on its topic, at once."""
        action, *given = request.what.split("/")
        numbers = list(map(int, given))
        if action == "lay" or action in SWITCHES:
            simulated = self._hand_out.get_subscription_count() > 0
            if action == "lay":
                x, y, turn = numbers
                self._hand_out.publish(PoseStamped(pose=pose_to_msg(Pose(1e-4 * x, 1e-4 * y, math.radians(0.1 * turn)))))
            else:
                self._switch_out.publish(String(data=action))
            request.answer({"done": simulated, "message": "done" if simulated else "nobody simulates this cell"})
            return
        client = self._services_of[action]
        if action == "stop":
            self._stop_out.publish(Empty())
        if not client.service_is_ready():
            name = self.resolve_service_name(client.srv_name)
            request.answer({"done": False, "message": f"no service {name}: nobody there can do it"})
            return

        def answered(future: Future) -> None:
            response = future.result()
            request.answer({"done": response.success, "message": response.message})

        question = SelectPush.Request(push_id=numbers[0]) if numbers else Trigger.Request()
        client.call_async(question).add_done_callback(answered)

    def _health(self) -> Health:
        silent = [subscription.topic_name for subscription in self._needed if not subscription.get_publisher_count()]
        values = {"address": self._server.url.partition("?")[0], "somebody looks": self._looking}
        if silent and not self._story.is_over:
            return Health(Level.WARN, f"no publisher of {', '.join(silent)}", values)
        return Health(Level.OK, "serving", values)


def _do_all(waiting: deque[Callable[[], None]]) -> None:
    """Do what waits, in its order."""
    while waiting:
        waiting.popleft()()


def _pusher(msg: PusherState) -> Change:
    """Where the pusher is."""
    return {
        "pusher": {
            "mode": MODE_NAMES.get(msg.mode, str(msg.mode)),
            "position": msg.position,
            "tip": [msg.tip.x, msg.tip.y],
            "direction": [msg.direction.x, msg.direction.y],
            "radius": msg.tip_radius,
            "in_doubt": msg.in_doubt,
            "age": msg.age,
        }
    }


def _announced() -> ViewNode:
    """The node, once its address is printed for the operator; the supervisor puts the node's name before it."""
    node = ViewNode()
    print(node.url, flush=True)
    return node


def main() -> None:
    run_node(_announced, niceness=PATIENT)
