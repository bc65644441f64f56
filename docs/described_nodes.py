"""Topics, services, actions and parameters of every node, found by asking the node itself."""

import inspect
import math
import pathlib
import tempfile
from typing import Any, NamedTuple

import cv2
import numpy as np
import yaml

from pushfric_core import settings
from pushfric_core.bags.bag_writer import BagWriter
from pushfric_ros.commands.demo import demo_cell
from pushfric_ros.graph.graph import NAMESPACE
from pushfric_ros.messages.types import definition, type_hash
from pushfric_ros.node_kit.introspection import ROLES, Endpoint, Introspection, Setting, node_class

OF_THE_BAG = "std_msgs/msg/Char"
"""Type of a topic that exists only in the bag; no node has a topic of this type of its own."""

EMPTY = bytes((0, 1, 0, 0, 0))
"""A message of that type in CDR: little-endian, one byte."""


class Description(NamedTuple):
    """The interfaces of a node."""

    node: str
    summary: str
    endpoints: dict[Endpoint, str]  # -> when it has this endpoint; empty: always
    settings: list[Setting]


Parameters = dict[str, Any]


def describe() -> list[Description]:
    """Start every node, in each variant, and ask it."""
    asked = Introspection(NAMESPACE)
    with tempfile.TemporaryDirectory(prefix="pushfric-interfaces-") as folder:
        return [_describe(name, *how, asked) for name, how in _starts(pathlib.Path(folder)).items()]


def _starts(folder: pathlib.Path) -> dict[str, tuple[Parameters, dict[str, Parameters]]]:
    """How each node is started: the parameters that it needs; and by description, those with which it has other topics."""
    known = {"object": "rubber_rect4"}
    cell = demo_cell(known["object"], folder)
    camera = {"calibration": cell.camera.calibration}
    picture, bag = folder / "picture.png", folder / "bag"
    cv2.imwrite(str(picture), np.zeros((480, 640), np.uint8))
    with BagWriter(bag) as writer:
        writer.add_topic(f"{NAMESPACE}/anything", OF_THE_BAG, [], type_hash(OF_THE_BAG), definition(OF_THE_BAG))
        writer.write(f"{NAMESPACE}/anything", 1, EMPTY)
    sources = {"`source: compressed`": {"source": "compressed"}, "a device as `source`": {"source": f"{folder}/*.png"}}
    terms = {"`force` or `force_angle` in `terms`": {"terms": ["moment", "force"]}}
    guards = {"`enable_timeout`": {"enable_timeout": 1.0}, "`max_force`": {"max_force": 1.0}}
    pusher, stage = settings.merged((cell.pusher, cell.driver)), settings.plain(cell.pusher.stage)
    return {
        "tracker": (known | camera | {"source": "topic"}, sources),
        "pose_source": ({}, {}),
        "tip_source": (known | {"tip_radius": 0.003}, {}),
        "actuator": (pusher, guards),
        "estimator": (known, terms | {"`source: observations`": {"source": "observations"}}),
        "planner": ({}, {}),
        "experiment": (known, {}),
        "recorder": ({"bag": str(folder / "new"), "discover": True}, {}),
        "player": ({"bag": str(bag)}, {}),
        "view": (known, {}),
        "simulated_cell": (known | {"port_link": pusher["port"]} | camera | stage, {}),
    }


def _describe(name: str, required: Parameters, variants: dict[str, Parameters], asked: Introspection) -> Description:
    kind = node_class(name)
    answers = {label: asked.ask(kind, required | more) for label, more in {"": {}, **variants}.items()}
    found = {label: [one for one in of.endpoints if one.type != OF_THE_BAG] for label, of in answers.items()}
    every = sorted({endpoint for label in found for endpoint in found[label]}, key=lambda one: (ROLES.index(one.role), one))
    plain = answers[""]
    endpoints = {one._replace(name=one.name.replace("~", plain.name)): _when(one, found) for one in every}
    return Description(plain.name, " ".join((inspect.getdoc(kind) or "").split()), endpoints, plain.settings)


def _when(endpoint: Endpoint, found: dict[str, list[Endpoint]]) -> str:
    having = [label for label in found if endpoint in found[label]]
    if "" not in having:
        return f"with {', '.join(having)}"
    lacking = [label for label in found if label not in having]
    return f"not with {', '.join(lacking)}" if lacking else ""


def as_yaml(value: Any) -> str:
    """A value as it stands in one line of YAML."""
    return yaml.safe_dump(value, default_flow_style=True, width=math.inf).removesuffix("...\n").rstrip()
