"""Signs of life: numbered, from a thread of their own, and dated by when they arrived."""

import time

import pytest

from pushfric_msgs.msg import Heartbeat as HeartbeatMsg
from pushfric_ros.node_kit.heartbeat import PERIOD, TOPIC, Heartbeat, Listener
from pushfric_ros.node_kit.qos import NEWEST_OF_MANY

GOAL = bytes(range(16))


@pytest.fixture
def node(ros):
    return ros.node("tracker", namespace="/alive")


@pytest.fixture
def listener(ros):
    return Listener(ros.node("actuator", namespace="/alive"))


def heard(ros, listener, name="tracker"):
    """The last sign of a node, once there is one."""
    ros.wait_for(lambda: listener.node(name) is not None, what=f"a heartbeat of {name}")
    return listener.node(name)


def test_heartbeats_are_numbered_and_come_while_the_executor_hangs(ros, node, listener):
    life = Heartbeat(node)
    first = heard(ros, listener)
    ros.take_out(node)
    ros.wait_for(lambda: heard(ros, listener).stalled > 5 * PERIOD, what="heartbeats that say it")
    sign = listener.node("tracker")
    assert sign.number > first.number
    assert sign.idle > 5 * PERIOD
    assert f"number {sign.number}, came " in str(sign)
    assert "and said that its executor had hung for" in str(sign)
    ros.compose(node)
    ros.wait_for(lambda: "hung" not in str(listener.node("tracker")), what="an executor that turns")
    life.end()


def test_the_owner_of_a_goal_is_known_by_the_goal(ros, listener):
    life = Heartbeat(ros.node("client", namespace="/alive"))
    assert listener.owner(GOAL) is None
    life.own(GOAL)
    ros.wait_for(lambda: listener.owner(GOAL) is not None, what="the owner")
    life.own(None)
    last = listener.owner(GOAL).number
    ros.wait_for(lambda: heard(ros, listener, "client").number > last + 2, what="more heartbeats")
    assert listener.owner(GOAL).number <= last + 1
    life.end()


def test_a_heartbeat_that_waited_counts_from_its_arrival(ros, node):
    """A busy listener that takes an old heartbeat must not believe that it is new."""
    busy = ros.node("actuator", namespace="/alive")
    listener, life = Listener(busy), Heartbeat(node)
    before = heard(ros, listener).number
    ros.take_out(busy)
    time.sleep(4 * PERIOD)  # some come, and nobody takes them
    life.end()
    ended = time.monotonic()
    time.sleep(4 * PERIOD)
    listener.receive()
    assert listener.node("tracker").number > before
    assert listener.node("tracker").came < ended + 2 * PERIOD
    busy.destroy_node()


def test_the_heartbeats_of_many_nodes_do_not_displace_each_other(ros, node):
    """The queue of a listener that was busy holds the newest of each node."""
    busy = ros.node("actuator", namespace="/alive")
    listener, out = Listener(busy), node.create_publisher(HeartbeatMsg, TOPIC, NEWEST_OF_MANY)
    ros.wait_for(out.get_subscription_count, what="the listener")
    ros.take_out(busy)
    for number in range(1, 11):
        for one in range(8):
            out.publish(HeartbeatMsg(node=f"/alive/node_{one}", number=number))

    def newest() -> set[int]:
        listener.receive()
        return {sign.number for one in range(8) if (sign := listener.node(f"node_{one}")) is not None}

    ros.wait_for(lambda: newest() == {10}, what="the newest heartbeats of all")
    busy.destroy_node()


def test_two_living_nodes_of_one_name_are_noticed_and_a_restart_is_not(ros, node, listener):
    first = Heartbeat(node)
    ros.wait_for(lambda: heard(ros, listener).number > 5, what="heartbeats")
    first.end()
    last = listener.node("tracker").number
    second = Heartbeat(node)
    ros.wait_for(lambda: listener.node("tracker").number < last, what="a node that was started again")
    ros.wait_for(lambda: listener.node("tracker").number > last, what="more heartbeats")
    assert listener.twins == []
    twin = Heartbeat(ros.node("tracker", namespace="/alive"))
    ros.wait_for(lambda: listener.twins == ["/alive/tracker"], what="the twin")
    twin.end()
    ros.wait_for(lambda: listener.twins == [], what="the end of the twin")
    second.end()


def test_a_destroyed_node_shows_no_more_signs_and_leaves_no_thread(ros, node, capfd):
    life = Heartbeat(node)
    ros.take_out(node)
    node.destroy_node()
    life._thread.join(10.0)
    assert not life._thread.is_alive()
    assert capfd.readouterr().err == ""
