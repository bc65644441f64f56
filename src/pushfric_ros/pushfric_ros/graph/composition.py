"""The nodes of a graph in this process, instead of one process each: for tests, and for debugging them together."""

import importlib
from collections.abc import Sequence
from typing import Any

from pushfric_ros.graph.graph import PACKAGE, NodeSpec
from pushfric_ros.node_kit.parameters import overrides


def node_class(name: str) -> Any:
    """The class of a node; its module is loaded only now."""
    module = importlib.import_module(f"{PACKAGE}.nodes.{name}")
    return getattr(module, "".join(word.capitalize() for word in f"{name}_node".split("_")))


def compose(specs: Sequence[NodeSpec], namespace: str, **kwargs: Any) -> list[Any]:
    """Make the nodes of a graph; the caller spins and destroys them.

    Args:
        specs: the nodes.
        namespace: of all of them.
        kwargs: for every node, such as a context.
    Raises:
        InvalidInput: a node refuses its parameters; the nodes made before are destroyed.
    """
    nodes: list[Any] = []
    try:
        for spec in specs:
            remaps = [part for name, other in spec.remappings.items() for part in ("-r", f"{name}:={other}")]
            arguments = ["--ros-args", *remaps] if remaps else None
            given = overrides(spec.parameters)
            nodes.append(node_class(spec.name)(namespace=namespace, parameter_overrides=given, cli_args=arguments, **kwargs))
    except BaseException:
        for node in nodes:
            node.destroy_node()
        raise
    return nodes
