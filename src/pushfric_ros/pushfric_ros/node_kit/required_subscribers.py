"""The nodes that must be connected to a publisher before it publishes its first message."""

from collections.abc import Iterable

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible

from pushfric_ros.node_kit.qos import deepened


class RequiredSubscribers:
    """The nodes that must not miss a message of a reliable publisher.

    A subscriber gets everything that is published after the publisher was matched with it. A node that is started again knows
    none of its subscribers at first, and finds them one after the other. If it did not wait, the bag would hold messages that
    the estimate lacks.

    Args:
        publisher: of the node.
        names: of the subscribing nodes, relative to the namespace of the node.
    """

    def __init__(self, node: Node, publisher: Publisher, names: Iterable[str]) -> None:
        self._node, self._publisher = node, publisher
        self._missing = {name for name in names if name}

    @property
    def missing(self) -> list[str]:
        """The names of the nodes that do not receive yet; once it is empty, messages reach all of them."""
        if self._missing:
            here, offered = self._node.get_namespace(), self._publisher.qos_profile
            found = [
                subscription
                for subscription in self._node.get_subscriptions_info_by_topic(self._publisher.topic_name)
                if _match(offered, subscription.qos_profile)
            ]
            # a subscription is known to the graph a moment before it is matched
            if self._publisher.get_subscription_count() >= len(found):
                self._missing -= {one.node_name for one in found if one.node_namespace == here}
        return sorted(self._missing)


def _match(offered: QoSProfile, requested: QoSProfile) -> bool:
    """Whether a publisher and a subscription are compatible; deadlines and the like are not used here."""
    ours, theirs = (deepened(profile, 1) for profile in (offered, requested))
    return qos_check_compatible(ours, theirs)[0] != QoSCompatibility.ERROR
