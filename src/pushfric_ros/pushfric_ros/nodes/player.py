"""The player node: publishes the messages of a bag again, at the recorded speed or another."""

from collections.abc import Callable, Collection
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rosgraph_msgs.msg import Clock as ClockMsg
from std_srvs.srv import SetBool

from pushfric_core.bags.bag import Bag
from pushfric_core.bags.contents import BagMessage, Topic
from pushfric_core.cell.node_settings import PlayerConfig
from pushfric_core.errors import InvalidInput
from pushfric_core.wording import counted
from pushfric_ros.messages.types import recorded_class
from pushfric_ros.node_kit.diagnostics import Awaited, Diagnostics, Health, Level
from pushfric_ros.node_kit.parameters import declare, topic_name
from pushfric_ros.node_kit.process import run_node
from pushfric_ros.node_kit.qos import RELIABLE

CLOCK_TOPIC = "/clock"
CLOCK_PERIOD_NS = 10_000_000  # of bag time
SHORTEST_CLOCK_PERIOD_NS = 2_000_000  # of wall time: no more than 500 /clock messages a second at high rates
BURST = 100  # messages in one callback, so that a late player still answers its service in between
WATCH_PERIOD_NS = 20_000_000  # of wall time, between checks of endpoints and acknowledgements
ACKNOWLEDGE_WITHIN_NS = 5_000_000_000  # of wall time
DEFAULT_DEPTH = 10
DEPTH_LIMIT = 10_000  # most messages kept for late acknowledgements, whatever the bag says
LATE = 1.0  # of wall time [s]; a player that is later than this warns


