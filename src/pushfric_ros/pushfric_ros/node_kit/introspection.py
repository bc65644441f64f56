"""The endpoints and parameters of a node, found by asking the node itself."""

import importlib
import time
from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.action import get_action_client_names_and_types_by_node, get_action_server_names_and_types_by_node
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from pushfric_ros.node_kit.network import apart
from pushfric_ros.node_kit.parameters import REQUIRED, overrides
from pushfric_ros.node_kit.transforms import TYPE as TRANSFORMS
from pushfric_ros.node_kit.transforms import TransformBroadcaster
from pushfric_ros.node_kit.visit import Visit

GRAPH_PATIENCE = 120.0
"""How long the middleware may take to know all of a node of this process [s]."""

UNKNOWN = "topic"
"""The quality of a topic that rclpy does not know, such as /rosout."""

ROLES = ("publishes", "subscribes", "serves", "calls")


class Endpoint(NamedTuple):
    """A topic, service or action of a node."""

    role: str  # one of ROLES
    name: str
    type: str
    qos: str


class Setting(NamedTuple):
    """A parameter of a node."""

    name: str
    required: bool
    default: Any  # None if it is required
    description: str


class NodeInterface(NamedTuple):
    """The answer of a node."""

    name: str
    endpoints: list[Endpoint]  # names relative to the namespace, with ~ for the node
    settings: list[Setting]


def node_class(name: str) -> Any:
    """The class of a node of pushfric_ros; its module is loaded only now."""
    module = importlib.import_module(f"pushfric_ros.nodes.{name}")
    return getattr(module, "".join(word.capitalize() for word in f"{name}_node".split("_")))


class Introspection:
    """Starts nodes one at a time, apart from all others, and asks them; what every node has is left out.

    The middleware knows nodes by name. A cell may be running, whose nodes have the same names.

    Args:
        namespace: of the nodes.
    Attributes:
        every_node: what every node has, including what only the middleware knows of, such as /rosout.
    """

    def __init__(self, namespace: str) -> None:
        self._namespace = namespace
        set_logger_level("", LoggingSeverity.WARN)  # nodes that are only asked have nothing to log
        with apart(), Visit(partial(Node, "plain", namespace=namespace)) as plain:
            self.every_node = _endpoints(plain.node, namespace)
            self._common_parameters = plain.node.get_parameters_by_prefix("").keys()

    def ask(self, kind: type[Node], parameters: Mapping[str, Any]) -> NodeInterface:
        """Start a node of this class with these parameters, and ask it."""
        given = overrides(parameters)
        with apart(), Visit(partial(_remembering(kind), namespace=self._namespace, parameter_overrides=given)) as visit:
            node = visit.node
            settings = [
                _setting(name, default, node.describe_parameter(name))
                for name, default in node.defaults.items()
                if name not in self._common_parameters
            ]
            # what only the middleware knows of has no quality
            own = [one for one in _endpoints(node, self._namespace) if one not in self.every_node and one.qos != UNKNOWN]
            return NodeInterface(node.get_name(), own, settings)


def _remembering(kind: type[Node]) -> Any:
    """The same node, but it keeps in `defaults` what each parameter is by default."""

    class Remembering(kind):  # type: ignore[misc, valid-type]
        defaults: dict[str, Any] = {}  # noqa: RUF012 - each class has one instance

        def declare_parameter(self, name: str, value: Any = None, *rest: Any) -> Parameter:
            self.defaults[name] = value
            return super().declare_parameter(name, value, *rest)

    return Remembering


def _endpoints(node: Node, namespace: str) -> list[Endpoint]:
    """All that a node has, once the middleware's graph knows it.

    Raises:
        TimeoutError: the graph is not complete within GRAPH_PATIENCE.
    """
    here = node.get_name(), node.get_namespace()
    published = {out.topic_name: _qos(out.qos_profile) for out in node.publishers}
    subscribed = {into.topic_name: _qos(into.qos_profile) for into in node.subscriptions}
    services = {node.resolve_service_name(one.srv_name): "service" for one in node.services}
    clients = {node.resolve_service_name(one.srv_name): "service" for one in node.clients}
    asked = [  # role, kind, what rclpy knows, with its quality, and what asks the middleware
        ("publishes", UNKNOWN, published, node.get_publisher_names_and_types_by_node),
        ("subscribes", UNKNOWN, subscribed, node.get_subscriber_names_and_types_by_node),
        ("serves", "service", services, node.get_service_names_and_types_by_node),
        ("calls", "service", clients, node.get_client_names_and_types_by_node),
        ("serves", "action", {}, partial(get_action_server_names_and_types_by_node, node)),
        ("calls", "action", {}, partial(get_action_client_names_and_types_by_node, node)),
    ]
    # the middleware's graph alone knows of actions, and it must know everything else
    deadline = time.monotonic() + GRAPH_PATIENCE
    while not all(known.keys() <= dict(find(*here)).keys() for _, _, known, find in asked):
        if time.monotonic() > deadline:
            raise TimeoutError(f"{here[0]} is not in the middleware's graph within {GRAPH_PATIENCE:g} s")
        time.sleep(0.01)
    made = [
        Endpoint(role, name, types[0], known.get(name, kind))
        for role, kind, known, find in asked
        for name, types in find(*here)
        if types[0] != TRANSFORMS and "/_action/" not in name
    ]
    # also if tf2_msgs, and so the publisher, is missing
    broadcasters = [value for value in vars(node).values() if isinstance(value, TransformBroadcaster)]
    made += [Endpoint("publishes", one.topic, TRANSFORMS, _qos(one.qos)) for one in broadcasters]
    for name, (kind, quality, _) in getattr(node, "at_times", {}).items():
        package, folder, *_ = kind.__module__.split(".")
        made.append(Endpoint("subscribes", node.resolve_topic_name(name), f"{package}/{folder}/{kind.__name__}", _qos(quality)))
    return [endpoint._replace(name=_relative(endpoint.name, namespace, here[0])) for endpoint in made]


def _relative(name: str, namespace: str, node: str) -> str:
    """The name without the cell's namespace, and with ~ for the node, so that nodes can be compared."""
    name = name.removeprefix(f"{namespace}/")
    return f"~/{name.removeprefix(f'{node}/')}" if name.startswith(f"{node}/") else name


def _qos(qos: QoSProfile) -> str:
    words = ["reliable" if qos.reliability == ReliabilityPolicy.RELIABLE else "best effort"]
    words += ["transient local"] * (qos.durability == DurabilityPolicy.TRANSIENT_LOCAL)
    return ", ".join([*words, f"depth {qos.depth}"])


def _setting(name: str, default: Any, descriptor: ParameterDescriptor) -> Setting:
    required = descriptor.additional_constraints.startswith(REQUIRED)
    # a list without entries is declared by its type alone
    value = None if required else [] if default is None else [*default] if isinstance(default, tuple) else default
    return Setting(name, required, value, descriptor.description)
