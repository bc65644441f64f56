"""Models that are loaded and saved, and an estimator that dies: nothing is lost, and nothing counts twice."""

import contextlib
import pathlib
import subprocess
import sys
import time
from functools import partial

import numpy as np
import pytest
from composition import made
from geometry_msgs.msg import PoseWithCovarianceStamped
from problems import observations_of
from rclpy.serialization import serialize_message
from semantic_damage import STREAMS, Recording
from std_srvs.srv import Trigger
from test_estimator_node import NAME, pose_msg, push, pusher_msg

from pushfric_core import TABLE_1, Estimator, InvalidInput, Pose, Trajectory
from pushfric_core.bags.bag import Bag
from pushfric_core.bags.bag_writer import BagWriter
from pushfric_core.bags.recorded import POSE_TOPICS, Recorded, beside
from pushfric_core.bags.recovery import recover
from pushfric_core.bags.resumption import Resumption
from pushfric_core.bags.run_record import PLAN
from pushfric_core.bags.samples import pose_sample_from_msg, pusher_sample_from_msg, stamp_from_msg
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.model_file import load_model, make_model, prior, save_model
from pushfric_core.files.object_file import PRIOR_FILE, load_object
from pushfric_core.trajectories.ledger import DoubtCode
from pushfric_msgs.msg import EstimationStart, EstimatorProgress, FrictionEstimate, Observation, PusherState
from pushfric_msgs.srv import SelectObject, SelectPush
from pushfric_ros.graph.graph import TOPICS
from pushfric_ros.messages.conversions import observation_to_msg
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE, SENSOR_DATA
from pushfric_ros.nodes.estimator import EstimatorNode
from pushfric_ros.nodes.recorder import RecorderNode

DEMO = pathlib.Path(__file__).resolve().parents[3] / "bags/rubber_rect4"
START = 10**18
LONG = 240.0
MODEL = load_object(NAME)
DATA = observations_of(TABLE_1[NAME].outline, TABLE_1[NAME].support, 0.5, 9, np.random.default_rng(5))


def kept(path, data):
    """A model file made of some observations."""
    save_model(make_model(MODEL, fitted(data), "a test", EstimatorSettings()), path)
    return str(path)


def seen_in(messages):
    """The observations of a cell's messages, none of which is lost."""
    trajectory = Trajectory(MODEL.outline)
    found = []
    for msg in messages:
        if isinstance(msg, PusherState):
            found += trajectory.add_pusher(pusher_sample_from_msg(msg))
        else:
            found += trajectory.add_pose(pose_sample_from_msg(msg))
    return found


def fitted(data):
    """The last estimate of some observations."""
    return Estimator(MODEL.support_points).add(data)


