"""The monitor node with a real publisher of estimates."""

from functools import partial

from pushfric_msgs.msg import FrictionEstimate
from pushfric_ros.node_kit.qos import LATCHED
from pushfric_ros.node_kit.visit import Visit, visit
from pushfric_ros.nodes.monitor import MonitorNode

PATIENCE = 60.0


def test_a_monitor_that_was_held_up_still_sees_every_estimate():
    seen = []
    make = partial(MonitorNode, seen.append, lambda _: None, starts_player=False)
    with Visit(make) as monitor, visit("estimator") as estimator:
        publisher = estimator.node.create_publisher(FrictionEstimate, "friction_estimate", LATCHED)
        assert monitor.spin_until(publisher.get_subscription_count, PATIENCE)
        assert monitor.spin_until(lambda: monitor.node.count_publishers("friction_estimate"), PATIENCE)
        for number in range(60):
            publisher.publish(FrictionEstimate(data_points=number))
        assert monitor.spin_until(lambda: seen and seen[-1].data_points == 59, PATIENCE)
    assert [msg.data_points for msg in seen] == list(range(60))
