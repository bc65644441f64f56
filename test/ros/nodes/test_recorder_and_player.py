"""The recorder and the player over the real middleware: a recording that is played and recorded again stays the same."""

import contextlib
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from types import SimpleNamespace

import pytest
from calls import killed_at_the_end
from composition import made
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.time import Time
from rclpy.type_hash import TypeHash
from rosbags.interfaces import QosDurability, QosReliability
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from std_srvs.srv import SetBool

from pushfric_core.bags.bag import Bag
from pushfric_core.bags.bag_writer import BagWriter, offered
from pushfric_core.bags.contents import BagMessage
from pushfric_core.errors import InvalidInput
from pushfric_msgs.msg import Observation
from pushfric_ros.messages import types as message_types
from pushfric_ros.messages.types import definition, message_class
from pushfric_ros.node_kit.diagnostics import Level
from pushfric_ros.node_kit.losses import Losses
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE, SENSOR_DATA, SENSOR_QUEUE
from pushfric_ros.nodes.player import PlayerNode
from pushfric_ros.nodes.recorder import QUEUE_DEPTH, MessagesLost, RecorderNode

OBSERVATION = "pushfric_msgs/msg/Observation"
POINT = "geometry_msgs/msg/PointStamped"
STRING = "std_msgs/msg/String"
SECOND = 10**9
START = 1_700_000_000 * SECOND
TOPICS = [f"observation {OBSERVATION} reliable", f"center_of_friction {POINT} latched", f"text {STRING} sensor_data"]
RECORDER, PLAYER = (f"from pushfric_ros.nodes.{name} import main; main()" for name in ("recorder", "player"))
NAMES = ["/cell/observation", "/cell/center_of_friction", "/cell/text"]


def player(**values) -> PlayerNode:
    return made(PlayerNode, exit_when_done=False, **values)


def content(message: BagMessage) -> object:
    """What a message says to a reader with the installed types."""
    return deserialize_message(message.raw, message_class(message.type_name))


