"""What a node's diagnostics say about the messages on its topics."""

from types import SimpleNamespace

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, PointStamped

from pushfric_ros.messages.conversions import stamp_to_msg
from pushfric_ros.node_kit import diagnostics
from pushfric_ros.node_kit.diagnostics import Diagnostics, Health, Level
from pushfric_ros.node_kit.qos import RELIABLE


@pytest.fixture
def node(ros):
    return ros.node("watched", namespace="/cell")


@pytest.fixture
def watched(node, monkeypatch):
    """Diagnostics for which the time is now 10.0 s, and which report only when a test makes them."""
    monkeypatch.setattr(diagnostics.time, "monotonic", lambda: 10.0)
    monkeypatch.setattr(diagnostics, "FIRST", 3600.0)
    made = Diagnostics(node, lambda: Health(Level.WARN, "so so", {"object": "brick"}))
    monkeypatch.undo()
    return made


def reported(ros, watched, monkeypatch, now):
    """The values of a report made at this time [s]."""
    statuses: list[DiagnosticStatus] = []
    monkeypatch.setattr(watched._publisher, "publish", lambda msg: statuses.extend(msg.status))
    monkeypatch.setattr(diagnostics.time, "monotonic", lambda: now)
    watched.publish()
    monkeypatch.undo()
    return {value.key: value.value for value in statuses[0].values}


def test_rates_and_latency_count_from_the_last_report(ros, node, watched, monkeypatch):
    got = []
    watched.subscribe(PointStamped, "points", got.append, RELIABLE)
    watched.subscribe(Point, "bare", got.append, RELIABLE)
    out = watched.advertise(Point, "bare", RELIABLE)
    points = node.create_publisher(PointStamped, "points", RELIABLE)
    ros.wait_for(lambda: points.get_subscription_count() and out.get_subscription_count(), what="the subscriptions")
    msg = PointStamped()
    msg.header.stamp = stamp_to_msg(node.get_clock().now().nanoseconds - 5 * 10**9)
    for _ in range(6):
        points.publish(msg)
    out.publish(Point())
    ros.wait_for(lambda: len(got) == 7, what="all messages")
    values = reported(ros, watched, monkeypatch, 12.0)
    assert values.pop("points latency [s]").startswith("5.")
    assert values == {
        "object": "brick",
        "points received [1/s]": "3.0",
        "points lost": "0",
        "bare received [1/s]": "0.5",
        "bare lost": "0",
        "bare sent [1/s]": "0.5",
    }
    assert reported(ros, watched, monkeypatch, 13.0)["points received [1/s]"] == "0.0"


def test_lost_messages_are_counted(ros, watched, monkeypatch):
    subscription = watched.subscribe(Point, "points", lambda _: None, RELIABLE)
    (handler,) = (handler for handler in subscription.event_handlers if handler.callback.__name__ == "reported")
    for count in (2, 3):
        handler.callback(SimpleNamespace(total_count_change=count))
    assert reported(ros, watched, monkeypatch, 11.0)["points lost"] == "5"
