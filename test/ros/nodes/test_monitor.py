"""The monitor node with a real publisher of estimates."""

import contextlib
import time
from functools import partial

from pushfric_msgs.msg import FrictionEstimate
from pushfric_ros.node_kit.qos import LATCHED
from pushfric_ros.node_kit.visit import Visit, visit
from pushfric_ros.nodes.monitor import MonitorNode

PATIENCE = 60.0


def spin_until(done, *visits):
    deadline = time.monotonic() + PATIENCE
    while not done():
        assert time.monotonic() < deadline
        for each in visits:
            each.spin_once(0.01)


def test_a_monitor_that_was_held_up_still_sees_every_estimate():
    seen = []
    make = partial(MonitorNode, seen.append, lambda _: None, starts_player=False)
    with contextlib.closing(Visit(make)) as monitor, visit("estimator") as estimator:
        publisher = estimator.node.create_publisher(FrictionEstimate, "friction_estimate", LATCHED)
        spin_until(publisher.get_subscription_count, monitor, estimator)
        spin_until(lambda: monitor.node.count_publishers("friction_estimate"), monitor, estimator)
        for number in range(60):
            publisher.publish(FrictionEstimate(data_points=number))
        spin_until(lambda: seen and seen[-1].data_points == 59, monitor)
    assert [msg.data_points for msg in seen] == list(range(60))
