"""Writes docs/interfaces.md: what every node offers and needs, found by asking the nodes themselves."""

import inspect
import pathlib
import tempfile
import textwrap
from collections.abc import Iterator
from typing import Any, NamedTuple

import cv2
import numpy as np

from pushfric_core import settings
from pushfric_core.bags.bag_writer import BagWriter
from pushfric_core.vision.sighting import UNMEASURED
from pushfric_ros.commands import cell_docs
from pushfric_ros.commands.demo import demo_cell
from pushfric_ros.commands.markdown import as_yaml, limits, table
from pushfric_ros.graph.composition import node_class
from pushfric_ros.graph.graph import NAMESPACE
from pushfric_ros.messages.types import definition, type_hash
from pushfric_ros.node_kit.introspection import ROLES, Endpoint, Introspection, Setting
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE

COMMAND = "python -m pushfric_ros.commands.interface_docs > docs/interfaces.md"

HEAD = f"""\
# Interfaces of every node

Written by `{COMMAND}`; do not edit.
[graph.md](graph.md) explains the nodes and topics.

Names are relative to the cell's namespace, `{NAMESPACE}` by default. All parameters are read-only, set when a node starts; a
*required* one has no default. [cell.md](cell.md#all-keys) describes the keys of a cell's file. Every node publishes
`/diagnostics`. The lists leave out what every ROS 2 node has, the actuator's lifecycle services, and the topics of a bag, which
the player publishes and the recorder subscribes to. `/tf` and `/tf_static` need tf2_msgs.
[src/pushfric_msgs](../src/pushfric_msgs) has the fields of all its types.

QoS: *latched* is reliable and transient local ([graph.md](graph.md)). A number is the depth, unless
it is {RELIABLE.depth} (reliable) or {LATCHED.depth} (latched).

`object_pose` is the pose of the frame `object` in `table` ([frames](conventions.md#frames)). The variance of z, roll and pitch
is {UNMEASURED:g}: they are not measured.
"""

EVERYWHERE = ("/diagnostics", "publishes")
"""Name and role of an endpoint of every node."""

OF_THE_BAG = "std_msgs/msg/Char"
"""Type of a topic that exists only in the bag; no node has a topic of this type of its own."""

EMPTY = bytes((0, 1, 0, 0, 0))
"""A message of that type in CDR: little-endian, one byte."""


class Start(NamedTuple):
    """How a node is started."""

    name: str
    required: dict[str, Any]  # parameters
    variants: dict[str, dict[str, Any]]  # by description: parameters with which the node has other topics


class Description(NamedTuple):
    """The interfaces of a node."""

    node: str
    summary: str
    endpoints: dict[Endpoint, str]  # -> when it has this endpoint; empty: always
    settings: list[Setting]


def document() -> str:
    """The text of docs/interfaces.md."""
    return "\n".join((HEAD, *map(section, describe())))


def describe(*names: str) -> list[Description]:
    """Start these nodes, or else every node, in each variant, and ask them."""
    asked = Introspection(NAMESPACE)
    with tempfile.TemporaryDirectory(prefix="pushfric-interfaces-") as folder:
        starts = [start for start in _starts(pathlib.Path(folder)) if not names or start.name in names]
        return [_describe(start, asked) for start in starts]


def _starts(folder: pathlib.Path) -> Iterator[Start]:
    name = "rubber_rect4"
    cell = demo_cell(name, folder)
    assert cell.camera is not None
    assert cell.pusher is not None
    camera = {"calibration": cell.camera.calibration}
    picture, bag = folder / "picture.png", folder / "bag"
    cv2.imwrite(str(picture), np.zeros((480, 640), np.uint8))
    with BagWriter(bag) as writer:
        writer.add_topic(f"{NAMESPACE}/anything", OF_THE_BAG, [], type_hash(OF_THE_BAG), definition(OF_THE_BAG))
        writer.write(f"{NAMESPACE}/anything", 1, EMPTY)
    sources: dict[str, dict[str, Any]] = {
        "`source: compressed`": {"source": "compressed"},
        "a device as `source`": {"source": f"{folder}/*.png"},
    }
    kinds: dict[str, dict[str, Any]] = {
        "`force` or `force_angle` in `terms`": {"terms": ["moment", "force"]},
        "`source: observations`": {"source": "observations"},
    }
    pusher, stage = settings.merged((cell.pusher, cell.driver)), settings.plain(cell.pusher.stage)
    yield Start("tracker", {"object": name, **camera, "source": "topic"}, sources)
    yield Start("pose_source", {}, {})
    yield Start("tip_source", {"object": name, "tip_radius": 0.003}, {})
    guards: dict[str, dict[str, Any]] = {"`enable_timeout`": {"enable_timeout": 1.0}, "`max_force`": {"max_force": 1.0}}
    yield Start("actuator", pusher, guards)
    yield Start("estimator", {"object": name}, kinds)
    yield Start("planner", {}, {})
    yield Start("experiment", {"object": name}, {})
    yield Start("recorder", {"bag": str(folder / "new"), "discover": True}, {})
    yield Start("player", {"bag": str(bag)}, {})
    yield Start("view", {"object": name}, {})
    yield Start("simulated_cell", {"object": name, "port_link": pusher["port"], **camera, **stage}, {})


