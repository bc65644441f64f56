"""Writes docs/interfaces.md: what every node offers and asks for, told by the nodes themselves."""

import inspect
import pathlib
import tempfile
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
import rclpy
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.action import get_action_client_names_and_types_by_node, get_action_server_names_and_types_by_node
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from std_msgs.msg import Empty

from pushfric_core import settings
from pushfric_core.settings import AUTO
from pushfric_ros.bags.bag_writer import BagWriter
from pushfric_ros.bags.offered_qos import OfferedQos
from pushfric_ros.commands.demo import demo_cell
from pushfric_ros.commands.markdown import table
from pushfric_ros.graph.graph import NAMESPACE
from pushfric_ros.messages.qos import RELIABLE
from pushfric_ros.node_kit.parameters import REQUIRED
from pushfric_ros.nodes.actuator import ActuatorNode
from pushfric_ros.nodes.estimator import EstimatorNode
from pushfric_ros.nodes.experiment import ExperimentNode
from pushfric_ros.nodes.player import PlayerNode
from pushfric_ros.nodes.recorder import RecorderNode
from pushfric_ros.nodes.simulated_cell import SimulatedCellNode
from pushfric_ros.nodes.tracker import TrackerNode

COMMAND = "python -m pushfric_ros.commands.interface_docs > docs/interfaces.md"

HEAD = f"""\
# Interfaces of every node

Written by `{COMMAND}`; do not edit. [graph.md](graph.md) says what it is all for.

Names are relative to the cell's namespace, `{NAMESPACE}` by default. All parameters are read-only: they are set when a node
starts, and one that is *required* has no default. Left out is what every ROS 2 node has (`use_sim_time`, `/parameter_events`,
`/rosout`, the parameter services; of a managed node `transition_event`), and the topics of the bag: the player publishes them,
the recorder subscribes to those it is told of. The fields of all types of `pushfric_msgs` stand in
[its files](../src/pushfric_msgs).
"""

OF_THE_BAG = "std_msgs/msg/Empty"
"""Type of a topic that only the bag has."""

LARGEST = 2**62
"""Integer ranges end here where they have no end."""


class Start(NamedTuple):
    """How a node is started."""

    kind: type[Node]
    required: dict[str, Any]  # parameters
    variants: dict[str, dict[str, Any]]  # parameters with which it has other topics, by how they are written


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
    type: str
    default: str
    range: str
    description: str


class Description(NamedTuple):
    """What a node has."""

    node: str
    summary: str
    endpoints: dict[Endpoint, str]  # and when it has it; empty: always
    settings: list[Setting]


def document() -> str:
    """The text of docs/interfaces.md."""
    return "\n".join((HEAD, *map(section, describe())))


def describe() -> list[Description]:
    """Start every node in each variant, in a context of its own, and ask it."""
    context = rclpy.Context()
    rclpy.init(context=context, args=[])
    try:
        with tempfile.TemporaryDirectory(prefix="pushfric-interfaces-") as folder:
            return [_describe(start, context) for start in _starts(pathlib.Path(folder))]
    finally:
        rclpy.try_shutdown(context=context)


def _starts(folder: pathlib.Path) -> Iterator[Start]:
    name = "rubber_rect4"
    cell = demo_cell(name, folder)
    camera = {"calibration": cell.camera.calibration}
    picture, bag = folder / "picture.png", folder / "bag"
    cv2.imwrite(str(picture), np.zeros((480, 640), np.uint8))
    with BagWriter(bag) as writer:
        writer.add_topic(f"{NAMESPACE}/anything", OF_THE_BAG, [OfferedQos.of(RELIABLE)])
        writer.write(f"{NAMESPACE}/anything", 1, serialize_message(Empty()))
    sources: dict[str, dict[str, Any]] = {
        "`source: compressed`": {"source": "compressed"},
        "a device as `source`": {"source": f"{folder}/*.png"},
    }
    kinds: dict[str, dict[str, Any]] = {
        "`force` or `force_angle` in `terms`": {"terms": ["moment", "force"]},
        "`source: observations`": {"source": "observations"},
    }
    pusher, stage = settings.merged((cell.pusher, cell.driver)), settings.plain(cell.pusher.stage)
    yield Start(TrackerNode, {"object": name, **camera, "source": "topic"}, sources)
    yield Start(ActuatorNode, pusher, {})
    yield Start(EstimatorNode, {"object": name}, kinds)
    yield Start(ExperimentNode, {"object": name}, {})
    yield Start(RecorderNode, {"bag": str(folder / "new"), "discover": True}, {})
    yield Start(PlayerNode, {"bag": str(bag)}, {})
    yield Start(SimulatedCellNode, {"object": name, "port_link": pusher["port"], **camera, **stage}, {})


