"""The nodes of a graph in this process, instead of one process each: for tests, and for who wants to debug them together."""

import importlib
from collections.abc import Sequence
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter

from pushfric_ros.graph.graph import PACKAGE, NodeSpec


def compose(specs: Sequence[NodeSpec], namespace: str, **kwargs: Any) -> list[Node]:
    """Make the nodes of a graph; the caller spins and destroys them.

    Args:
        specs: the nodes.
        namespace: of all of them.
        kwargs: for rclpy's Node, such as a context.
    Raises:
        InvalidInput: a node refuses its parameters; those made before are destroyed.
    """
    nodes: list[Node] = []
    try:
        for spec in specs:
            module = importlib.import_module(f"{PACKAGE}.nodes.{spec.name}")
            node_class = getattr(module, "".join(word.capitalize() for word in spec.executable.split("_")))
            overrides = [Parameter(name, value=value) for name, value in spec.parameters.items()]
            remaps = [part for name, other in spec.remappings.items() for part in ("-r", f"{name}:={other}")]
            arguments = ["--ros-args", *remaps] if remaps else None
            nodes.append(node_class(namespace=namespace, parameter_overrides=overrides, cli_args=arguments, **kwargs))
    except BaseException:
        for node in nodes:
            node.destroy_node()
        raise
    return nodes
