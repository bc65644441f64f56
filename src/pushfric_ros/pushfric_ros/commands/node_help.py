"""What `NODE_node --help` prints, found by asking the node itself."""

import textwrap
from collections.abc import Iterator

from pushfric_ros.commands.interface_docs import Description, describe, span
from pushfric_ros.commands.markdown import as_yaml

WIDTH = 100  # characters


def print_help(name: str) -> None:
    """Print what a node does, its parameters and its topics."""
    (described,) = describe(name)
    print("\n".join(text(described)))


def text(described: Description) -> Iterator[str]:
    """The lines of the help of a node."""
    name = described.node
    yield f"usage: ros2 run pushfric_ros {name}_node [--ros-args [-p PARAMETER:=VALUE] [--params-file FILE] ...]"
    yield ""
    yield from textwrap.wrap(described.summary, WIDTH)
    yield ""
    yield "parameters, set when the node starts:"
    for setting in described.settings:
        within = span(setting)
        yield f"  {setting.name} ({setting.type}{within and f', {within}'})"
        what = f"{setting.description}; {'required' if setting.required else f'default: {as_yaml(setting.default)}'}"
        yield from textwrap.wrap(what, WIDTH, initial_indent="      ", subsequent_indent="      ")
    yield ""
    yield "topics, services and actions, relative to the node's namespace:"
    for endpoint, when in described.endpoints.items():
        note = f" ({when.replace('`', '')})" if when else ""
        yield f"  {endpoint.role} {endpoint.name}"
        yield f"      {endpoint.type}, {endpoint.qos}{note}"