def make_bag(folder: pathlib.Path, count: int = 30, period_ns: int = 10_000_000) -> list[BagMessage]:
    """A bag whose three topics take turns; two messages share each log time."""
    with BagWriter(folder) as writer:
        for name, type_name, qos in zip(NAMES, (OBSERVATION, POINT, STRING), (RELIABLE, LATCHED, SENSOR_DATA), strict=True):
            writer.add_topic(name, type_name, [offered(qos)], text=definition(type_name))
        for number in range(count):
            point = PointStamped()
            point.point.x = float(number)
            msg = (Observation(push_id=number), point, String(data=f"message {number}"))[number % 3]
            writer.write(NAMES[number % 3], START + number // 2 * period_ns, serialize_message(msg))
    return list(Bag(folder).messages())


def contents(folder: pathlib.Path) -> list[tuple[str, bytes]]:
    return [(message.topic, message.raw) for message in Bag(folder).messages()]


def by_topic(pairs: list[tuple[str, bytes]]) -> dict[str, list[bytes]]:
    return {name: [raw for topic, raw in pairs if topic == name] for name in NAMES}


class Listener:
    """Keeps the texts of the observations, points and strings that it receives, in order, and the times of the clock."""

    def __init__(self, ros, name: str = "listener") -> None:
        self.node: Node = ros.node(name, namespace="/cell")
        self.heard: list[str] = []
        self.clock: list[int] = []
        self.node.create_subscription(Observation, "observation", lambda msg: self.heard.append(f"o{msg.push_id}"), RELIABLE)
        self.node.create_subscription(String, "text", lambda msg: self.heard.append(f"t{msg.data}"), SENSOR_QUEUE)
        # a deep queue, so that nothing is overwritten in a busy moment before it is received
        latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        point = "center_of_friction"
        self.node.create_subscription(PointStamped, point, lambda msg: self.heard.append(f"p{msg.point.x:g}"), latched)
        self.node.create_subscription(Clock, "/clock", self._on_clock, RELIABLE)

    def _on_clock(self, msg: Clock) -> None:
        self.clock.append(Time.from_msg(msg.clock).nanoseconds)


# --- the recorder ---


@pytest.fixture
def outputs(ros):
    """Publishers of the three topics, in a namespace."""
    node = ros.node("sender", namespace="/cell")
    return [
        node.create_publisher(Observation, "observation", RELIABLE),
        node.create_publisher(PointStamped, "center_of_friction", LATCHED),
        node.create_publisher(String, "text", SENSOR_DATA),
    ]


@contextlib.contextmanager
def recorder_process(ros, outputs, folder: pathlib.Path) -> Iterator[subprocess.Popen]:
    """A recorder as a process of its own, which hears the three topics; it does not outlive the block."""
    arguments = ["--ros-args", "-r", "__ns:=/cell", "-p", f"bag:={folder}", "-p", f"topics:={TOPICS}"]
    with killed_at_the_end([sys.executable, "-c", RECORDER, *arguments], stderr=subprocess.PIPE) as process:
        wait_until_matched(ros, outputs)
        yield process


def ended(process: subprocess.Popen, signum: int | None = None) -> tuple[int, str]:
    """Exit code of a process, and what it said."""
    for number in (signal.SIGCONT, signum) if signum is not None else ():
        process.send_signal(number)
    _, errors = process.communicate(timeout=120)
    return process.returncode, errors.decode()


def wait_until_matched(ros, outputs) -> None:
    ros.wait_for(lambda: all(output.get_subscription_count() for output in outputs), what="a subscriber to each topic")


def test_the_recorder_keeps_every_byte(ros, outputs, tmp_path):
    outputs[1].publish(PointStamped())  # latched before the recorder exists
    node = ros.compose(made(RecorderNode, bag=str(tmp_path / "bag"), topics=TOPICS))
    wait_until_matched(ros, outputs)
    sent = [serialize_message(String(data=f"text {number}")) for number in range(50)]
    before = node.get_clock().now().nanoseconds
    for raw in sent:
        outputs[2].publish(raw)
    ros.wait_for(lambda: node._bag.message_count == 51, what="51 recorded messages")
    after = node.get_clock().now().nanoseconds
    ros.end(node)
    texts = list(Bag(tmp_path / "bag").messages(["/cell/text"]))
    assert [message.raw for message in texts] == sent
    assert all(before <= message.log_time_ns <= after for message in texts)
    (point,) = Bag(tmp_path / "bag").messages(["/cell/center_of_friction"])
    assert deserialize_message(point.raw, PointStamped) == PointStamped()
    topics = {topic.name: topic for topic in Bag(tmp_path / "bag").summary.topics}
    assert list(topics) == NAMES
    assert topics["/cell/center_of_friction"].qos_profiles[0].durability is QosDurability.TRANSIENT_LOCAL
    assert topics["/cell/text"].qos_profiles[0].reliability is QosReliability.BEST_EFFORT
    assert topics["/cell/observation"].type_hash == message_types.type_hash(OBSERVATION)


@pytest.mark.parametrize("hashed", [True, False])
def test_discovery_records_with_the_qos_and_the_hash_of_the_publisher(ros, outputs, tmp_path, monkeypatch, hashed):
    monkeypatch.setattr(TypeHash, "_TYPE_HASH_SIZE", 32 * hashed)  # 0: as of the nodes of ROS 2 Humble
    node = ros.compose(made(RecorderNode, bag=str(tmp_path / "bag"), discover=True))
    wait_until_matched(ros, outputs)
    for output, msg in zip(outputs, (Observation(push_id=7), PointStamped(), String(data="seen")), strict=True):
        output.publish(msg)
    ros.wait_for(lambda: {"/cell/observation", "/cell/center_of_friction", "/cell/text"} <= set(node._bag.topics))
    ros.wait_for(lambda: node._bag._numbers["/cell/text"] == node._bag._numbers["/cell/observation"] == 1, what="both")
    ros.end(node)
    topics = {topic.name: topic for topic in Bag(tmp_path / "bag").summary.topics}
    # rosidl's file and the middleware agree
    assert topics["/cell/observation"].type_hash == (message_types.type_hash(OBSERVATION) if hashed else "")
    assert [qos.durability for qos in topics["/cell/center_of_friction"].qos_profiles] == [QosDurability.TRANSIENT_LOCAL]
    assert [qos.reliability for qos in topics["/cell/text"].qos_profiles] == [QosReliability.BEST_EFFORT]
    assert [content(message) for message in Bag(tmp_path / "bag").messages(["/cell/text"])] == [String(data="seen")]


def test_under_simulated_time_messages_before_the_first_tick_get_it(ros, outputs, tmp_path):
    node = ros.compose(made(RecorderNode, bag=str(tmp_path / "bag"), topics=TOPICS, use_sim_time=True))
    clock = ros.node("clock").create_publisher(Clock, "/clock", RELIABLE)
    wait_until_matched(ros, [*outputs, clock])
    outputs[2].publish(String(data="early"))
    ros.wait_for(lambda: node._waiting, what="the early message")
    clock.publish(Clock(clock=Time(nanoseconds=5 * SECOND).to_msg()))
    ros.wait_for(lambda: node._bag.message_count == 1, what="the early message in the bag")
    clock.publish(Clock(clock=Time(nanoseconds=6 * SECOND).to_msg()))
    ros.wait_for(lambda: node.get_clock().now().nanoseconds == 6 * SECOND, what="the second tick")
    outputs[2].publish(String(data="late"))
    ros.wait_for(lambda: node._bag.message_count == 2, what="the late message")
    ros.end(node)
    messages = [(m.log_time_ns, content(m).data) for m in Bag(tmp_path / "bag").messages()]
    assert messages == [(5 * SECOND, "early"), (6 * SECOND, "late")]


def test_messages_dropped_by_a_full_queue_are_counted_and_warned_of_once(ros, outputs, tmp_path):
    reports = []
    ros.node("monitor").create_subscription(DiagnosticArray, "/diagnostics", lambda msg: reports.extend(msg.status), RELIABLE)
    node = ros.compose(made(RecorderNode, bag=str(tmp_path / "bag"), topics=TOPICS))
    wait_until_matched(ros, outputs)
    outputs[0].publish(Observation())
    ros.wait_for(lambda: node._bag.message_count == 1, what="the first message")
    busy, go_on = threading.Event(), threading.Event()
    ros.node("stall").create_guard_condition(lambda: (busy.set(), go_on.wait())).trigger()
    assert busy.wait(10)
    for _ in range(QUEUE_DEPTH + 200):
        outputs[0].publish(Observation())
    go_on.set()
    ros.wait_for(lambda: node._bag.message_count == 1 + QUEUE_DEPTH, what="a queue full of messages")
    warning = "messages were lost before they could be recorded: 200 of /cell/observation"
    well = f"{QUEUE_DEPTH + 1} messages recorded"
    ros.wait_for(lambda: reports and reports[-1].message == well, what="a report that all is well")
    assert {report.message: report.level for report in reports}[warning] == Level.WARN.value
    assert [report.message for report in reports].count(warning) == 1
    assert {pair.key: pair.value for pair in reports[-1].values}["lost"] == "200"
    ros.take_out(node)
    with pytest.raises(MessagesLost, match=rf"{warning} \(from 0\.000 s to \d+\.\d+ s\)"):
        node.destroy_node()
    assert Bag(tmp_path / "bag").summary.message_count == 1 + QUEUE_DEPTH


@pytest.mark.parametrize(
    ("qos", "reported", "numbers", "lost"),
    [
        (RELIABLE, 0, (7, 8, 11), 2),  # 9 and 10 are missing; earlier ones were not for this subscription
        (RELIABLE, 0, (1, 2, None, 1), 0),  # a new publisher, a middleware without numbers, another publisher
        (RELIABLE, 3, (1, 3), 3),  # what the middleware reports counts once
        (LATCHED, 3, (1, 70), 0),  # its publisher keeps only the newest message by design
    ],
)
def test_missing_numbers_of_a_single_publisher_are_losses(qos, reported, numbers, lost):
    losses = Losses(qos)
    if reported:
        losses.reported(SimpleNamespace(total_count_change=reported))
    for number in numbers:
        losses.count(number, lambda: 1)
    losses.count(900, lambda: 2)  # of two publishers, whose numbers mix
    assert losses.messages == lost


def test_a_loss_that_nobody_promised_to_prevent_is_said_and_no_fault(ros, tmp_path, capfd):
    node = made(RecorderNode, bag=str(tmp_path / "bag"), topics=TOPICS)
    node._receptions["/cell/text"].losses.reported(SimpleNamespace(total_count_change=3))
    node.destroy_node()
    assert capfd.readouterr().err == (
        f"warning: {tmp_path}/bag: messages were lost before they could be recorded: 3 of /cell/text\n"
    )


def test_what_has_arrived_is_recorded_at_the_end(ros, outputs, tmp_path):
    """A busy recorder may be behind when it is asked to end."""
    node = made(RecorderNode, bag=str(tmp_path / "bag"), topics=TOPICS)  # never spun
    wait_until_matched(ros, outputs)
    for number in range(50):
        outputs[0].publish(Observation(push_id=number))
    assert outputs[0].wait_for_all_acked(Duration(seconds=60))
    node.destroy_node()
    assert [content(message).push_id for message in Bag(tmp_path / "bag").messages()] == list(range(50))


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"topics": TOPICS}, "bag must be given: folder of the bag, new or empty"),
        ({"bag": "bag"}, "topics must name what to record unless discover is true, got none"),
        ({"bag": "bag", "topics": [f"text {STRING} best"]}, r"topics must be 'name .*', got 'text std_msgs/msg/String best'"),
        ({"bag": "bag", "topics": [f"te//xt {STRING} reliable"]}, "parameter topics: 'te//xt' is not a topic"),
        ({"bag": "bag", "topics": ["text std_msgs/msg/Text reliable"]}, "message type 'std_msgs/msg/Text' is not installed"),
    ],
)
def test_the_recorder_refuses_wrong_parameters(ros, tmp_path, monkeypatch, values, expected):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InvalidInput, match=expected):
        made(RecorderNode, **values)
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("published", [QUEUE_DEPTH // 2, 5 * QUEUE_DEPTH])
def test_a_recorder_that_was_stopped_loses_nothing_or_says_what(ros, outputs, tmp_path, published):
    """SIGSTOP for longer than the recorder's queues last: a reader must not believe that the bag holds all messages."""
    file = tmp_path / "bag/bag_0.mcap"

    def newest() -> int:
        recorded = list(Bag(file).messages()) if file.stat().st_size > 8 else []
        return content(recorded[-1]).push_id if recorded else -1

    with recorder_process(ros, outputs, tmp_path / "bag") as process:
        outputs[0].publish(Observation(push_id=0))
        ros.wait_for(lambda: newest() == 0, what="the flushed chunk")
        process.send_signal(signal.SIGSTOP)
        for number in range(1, published):
            outputs[0].publish(Observation(push_id=number))
        process.send_signal(signal.SIGCONT)
        ros.wait_for(lambda: newest() == published - 1, what="the last message")
        code, errors = ended(process, signal.SIGTERM)
    bag = Bag(tmp_path / "bag")
    assert bag.damage is None
    lost = published - bag.summary.message_count
    if published < QUEUE_DEPTH:
        assert (lost, code, errors) == (0, 0, "")
        return
    assert lost > 0
    said = re.fullmatch(
        rf"error: {tmp_path}/bag: messages were lost before they could be recorded: "
        r"(\d+) of /cell/observation \(from (\S+) s to (\S+) s\)\n",
        errors,
    )
    assert (code, int(said[1])) == (1, lost)
    assert 0 <= float(said[2]) <= float(said[3])


def test_a_bag_that_was_removed_while_recording_ends_the_recorder(ros, outputs, tmp_path):
    with recorder_process(ros, outputs, tmp_path / "bag") as process:
        shutil.rmtree(tmp_path / "bag")
        expected = f"error: {tmp_path}/bag/bag_0.mcap: was removed or moved while it was recorded; the recording ends here\n"
        assert ended(process) == (2, expected)


# --- the player ---


def test_a_bag_that_is_played_and_recorded_again_is_the_same(ros, tmp_path):
    original = make_bag(tmp_path / "first", 90)
    ros.compose(first := made(RecorderNode, bag=str(tmp_path / "second"), topics=TOPICS))
    node = ros.compose(player(bag=str(tmp_path / "first"), wait_for=NAMES, rate=2.0, clock=False))
    ros.wait_for(lambda: node.done and first._bag.message_count == 90, what="the end of the bag")
    ros.end(first)
    again = contents(tmp_path / "second")
    # DDS keeps the order within a topic, not between topics
    assert by_topic(again) == by_topic([(message.topic, message.raw) for message in original])
    assert Bag(tmp_path / "second").summary.topics == Bag(tmp_path / "first").summary.topics


@pytest.mark.parametrize(("count", "period_ms", "rate"), [(30, 10, 1.0), (20, 100, 50.0)])
def test_the_clock_runs_over_the_bag_at_100_hz_of_its_time_and_no_more_than_500_hz(ros, tmp_path, count, period_ms, rate):
    make_bag(tmp_path / "bag", count, period_ns=period_ms * 10**6)
    listener = Listener(ros)
    node = ros.compose(player(bag=str(tmp_path / "bag"), wait_for=["/clock"], rate=rate))
    ros.wait_for(lambda: node.done and len(listener.clock) == count // 2, what="all ticks")
    assert listener.clock == [START + period_ms * 10**6 * number for number in range(count // 2)]


def test_only_the_chosen_topics_are_played(ros, tmp_path):
    make_bag(tmp_path / "bag", 12)
    listener = Listener(ros)
    wanted = ros.compose(player(bag=str(tmp_path / "bag"), topics=["/cell/observation"], wait_for=["observation"]))
    ros.wait_for(lambda: wanted.done and len(listener.heard) == 4, what="four observations")
    assert listener.heard == ["o0", "o3", "o6", "o9"]
    assert wanted.count_publishers("/cell/text") == 0


def test_playing_waits_for_its_subscribers(ros, tmp_path):
    make_bag(tmp_path / "bag", 6)
    played = ros.compose(player(bag=str(tmp_path / "bag"), wait_for=["observation", "text"]))
    early = ros.node("early")
    clock = ros.heard(early, Clock, "/clock", RELIABLE)
    early.create_subscription(Observation, "/cell/observation", lambda msg: None, RELIABLE)
    ros.wait_for(lambda: played._awaited[0].get_subscription_count(), what="the first subscriber")
    assert not played.done
    assert not clock
    early.create_subscription(String, "/cell/text", lambda msg: None, SENSOR_DATA)
    ros.wait_for(lambda: played.done, what="the end of the bag")


def test_a_paused_player_waits_plays_and_holds_again(ros, tmp_path):
    make_bag(tmp_path / "bag", 30)
    listener = Listener(ros)
    node = ros.compose(player(bag=str(tmp_path / "bag"), wait_for=[*NAMES, "/clock"], rate=0.01, paused=True))
    client = listener.node.create_client(SetBool, "/cell/player/pause")
    ros.wait_for(client.service_is_ready, what="the pause service")

    def pause(on: bool) -> str:
        answer = ros.result(client.call_async(SetBool.Request(data=on)), "the answer")
        assert answer.success
        return answer.message

    ros.wait_for(lambda: all(output.get_subscription_count() for output in node._awaited), what="subscribers")
    for _ in range(3):
        assert pause(True) == "paused at 1700000000.000 s"
    assert (listener.heard, listener.clock, node.done) == ([], [], False)
    assert pause(False).startswith("playing at 1700000000.")
    ros.wait_for(lambda: listener.clock, what="the first tick")
    assert pause(True).startswith("paused at 1700000000.")
    held = node._bag_time()
    assert held < START + 140_000_000
    assert not node.done
    assert node._bag_time() == held
    pause(False)
    ros.wait_for(lambda: node._bag_time() > held, what="time running on")


def test_the_player_ends_its_process_when_all_is_acknowledged(ros, tmp_path):
    make_bag(tmp_path / "bag", 30)
    listener = Listener(ros)
    arguments = ["--ros-args", "-r", "__ns:=/cell", "-p", f"bag:={tmp_path / 'bag'}", "-p", f"wait_for:={NAMES}"]
    run = subprocess.run([sys.executable, "-c", PLAYER, *arguments], capture_output=True, timeout=120, check=False)
    assert run.returncode == 0, run.stderr
    assert b"30 messages played" in run.stderr
    ros.wait_for(lambda: {"o27", "p28"} <= set(listener.heard), what="the last messages")


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"bag": ""}, "bag must name the bag to play, got ''"),
        ({"topics": ["nothing"]}, "parameter topics: /cell/nothing is not played from .*, expected one of /cell/observation, "),
        ({"wait_for": ["te//xt"]}, "parameter wait_for: 'te//xt' is not a topic"),
    ],
)
def test_the_player_refuses_wrong_parameters(ros, tmp_path, values, expected):
    make_bag(tmp_path / "bag")
    with pytest.raises(InvalidInput, match=expected):
        player(**{"bag": str(tmp_path / "bag"), **values})


def test_the_player_refuses_an_empty_bag_and_a_changed_definition(ros, tmp_path):
    with BagWriter(tmp_path / "empty") as writer:
        writer.add_topic("/cell/text", STRING, [offered(RELIABLE)])
    with pytest.raises(InvalidInput, match="empty: holds no messages, expected some to play"):
        player(bag=str(tmp_path / "empty"))
    with BagWriter(tmp_path / "old") as writer:
        writer.add_topic("/cell/text", STRING, [offered(RELIABLE)], "RIHS01_of_another_definition")
        writer.write("/cell/text", 1, serialize_message(String()))
    with pytest.raises(InvalidInput, match="/cell/text: was recorded with another definition of std_msgs/msg/String"):
        player(bag=str(tmp_path / "old"))