class PlayerNode(Node):
    """Plays a bag on a steady wall clock; ~/pause (std_srvs/SetBool) holds and resumes it.

    Every topic is offered reliably. Otherwise the QoS is that of the recorded publishers.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("player", **kwargs)
        self._config = config = declare(self, PlayerConfig)
        self._bag = Bag(config.bag)
        if self._bag.damage is not None:
            if self._bag.damage.loses_messages and not config.partial:
                raise InvalidInput(f"{self._bag.what_is_missing()}; expected a whole bag, or the parameter partial")
            self.get_logger().warning(self._bag.what_is_missing())
        summary = self._bag.summary
        if not summary.message_count:
            raise InvalidInput(f"{config.bag}: holds no messages, expected some to play")
        self._begin_ns = summary.start_ns
        played = self._chosen(summary.topics)
        classes = [recorded_class(topic) for topic in played]
        self._diagnostics = Diagnostics(self, self._health)
        self._outputs: dict[str, Publisher] = {
            topic.name: self._diagnostics.advertise(kind, topic.name, _offered(topic))
            for topic, kind in zip(played, classes, strict=True)
        }
        self._played = tuple(self._outputs)
        if config.clock:
            self._outputs[CLOCK_TOPIC] = self._diagnostics.advertise(ClockMsg, CLOCK_TOPIC, RELIABLE)
        self._awaited = [self._outputs[name] for name in self._names("wait_for", config.wait_for, self._outputs)]
        self._nodes = Awaited(self, config.awaits)
        self._clock_period_ns = max(CLOCK_PERIOD_NS, round(SHORTEST_CLOCK_PERIOD_NS * config.rate))
        self._wall = Clock(clock_type=ClockType.STEADY_TIME)
        self._paused = config.paused
        self._count = 0
        self._next: BagMessage | None = None
        self._anchor(self._begin_ns)
        self.create_service(SetBool, "~/pause", self._on_pause)
        self._timer = self.create_timer(WATCH_PERIOD_NS * 1e-9, self._await_subscribers, clock=self._wall)

    @property
    def done(self) -> bool:
        """Whether all is played, and acknowledged by the subscribers that acknowledge messages."""
        return self._timer.is_canceled()

    def _chosen(self, topics: tuple[Topic, ...]) -> list[Topic]:
        recorded = [topic.name for topic in topics]
        wanted = self._names("topics", self._config.topics, recorded) or recorded
        # two clocks would contradict each other
        return [one for one in topics if one.name in wanted and not (self._config.clock and one.name == CLOCK_TOPIC)]

    def _names(self, parameter: str, texts: tuple[str, ...], known: Collection[str]) -> list[str]:
        """Full names of the topics that a parameter lists."""
        names = []
        for text in filter(None, texts):
            # not remapped, because remapping applies to the published topics, not to the bag
            if (name := topic_name(self, parameter, text)) not in known:
                where = f"{self.get_fully_qualified_name()}: parameter {parameter}"
                raise InvalidInput(f"{where}: {name} is not played from {self._config.bag}, expected one of {', '.join(known)}")
            names.append(name)
        return names

    def _await_subscribers(self) -> None:
        if not self._paused and not self._nodes.missing and all(output.get_subscription_count() for output in self._awaited):
            self._messages = self._bag.messages(self._played)
            self._next = next(self._messages, None)
            self._next_clock_ns = self._begin_ns
            self._publish_clock()
            self._anchor(self._begin_ns)
            self._call_in(0, self._play)

    def _play(self) -> None:
        """Publish what is due, and come back when the next message is due."""
        now_ns = self._bag_time()
        wait_ns = 0
        for _ in range(BURST):
            if self._next is None:
                self._end()
                return
            clock_is_next = self._config.clock and self._next_clock_ns <= self._next.log_time_ns
            wait_ns = (self._next_clock_ns if clock_is_next else self._next.log_time_ns) - now_ns
            if wait_ns > 0:
                break
            if clock_is_next:
                self._publish_clock()
            else:
                self._publish(self._next)
                self._next = next(self._messages, None)
        self._call_in(WATCH_PERIOD_NS if self._paused else max(0, round(wait_ns / self._config.rate)), self._play)

    def _end(self) -> None:
        self.get_logger().info(f"{counted(self._count, 'message')} played")
        self._give_up_ns = self._wall.now().nanoseconds + ACKNOWLEDGE_WITHIN_NS
        self._call_in(0, self._await_acknowledgements)

    def _await_acknowledgements(self) -> None:
        if not all(output.wait_for_all_acked(Duration(seconds=0)) for output in self._outputs.values()):
            if self._wall.now().nanoseconds < self._give_up_ns:
                self._call_in(WATCH_PERIOD_NS, self._await_acknowledgements)
                return
            self.get_logger().warning("a subscriber did not acknowledge all messages")
        self._timer.cancel()
        if self._config.exit_when_done:
            raise SystemExit(0)

    def _call_in(self, wait_ns: int, callback: Callable[[], None]) -> None:
        """Let the timer call `callback` after some wall time [ns]."""
        self._timer.callback = callback
        self._timer.timer_period_ns = max(1, wait_ns)
        self._timer.reset()

    def _anchor(self, bag_ns: int) -> None:
        """Let the bag's time run from this moment on."""
        self._anchor_bag_ns, self._anchor_wall_ns = bag_ns, self._wall.now().nanoseconds

    def _bag_time(self) -> int:
        if self._paused:
            return self._anchor_bag_ns
        return self._anchor_bag_ns + round((self._wall.now().nanoseconds - self._anchor_wall_ns) * self._config.rate)

    def _publish(self, message: BagMessage) -> None:
        self._outputs[message.topic].publish(message.raw)
        self._count += 1

    def _publish_clock(self) -> None:
        if self._config.clock:
            self._outputs[CLOCK_TOPIC].publish(ClockMsg(clock=Time(nanoseconds=self._next_clock_ns).to_msg()))
            self._next_clock_ns += self._clock_period_ns

    def _health(self) -> Health:
        late = 0.0 if self._next is None else max(0, self._bag_time() - self._next.log_time_ns) * 1e-9 / self._config.rate
        values = {"messages": self._count, "rate": self._config.rate, "paused": self._paused, "late [s]": round(late, 3)}
        missing = [output.topic_name for output in self._awaited if not output.get_subscription_count()]
        if missing and not self._count:
            return Health(Level.WARN, f"waiting for subscribers of {', '.join(missing)}", values)
        if late > LATE:
            return Health(Level.WARN, f"cannot keep up: {late:.1f} s late, try a lower rate", values)
        return Health(Level.OK, "all is played" if self.done else "paused" if self._paused else "playing", values)

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._anchor(self._bag_time())
        self._paused = request.data
        response.success = True
        response.message = f"{'paused' if self._paused else 'playing'} at {self._anchor_bag_ns * 1e-9:.3f} s"
        return response


def _offered(topic: Topic) -> QoSProfile:
    """An offer that satisfies every subscriber; it promises no rates or lifetimes.

    It is always reliable: what was recorded must not be lost on the way to a second listener.
    """
    latched = any(qos.durability.name == "TRANSIENT_LOCAL" for qos in topic.qos_profiles)
    return QoSProfile(
        # discovery does not carry the depth: 0 in bags of `ros2 bag record`
        depth=min(max((qos.depth for qos in topic.qos_profiles), default=0), DEPTH_LIMIT) or DEFAULT_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def main() -> None:
    run_node(PlayerNode, images=True)