class Cell:
    """A recorded cell of an estimator, a tracker and a pusher."""

    def __init__(self, ros, bag, **parameters):
        self.ros, self.bag, self.parameters = ros, bag, {"object": NAME, "bag": str(bag), **parameters}
        self.node = ros.node("peer", namespace="/cell")
        recording = {"object": NAME, "topics": [" ".join(topic) for topic in TOPICS], "model": parameters.get("model", "")}
        self.recorder = ros.compose(made(RecorderNode, bag=str(bag), **recording))
        self.told = ros.heard(self.node, Observation, "observation", RELIABLE)
        self.estimates = ros.heard(self.node, FrictionEstimate, "friction_estimate", LATCHED)
        self.poses = ros.publisher(self.node, PoseWithCovarianceStamped, "object_pose", SENSOR_DATA)
        self.states = ros.publisher(self.node, PusherState, "pusher_state", RELIABLE)
        self.progress = ros.heard(self.node, EstimatorProgress, "estimator_progress", LATCHED)
        self.start()
        self.warm_up()

    def warm_up(self):
        """Send messages without a push until the estimator has heard both topics, which a publisher cannot know."""
        for stamp in range(START - 10**12, START, 10**9):
            if any(stamp_from_msg(msg.settled_until) for msg in self.progress):
                return
            self.send([pose_msg(stamp, Pose(0.0, 0.5, 0.0)), pusher_msg(stamp + 1, 0.0, PusherState.NO_PUSH)])
            time.sleep(0.1)
        pytest.fail("the estimator hears nothing")

    def start(self):
        given = [part for name, value in self.parameters.items() for part in ("-p", f"{name}:={value}")]
        command = [sys.executable, "-c", "from pushfric_ros.nodes.estimator import main; main()", "--ros-args"]
        self.estimator = subprocess.Popen([*command, "-r", "__ns:=/cell", *given])
        self.ros.wait_for(
            lambda: (
                self.poses.get_subscription_count() == self.states.get_subscription_count() == 2
                and self.node.count_publishers("observation") == 1
                and self.node.count_subscribers("observation") == 2
            ),
            LONG,
            "the estimator",
        )

    def die(self):
        self.ros.wait_for(lambda: Resumption(self.bag, "/cell", ()).start is not None, LONG, "the start in the bag")
        self.estimator.kill()
        self.estimator.wait()

    def end(self):
        self.estimator.terminate()
        assert self.estimator.wait(LONG) == 0

    def send(self, messages):
        for msg in messages:
            (self.states if isinstance(msg, PusherState) else self.poses).publish(msg)

    def await_data(self, count):
        """Wait for an estimate from this many observations."""
        self.ros.wait_for(lambda: self.estimates and self.estimates[-1].data_points == count, LONG, "the estimate")

    def offline(self):
        """The estimate from the bag as far as it is written, once the bag holds every observation."""

        def found():
            return Recorded(self.bag).read(MODEL, Recorded(self.bag).settings, lambda _: None, partial=True).observations

        count = self.estimates[-1].data_points
        self.ros.wait_for(lambda: len(found()) == count, LONG, "the observations in the bag")
        return fitted(found())


@pytest.fixture
def cell_of(ros, tmp_path):
    """A function that starts a cell, whose processes do not outlive the test."""
    with contextlib.ExitStack() as leaving:

        def start(**parameters):
            cell = Cell(ros, tmp_path / "bag", **parameters)
            leaving.callback(lambda: (cell.estimator.kill(), cell.estimator.wait()))
            return cell

        yield start


def test_an_estimator_that_dies_goes_on_to_the_last_bit(cell_of):
    moment = 41  # message of the second push after which it dies
    pushes = [list(push(push_id, START + push_id * 10**10)) for push_id in range(3)]
    expected = seen_in(pushes[0] + pushes[1] + pushes[2])
    cell = cell_of()
    cell.send(pushes[0])
    cell.await_data(len(seen_in(pushes[0])))
    cell.send(pushes[1][:moment])
    cell.die()
    cell.send(pushes[1][moment : moment + 10])  # nobody but the recorder hears them
    cell.start()
    cell.send(pushes[1][moment + 10 :])
    cell.send(pushes[2])
    cell.await_data(len(expected))
    told = [(msg.push_id, stamp_from_msg(msg.header.stamp)) for msg in cell.told]
    assert len(set(told)) == len(told)
    assert set(told) <= {(point.push_id, point.stamp) for point in expected}
    for estimate in (fitted(expected), cell.offline()):
        assert list(cell.estimates[-1].support_friction.weights) == list(estimate.w)
        assert cell.estimates[-1].objective == estimate.solution.objective


def test_one_that_dies_twice_keeps_what_a_person_chose_and_forgets_what_was_reset(ros, cell_of):
    pushes = [list(push(push_id, START + push_id * 10**10)) for push_id in range(5)]
    counts = np.cumsum([len(seen_in(messages)) for messages in pushes]).tolist()
    cell = cell_of()
    cell.send(pushes[0])
    cell.await_data(counts[0])
    assert ros.call(cell.node, Trigger, "estimator/reset").success
    cell.send(pushes[1] + pushes[2])
    cell.await_data(counts[2] - counts[0])
    assert ros.call(cell.node, SelectPush, "estimator/exclude_push", push_id=1).success
    cell.await_data(counts[2] - counts[1])
    assert ros.call(cell.node, SelectPush, "estimator/keep_push", push_id=2).success
    for push_id in (3, 4):
        cell.die()
        cell.start()
        cell.send(pushes[push_id])
        cell.await_data(counts[push_id] - counts[1])
    ros.wait_for(lambda: Recorded(cell.bag).settings.kept == (2,), LONG, "the kept push in the settings of the last one")
    for expected in (fitted(seen_in(pushes[2] + pushes[3] + pushes[4])), cell.offline()):
        assert list(cell.estimates[-1].support_friction.weights) == list(expected.w)


