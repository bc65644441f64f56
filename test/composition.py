"""The nodes of a graph in this process, instead of one process each."""

from collections.abc import Sequence
from typing import Any

from pushfric_ros.graph.graph import NodeSpec
from pushfric_ros.node_kit.introspection import node_class
from pushfric_ros.node_kit.parameters import overrides


def made(kind: Any, namespace: str = "/cell", **parameters: Any) -> Any:
    """A node of this class with these parameters."""
    return kind(namespace=namespace, parameter_overrides=overrides(parameters))


def compose(specs: Sequence[NodeSpec], namespace: str) -> list[Any]:
    """Make the nodes of a graph in a namespace."""
    nodes = []
    for spec in specs:
        remaps = [part for name, other in spec.remappings.items() for part in ("-r", f"{name}:={other}")]
        arguments = ["--ros-args", *remaps] if remaps else None
        given = overrides(spec.parameters)
        nodes.append(node_class(spec.name)(namespace=namespace, parameter_overrides=given, cli_args=arguments))
    return nodes