def _describe(start: Start, asked: Introspection) -> Description:
    kind = node_class(start.name)
    answers = {label: asked.ask(kind, start.required | more) for label, more in {"": {}, **start.variants}.items()}
    found = {label: [one for one in of.endpoints if one.type != OF_THE_BAG] for label, of in answers.items()}
    every = sorted({endpoint for label in found for endpoint in found[label]}, key=lambda one: (ROLES.index(one.role), one))
    plain = answers[""]
    endpoints = {one._replace(name=one.name.replace("~", plain.name)): _when(one, found) for one in every}
    declared = [one for one in plain.settings if not one.name.startswith("qos_overrides.")]  # of topics of the bag
    return Description(plain.name, " ".join((inspect.getdoc(kind) or "").split()), endpoints, declared)


def _when(endpoint: Endpoint, found: dict[str, list[Endpoint]]) -> str:
    having = [label for label in found if endpoint in found[label]]
    if "" not in having:
        return f"with {', '.join(having)}"
    lacking = [label for label in found if label not in having]
    return f"not with {', '.join(lacking)}" if lacking else ""


def section(described: Description) -> str:
    """The part of the document about one node."""
    rows = [(*endpoint, when) for endpoint, when in described.endpoints.items()]
    topics: list[tuple[str, ...]] = [
        (role, f"`{name}`", kind, "; ".join(filter(None, (quality(qos), when))))
        for role, name, kind, qos, when in rows
        if (name, role) != EVERYWHERE and not kind.startswith("lifecycle_msgs/")
    ]
    together: dict[tuple[str, ...], list[str]] = {}
    for role, name, *rest in topics:
        together.setdefault((role, *rest), []).append(name)
    topics = [(role, ", ".join(names), *rest) for (role, *rest), names in together.items()]
    settings = [
        (
            f"`{one.name}`",
            ", ".join(filter(None, (one.type, span(one)))),
            "*required*" if one.required else f"`{as_yaml(one.default)}`",
            one.description,
        )
        for one in described.settings
    ]
    keys = {(key, default, what) for rows in cell_docs.sections().values() for key, _, default, _, what in rows}
    of_cell = [key for key, _, default, what in settings if (key, default, what) in keys]
    own = [row for row in settings if row[0] not in of_cell]
    parts = [f"## {described.node}\n\n{wrapped(described.summary)}\n"]
    if topics:
        parts.append(table(("", "name", "type", "QoS; when"), topics))
    if of_cell:
        parts.append(f"{wrapped('Keys of a cell: ' + ', '.join(by_section(of_cell)))}.\n")
    if own:
        parts.append(table(("parameter", "type", "default", "what"), own))
    return "\n".join(parts)


def by_section(keys: list[str]) -> list[str]:
    """Keys of a cell's file; where a whole section is among them, its name stands for it."""
    whole = {name: {row[0] for row in rows} for name, rows in cell_docs.sections().items() if name}
    whole = {name: section for name, section in whole.items() if section <= {*keys}}
    return [f"all of `{name}`" for name in whole] + [
        key for key in keys if not any(key in section for section in whole.values())
    ]


def quality(qos: str) -> str:
    """A quality of service in few words: see HEAD."""
    usual = {f"reliable, depth {RELIABLE.depth}": "reliable", f"reliable, transient local, depth {LATCHED.depth}": "latched"}
    return usual.get(qos, qos.replace("reliable, transient local", "latched").replace("depth ", ""))


def wrapped(paragraph: str) -> str:
    """A paragraph in lines of at most 120 columns."""
    return textwrap.fill(paragraph, 120, break_long_words=False, break_on_hyphens=False)


def span(setting: Setting) -> str:
    """The range of a setting; empty if it has none."""
    return "" if setting.limits is None else limits(*setting.limits)


if __name__ == "__main__":
    print(document(), end="")