def test_a_model_is_published_at_once_gone_on_from_and_written(ros, cell_of, tmp_path):
    model, out = kept(tmp_path / "model.yaml", DATA[:5]), tmp_path / "new.yaml"
    pushes = [list(push(push_id, START + push_id * 10**10)) for push_id in range(2)]
    first, both = len(seen_in(pushes[0])), len(seen_in(pushes[0] + pushes[1]))
    cell = cell_of(model=model, save=str(out))
    ros.wait_for(lambda: cell.estimates and cell.estimates[-1].data_points == 5, LONG, "the estimate of the model")
    assert list(cell.estimates[-1].support_friction.weights) == load_model(tmp_path / "model.yaml")[0].w
    assert cell.told == []
    cell.send(pushes[0])
    cell.await_data(5 + first)
    cell.die()
    cell.start()
    cell.send(pushes[1])
    cell.await_data(5 + both)
    assert cell.estimates[-1].pushes == 7
    cell.end()
    expected = cell.offline()
    assert list(cell.estimates[-1].support_friction.weights) == list(expected.w)
    written, _ = load_model(out)
    assert written.w == list(expected.w)
    assert (written.made.data_points, written.made.pushes) == (5 + both, 7)
    assert [point.push_id for point in prior(out, MODEL)[:5]] == [2**31 - 7 + k for k in range(5)]
    recover(tmp_path / "bag", tmp_path / "recovered")
    assert beside(tmp_path / "recovered", PRIOR_FILE) is not None


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"object": "wood_rect3"}, "is a model of rubber_rect4, expected a model of wood_rect3"),
        ({"save": "model.txt"}, "model.txt: expected the name of a file that ends with .yaml or .yml"),
    ],
)
def test_a_model_that_cannot_be_used_is_refused(ros, tmp_path, change, error):
    given = {"object": NAME, "model": kept(tmp_path / "model.yaml", DATA[:3])} | change
    with pytest.raises(InvalidInput, match=error):
        made(EstimatorNode, **given)


def test_a_model_serves_the_object_that_it_is_of(ros, tmp_path):
    path = kept(tmp_path / "model.yaml", DATA[:3])
    before = (tmp_path / "model.yaml").read_bytes()
    node = ros.node("peer", namespace="/cell")
    estimator = ros.compose(made(EstimatorNode, object=NAME, source="observations", model=path, save=path))

    def chosen(name):
        return ros.call(node, SelectObject, "estimator/select_object", object=name).message

    assert chosen(NAME) == f"estimation of {NAME} starts; it goes on from {path}"
    assert chosen("wood_rect3") == f"estimation of wood_rect3 starts; it does not use the model of {NAME}, {path}"
    estimates = ros.heard(node, FrictionEstimate, "friction_estimate", LATCHED)
    ros.publisher(node, Observation, "observation", RELIABLE).publish(observation_to_msg(DATA[3], "wood_rect3"))
    ros.wait_for(lambda: estimates and estimates[-1].data_points == 1, LONG, "an estimate")
    ros.end(estimator)
    assert (tmp_path / "model.yaml").read_bytes() == before  # it is not lost to the other object


STATES = [msg for msg in push(0, START) if isinstance(msg, PusherState)]