def _describe(start: Start, context: rclpy.Context) -> Description:
    plain = Node("plain", namespace=NAMESPACE, context=context)
    common, common_parameters = set(_endpoints(plain)), plain.get_parameters_by_prefix("")
    plain.destroy_node()
    found: dict[str, list[Endpoint]] = {}
    for label, parameters in {"": {}, **start.variants}.items():
        overrides = [Parameter(name, value=value) for name, value in (start.required | parameters).items()]
        node = _remembering(start.kind)(namespace=NAMESPACE, parameter_overrides=overrides, context=context)
        try:
            found[label] = [endpoint for endpoint in _endpoints(node) if endpoint not in common and endpoint.type != OF_THE_BAG]
            name = node.get_name()
            if not label:
                declared = [
                    _setting(node.get_parameter(parameter), default, node.describe_parameter(parameter))
                    for parameter, default in node.defaults.items()
                    if parameter not in common_parameters and not parameter.startswith("qos_overrides.")  # of topics of the bag
                ]
        finally:
            node.destroy_node()
    all_found = sorted(
        {endpoint for label in found for endpoint in found[label]}, key=lambda found: (ROLES.index(found.role), found)
    )
    endpoints = {endpoint._replace(name=endpoint.name.replace("~", name)): _when(endpoint, found) for endpoint in all_found}
    return Description(name, " ".join((inspect.getdoc(start.kind) or "").split()), endpoints, declared)


def _remembering(kind: type[Node]) -> type[Node]:
    """The same node, but it keeps in `defaults` what each parameter is by default."""

    class Remembering(kind):  # type: ignore[misc, valid-type]
        defaults: dict[str, Any] = {}  # noqa: RUF012 - each class has one instance

        def declare_parameter(self, name: str, value: Any = None, *rest: Any) -> Parameter:
            self.defaults[name] = value
            return super().declare_parameter(name, value, *rest)

    return Remembering


def _endpoints(node: Node) -> list[Endpoint]:
    here = node.get_name(), node.get_namespace()
    topics = [("publishes", out.topic_name, out) for out in node.publishers]
    topics += [("subscribes", into.topic_name, into) for into in node.subscriptions]
    made = [Endpoint(role, name, _type_name(of.msg_type), _qos(of.qos_profile)) for role, name, of in topics]
    services = [(node.resolve_service_name(service.srv_name), service.srv_type) for service in node.services]
    made += [Endpoint("serves", name, _type_name(kind), "service") for name, kind in services]
    for role, actions in (
        ("serves", get_action_server_names_and_types_by_node(node, *here)),
        ("calls", get_action_client_names_and_types_by_node(node, *here)),
    ):
        made += [Endpoint(role, name, types[0], "action") for name, types in actions]
    return [endpoint._replace(name=_relative(endpoint.name, here[0])) for endpoint in made]


def _relative(name: str, node: str) -> str:
    """Without the cell's namespace, and with ~ for the node, so that nodes can be compared."""
    name = name.removeprefix(f"{NAMESPACE}/")
    return f"~/{name.removeprefix(f'{node}/')}" if name.startswith(f"{node}/") else name


def _type_name(kind: type) -> str:
    package, folder, *_ = kind.__module__.split(".")
    return f"{package}/{folder}/{kind.__name__}"


def _qos(qos: QoSProfile) -> str:
    words = ["reliable" if qos.reliability == ReliabilityPolicy.RELIABLE else "best effort"]
    words += ["transient local"] * (qos.durability == DurabilityPolicy.TRANSIENT_LOCAL)
    return ", ".join([*words, f"depth {qos.depth}"])


def _when(endpoint: Endpoint, found: dict[str, list[Endpoint]]) -> str:
    having = [label for label in found if endpoint in found[label]]
    if "" not in having:
        return f"with {', '.join(having)}"
    lacking = [label for label in found if label not in having]
    return f"not with {', '.join(lacking)}" if lacking else ""


def _setting(parameter: Parameter, default: Any, descriptor: ParameterDescriptor) -> Setting:
    required = descriptor.additional_constraints.startswith(REQUIRED)
    kind = parameter.type_.name.lower().replace("_array", "[]")
    if default == AUTO and descriptor.dynamic_typing:
        kind = "double or string"
    shown = "*required*" if required else f"`{_shown(default)}`"
    spans = [*descriptor.integer_range, *descriptor.floating_point_range]
    limits = ", ".join(f"{_end(span.from_value)} to {_end(span.to_value)}" for span in spans)
    return Setting(parameter.name, kind, shown, limits, descriptor.description)


def _shown(value: Any) -> str:
    if value is None:
        return "[]"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"[{', '.join(map(_shown, value))}]"
    return str(value).lower() if isinstance(value, bool) else repr(value).replace("'", '"')


def _end(value: float) -> str:
    if abs(value) >= LARGEST:
        return "any"
    return str(value) if isinstance(value, int) else f"{value:g}"


def section(described: Description) -> str:
    """The part of the document about one node."""
    rows = [(*endpoint, when) for endpoint, when in described.endpoints.items()]
    topics = [(role, f"`{name}`", kind, qos, when) for role, name, kind, qos, when in rows]
    settings = [(f"`{setting.name}`", *setting[1:]) for setting in described.settings]
    return "\n".join(
        (
            f"## {described.node}\n\n{described.summary}\n",
            table(("", "name", "type", "QoS", "when"), topics),
            table(("parameter", "type", "default", "range", "what"), settings),
        )
    )


if __name__ == "__main__":
    print(document(), end="")
