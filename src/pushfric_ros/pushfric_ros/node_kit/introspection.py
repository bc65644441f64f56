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
            self._common = {*_endpoints(plain.node, namespace)}
            self.every_node = _every_node(plain.node, namespace)
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
            endpoints = [endpoint for endpoint in _endpoints(node, self._namespace) if endpoint not in self._common]
            return NodeInterface(node.get_name(), endpoints, settings)


def _remembering(kind: type[Node]) -> Any:
    """The same node, but it keeps in `defaults` what each parameter is by default."""

    class Remembering(kind):  # type: ignore[misc, valid-type]
        defaults: dict[str, Any] = {}  # noqa: RUF012 - each class has one instance

        def declare_parameter(self, name: str, value: Any = None, *rest: Any) -> Parameter:
            self.defaults[name] = value
            return super().declare_parameter(name, value, *rest)

    return Remembering


def _endpoints(node: Node, namespace: str) -> list[Endpoint]:
    here = node.get_name(), node.get_namespace()
    topics = [("publishes", out.topic_name, out) for out in node.publishers]
    topics += [("subscribes", into.topic_name, into) for into in node.subscriptions]
    made = [Endpoint(role, name, _type_name(of.msg_type), _qos(of.qos_profile)) for role, name, of in topics]
    # also if tf2_msgs, and so the publisher, is missing
    made = [endpoint for endpoint in made if endpoint.type != TRANSFORMS]
    broadcasters = [value for value in vars(node).values() if isinstance(value, TransformBroadcaster)]
    made += [Endpoint("publishes", one.topic, TRANSFORMS, _qos(one.qos)) for one in broadcasters]
    services = [(node.resolve_service_name(service.srv_name), service.srv_type) for service in node.services]
    made += [Endpoint("serves", name, _type_name(kind), "service") for name, kind in services]
    calls = [(node.resolve_service_name(client.srv_name), client.srv_type) for client in node.clients]
    made += [Endpoint("calls", name, _type_name(kind), "service") for name, kind in calls]
    at_times = getattr(node, "AT_TIMES", {}).items()
    made += [
        Endpoint("subscribes", node.resolve_topic_name(name), _type_name(kind), _qos(qos)) for name, (kind, qos) in at_times
    ]
    _await_graph(node)
    for role, actions in (
        ("serves", get_action_server_names_and_types_by_node(node, *here)),
        ("calls", get_action_client_names_and_types_by_node(node, *here)),
    ):
        made += [Endpoint(role, name, types[0], "action") for name, types in actions]
    return [endpoint._replace(name=_relative(endpoint.name, namespace, here[0])) for endpoint in made]


def _every_node(plain: Node, namespace: str) -> list[Endpoint]:
    here = plain.get_name(), plain.get_namespace()
    found = [
        Endpoint(role, name, types[0], kind)
        for role, kind, pairs in (
            ("publishes", "topic", plain.get_publisher_names_and_types_by_node(*here)),
            ("subscribes", "topic", plain.get_subscriber_names_and_types_by_node(*here)),
            ("serves", "service", plain.get_service_names_and_types_by_node(*here)),
        )
        for name, types in pairs
    ]
    return [endpoint._replace(name=_relative(endpoint.name, namespace, here[0])) for endpoint in found]


def _await_graph(node: Node) -> None:
    """Wait until the middleware's graph, which alone knows of actions, knows everything else that the node has.

    Raises:
        TimeoutError: the graph is not complete within GRAPH_PATIENCE.
    """
    here = node.get_name(), node.get_namespace()
    subscribed = {subscription.topic_name for subscription in node.subscriptions}
    served = {node.resolve_service_name(service.srv_name) for service in node.services}
    deadline = time.monotonic() + GRAPH_PATIENCE
    while not (
        subscribed <= {name for name, _ in node.get_subscriber_names_and_types_by_node(*here)}
        and served <= {name for name, _ in node.get_service_names_and_types_by_node(*here)}
    ):
        if time.monotonic() > deadline:
            raise TimeoutError(f"{here[0]} is not in the middleware's graph within {GRAPH_PATIENCE:g} s")
        time.sleep(0.01)


def _relative(name: str, namespace: str, node: str) -> str:
    """The name without the cell's namespace, and with ~ for the node, so that nodes can be compared."""
    name = name.removeprefix(f"{namespace}/")
    return f"~/{name.removeprefix(f'{node}/')}" if name.startswith(f"{node}/") else name


def _type_name(kind: type) -> str:
    package, folder, *_ = kind.__module__.split(".")
    return f"{package}/{folder}/{kind.__name__}"


def _qos(qos: QoSProfile) -> str:
    words = ["reliable" if qos.reliability == ReliabilityPolicy.RELIABLE else "best effort"]
    words += ["transient local"] * (qos.durability == DurabilityPolicy.TRANSIENT_LOCAL)
    return ", ".join([*words, f"depth {qos.depth}"])


def _setting(name: str, default: Any, descriptor: ParameterDescriptor) -> Setting:
    required = descriptor.additional_constraints.startswith(REQUIRED)
    # a list without entries is declared by its type alone
    value = None if required else [] if default is None else [*default] if isinstance(default, tuple) else default
    return Setting(name, required, value, descriptor.description)