def test_the_handover_waits_for_what_the_recorder_has_not_written_yet(tmp_path):
    begins, again = EstimationStart(object=NAME), EstimationStart(object="wood_rect3")
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/cell/pusher_state", "pushfric_msgs/msg/PusherState", [])
        writer.add_topic("/cell/estimation_start", "pushfric_msgs/msg/EstimationStart", [])

        def write(*messages, at=1):
            for msg in messages:
                name = "pusher_state" if isinstance(msg, PusherState) else "estimation_start"
                writer.write(f"/cell/{name}", at, serialize_message(msg))

        assert Resumption(tmp_path / "bag", "/cell", ["pusher_state"]).start is None
        write(begins, *STATES[:5])
        writer.flush()
        resumption = Resumption(tmp_path / "bag", "/cell", ["pusher_state"])
        assert resumption.start.object == NAME
        assert resumption.read_on() is None  # the old estimator's last words may not be written yet
        again.header.stamp.nanosec = 2
        write(*STATES[5:9], again, EstimationStart(continuation=7), at=2)  # the start is recorded late
        writer.flush()
        assert resumption.read_on() is None  # that was the number of another estimator
        write(EstimationStart(continuation=resumption.continuation), at=3)
        writer.flush()
        assert [each.msg.position for each in resumption.read_on()] == [msg.position for msg in STATES[5:9]]
        assert resumption.start.object == "wood_rect3"
        resumption.hold("pusher_state", STATES[11], None)  # 9 and 10 were published before it was subscribed
        resumption.hold("pusher_state", STATES[12], None)
        assert resumption.held is None
        write(*STATES[9:12], at=4)
        assert resumption.read_on() == []  # not flushed
        assert resumption.held is None
        writer.flush()
        assert len(resumption.read_on()) == 3
        assert [held.msg.position for held in resumption.held] == [STATES[12].position]  # the other one is in the bag


def test_nothing_is_chosen_before_it_has_caught_up(ros):
    """What the earlier estimator was told would replace the choice."""
    node = made(EstimatorNode, object=NAME)
    node._resumption = object()
    for choose, kind in ((node._exclude, SelectPush), (node._select_object, SelectObject), (node._reset, Trigger)):
        answer = node._on_choice(choose, kind.Request(), kind.Response())
        assert (answer.success, "still goes on from the bag" in answer.message) == (False, True)
    node.destroy_node()


def as_it_came(messages, afresh=False):
    """The ledger of an estimator to which these messages of a bag come, when they were recorded."""
    node = made(EstimatorNode, object=str(DEMO / "object.yaml"))
    bag = Bag(DEMO)
    if afresh:
        node._start_afresh(node._now.chosen)
    for message in messages:
        name = message.topic.removeprefix("/cell/")
        if name in (*POSE_TOPICS, PLAN):
            node._take_input(name, bag.deserialize(message), message.log_time_ns)
    ledger = node._now.ledger()
    node.destroy_node()
    return ledger


def without_the_first_pushes(recording, without=""):
    begin = recording.span_of(2)[1] + 10**9
    return [one for one in recording.messages if one.log_time_ns > begin and one.topic.rpartition("/")[2] != without]


def with_another_clock(recording):
    return recording.restamped(STREAMS[1], slice(len(recording.numbers(STREAMS[1])) // 2, None), 6 * 10**7)


@pytest.mark.parametrize(
    ("damage", "codes"),
    [
        (lambda recording: recording.messages, set()),
        (
            lambda recording: recording.without_push(5),
            {DoubtCode.PUSHES_MISSING, DoubtCode.NO_OBSERVATIONS, DoubtCode.BOTH_MISSING},
        ),
        (without_the_first_pushes, {DoubtCode.PUSHES_MISSING}),
        (partial(without_the_first_pushes, without=PLAN), {DoubtCode.PUSHES_MISSING}),
        (with_another_clock, {DoubtCode.CLOCKS_STEP, DoubtCode.NO_OBSERVATIONS}),
        (lambda recording: recording.without_push(5, STREAMS[0]), {DoubtCode.POSES_MISSING, DoubtCode.NO_OBSERVATIONS}),
    ],
)
def test_the_live_ledger_has_the_doubts_of_the_bag(ros, tmp_path, damage, codes):
    recording = Recording(DEMO)
    messages = damage(recording)
    live = as_it_came(messages)
    bag = Recorded(recording.write(tmp_path / "bag", messages)).ledger()
    assert {one.code for one in live.doubts} == codes
    # the bag also holds what the run said of itself
    assert set(live.doubts) == {one for one in bag.doubts if one.code is not DoubtCode.RUN_DIFFERS}


@pytest.mark.parametrize("without", ["", PLAN])
def test_an_estimate_that_was_begun_afresh_lacks_nothing(ros, without):
    assert as_it_came(without_the_first_pushes(Recording(DEMO), without), afresh=True).doubts == []
