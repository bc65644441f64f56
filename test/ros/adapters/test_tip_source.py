"""A tip source that is started again numbers its pushes on from the run's bag."""

import pytest
from composition import made
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from rclpy.serialization import serialize_message

from pushfric_core.bags.bag_writer import BagWriter
from pushfric_core.bags.resumption import PushCount
from pushfric_core.geometry.table_1 import TABLE_1
from pushfric_msgs.msg import PusherState
from pushfric_ros.messages.conversions import stamp_to_msg
from pushfric_ros.node_kit.qos import RELIABLE, SENSOR_DATA, SENSOR_QUEUE
from pushfric_ros.nodes.tip_source import TipSourceNode

NAME = "wood_rect3"
BELOW = -TABLE_1[NAME].outline.size[1] / 2


def state(stamp, push_id):
    msg = PusherState(push_id=push_id)
    msg.header.stamp = stamp_to_msg(stamp * 10**9)
    return msg


class Bag:
    """A bag that is being recorded."""

    def __init__(self, writer):
        self.path, self._writer = writer.folder, writer
        writer.add_topic("/cell/pusher_state", "pushfric_msgs/msg/PusherState", [])

    def write(self, *states):
        for number, msg in enumerate(states):
            self._writer.write("/cell/pusher_state", number, serialize_message(msg))
        self._writer.flush()


@pytest.fixture
def bag(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        yield Bag(writer)


def test_the_pushes_of_a_growing_bag_are_counted(bag):
    count = PushCount(bag.path, "/cell")
    assert (count.pushes, count.newest) == (0, None)
    bag.write(state(5, PusherState.NO_PUSH))
    count.read_on()
    assert (count.pushes, count.newest) == (0, 5 * 10**9)
    bag.write(state(6, 0), state(7, 3), state(8, PusherState.NO_PUSH))
    count.read_on()
    assert (count.pushes, count.newest) == (4, 8 * 10**9)
    assert PushCount(bag.path, "/left").newest is None


def test_a_tip_that_is_followed_again_goes_on_with_the_next_push(ros, bag):
    bag.write(state(1, 0), state(2, 1), state(3, PusherState.NO_PUSH))
    node = ros.node("robot", namespace="/cell")
    states = ros.heard(node, PusherState, "pusher_state", RELIABLE)
    tips = node.create_publisher(PoseStamped, "tip", SENSOR_DATA)
    poses = node.create_publisher(PoseWithCovarianceStamped, "object_pose", SENSOR_QUEUE)
    given = {"object": NAME, "topic": "tip", "tip_radius": 0.003, "bag": str(bag.path)}
    ros.compose(made(TipSourceNode, **given))
    ros.wait_for(lambda: tips.get_subscription_count() and poses.get_subscription_count(), what="the node")
    seconds = [10]

    def show(y):
        """Show the tip, again and again, below the middle of the object."""
        seconds[0] += 1
        pose = PoseWithCovarianceStamped()
        pose.header.frame_id = "table"
        pose.pose.pose.orientation.w = 1.0
        tip = PoseStamped()
        tip.pose.orientation.w, tip.pose.position.y = 1.0, BELOW + y
        for msg in (pose, tip):
            msg.header.stamp.sec = seconds[0]
        poses.publish(pose)
        tips.publish(tip)

    ros.wait_for(lambda: show(-0.003) or len(states) >= 3, what="states")
    assert {msg.push_id for msg in states} == {PusherState.NO_PUSH}  # the last push of the other may not be written yet
    bag.write(state(4, 2), states[0])
    ros.wait_for(lambda: show(-0.003) or states[-1].push_id != PusherState.NO_PUSH, what="a push")
    ros.wait_for(lambda: show(-0.1) or states[-1].push_id == PusherState.NO_PUSH, what="the end of the push")
    ros.wait_for(lambda: show(-0.003) or states[-1].push_id == 4, what="the next push")
    assert {msg.push_id for msg in states} == {PusherState.NO_PUSH, 3, 4}
    seconds[0] = 1  # the clock is set back
    ros.wait_for(lambda: show(-0.003) or states[-1].header.stamp.sec < 10, what="a state after it")
