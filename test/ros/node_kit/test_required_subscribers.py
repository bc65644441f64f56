"""A publisher whose messages must not be missed waits for the nodes that need them, and for no others."""

from geometry_msgs.msg import Point
from rclpy.qos import DurabilityPolicy, QoSProfile

from pushfric_ros.node_kit.qos import RELIABLE
from pushfric_ros.node_kit.required_subscribers import RequiredSubscribers


def test_what_is_published_when_nobody_is_missing_reaches_all(ros):
    node, heard = ros.node("speaker", namespace="/cell"), []
    out = node.create_publisher(Point, "points", RELIABLE)
    required = RequiredSubscribers(node, out, ["late", "early"])
    assert required.missing == ["early", "late"]
    ros.node("early", namespace="/cell").create_subscription(Point, "points", heard.append, RELIABLE)
    ros.node("late", namespace="/elsewhere").create_subscription(Point, "/cell/points", lambda _: None, RELIABLE)
    never_matched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    ros.node("demanding", namespace="/cell").create_subscription(Point, "points", lambda _: None, never_matched)
    ros.wait_for(lambda: node.count_subscribers("points") == 3, what="the other subscribers")
    ros.wait_for(lambda: required.missing == ["late"], what="the subscriber that comes first")
    ros.node("late", namespace="/cell").create_subscription(Point, "points", heard.append, RELIABLE)
    ros.wait_for(lambda: not required.missing, what="the last subscriber")
    out.publish(Point())
    ros.wait_for(lambda: len(heard) == 2, what="the first message at both")


def test_nobody_need_be_waited_for(ros):
    node = ros.node("speaker")
    assert RequiredSubscribers(node, node.create_publisher(Point, "points", RELIABLE), [""]).missing == []
