"""The command `security`: what the nodes of a cell may do, as a policy for SROS 2."""

import dataclasses
import pathlib
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, NamedTuple

import cv2
import numpy as np
import typer

from pushfric_core.cell.cell_file import CellFile, load_cell
from pushfric_core.cell.node_settings import LOOPBACK
from pushfric_core.commands.application import Application
from pushfric_core.commands.console import console
from pushfric_core.files.disk import write_whole
from pushfric_core.vision.camera import load_camera
from pushfric_core.vision.frame_source import TOPICS as CAMERA_TOPICS
from pushfric_ros.graph import graph
from pushfric_ros.graph.graph import NodeSpec
from pushfric_ros.node_kit.introspection import Endpoint, Introspection, node_class
from pushfric_ros.node_kit.visit import COMMAND_LINE, enclave

FILE = "policy.xml"
VERSION = "0.2.0"
"""Version of the schema of policies (sros2, policy.xsd)."""

RULES = {
    ("publishes", "topic"): ("topics", "publish"),
    ("subscribes", "topic"): ("topics", "subscribe"),
    ("serves", "service"): ("services", "reply"),
    ("calls", "service"): ("services", "request"),
    ("serves", "action"): ("actions", "execute"),
    ("calls", "action"): ("actions", "call"),
}
"""Role and kind of an endpoint -> the element of the policy, and its attribute."""

PERSON = {
    ("subscribes", "topic"): "pusher_state pusher_fault plan_progress friction_estimate estimator_progress /diagnostics",
    ("publishes", "topic"): "heartbeat stop",
    ("calls", "service"): "actuator/stop actuator/reset estimator/reset"
    " experiment/withdraw experiment/repeat experiment/skip experiment/end",
}
"""Permissions of the command line: watch, stop and reset, but not push."""

app = Application()


class Permission(NamedTuple):
    """Something that a node may do."""

    role: str
    kind: str  # topic, service or action
    name: str  # with its namespace


@app.command()
def security(
    cell: Annotated[pathlib.Path, typer.Argument(help="Cell YAML.")],
    out: Annotated[pathlib.Path, typer.Option(help=f"Folder for {FILE}.")],
) -> None:
    """docs/security.md says how to make keys from the policy, and how to switch it on."""
    file = load_cell(cell)
    write_whole(out / FILE, policy(permissions(file)))
    console.print(f"{out / FILE}: only {enclave(file.namespace, 'experiment')} may push", markup=False, soft_wrap=True)


def permissions(file: CellFile) -> Mapping[str, Sequence[Permission]]:
    """Permissions of each node of a cell, by its enclave: exactly what it does with the settings of the cell's file.

    Raises:
        InvalidInput: a node refuses its settings.
    """
    namespace = file.namespace
    asked = Introspection(namespace)
    allowed = {}
    with tempfile.TemporaryDirectory(prefix="pushfric-security-") as folder:
        shown = dataclasses.replace(file.view, host=LOOPBACK, port=0)
        cell = graph.cell(file, str(pathlib.Path(folder) / "bag"))
        for spec in graph.with_planner(graph.with_view(cell, file.object, shown), file.planner):
            answer = asked.ask(node_class(spec.name), _harmless(spec, pathlib.Path(folder)))
            endpoints = {*asked.every_node, *answer.endpoints}
            if any(endpoint.name == "~/change_state" for endpoint in endpoints):  # only the middleware knows of this topic
                endpoints.add(Endpoint("publishes", "~/transition_event", "lifecycle_msgs/msg/TransitionEvent", "topic"))
            wanted = [_permission(namespace, spec.name, *_kind(endpoint)) for endpoint in endpoints]
            if spec.name == "recorder" and file.recorder.discover:
                wanted.append(Permission("subscribes", "topic", "/*"))
            if spec.name == "planner":  # serves clients by names of their own, too
                wanted += [one._replace(name=f"{one.name}/*") for one in wanted if one.role == "serves"]
            allowed[enclave(namespace, spec.name)] = wanted
    every = [_kind(endpoint) for endpoint in asked.every_node if not endpoint.name.startswith("~")]
    every += [(*rule, name) for rule, names in PERSON.items() for name in names.split()]
    allowed[enclave(namespace, COMMAND_LINE)] = [_permission(namespace, "", *kind) for kind in every]
    return allowed


def _harmless(spec: NodeSpec, folder: pathlib.Path) -> Mapping[str, object]:
    """The parameters of a node that is started only to be asked: it touches neither camera nor pusher."""
    if spec.name == "actuator":
        return {**spec.parameters, "autostart": False, "memory": ""}
    if spec.name == "tracker" and spec.parameters["source"] not in CAMERA_TOPICS:
        camera = load_camera(str(spec.parameters["calibration"]))
        cv2.imwrite(str(folder / "picture.png"), np.zeros((camera.height, camera.width), np.uint8))
        return {**spec.parameters, "source": str(folder / "*.png")}
    return spec.parameters


def _kind(endpoint: Endpoint) -> tuple[str, str, str]:
    return endpoint.role, endpoint.qos if endpoint.qos in ("service", "action") else "topic", endpoint.name


def _permission(namespace: str, node: str, role: str, kind: str, name: str) -> Permission:
    name = name.replace("~", node, 1)
    return Permission(role, kind, name if name.startswith("/") else f"{namespace}/{name}")


def policy(allowed: Mapping[str, Iterable[Permission]]) -> str:
    """The policy file, which `ros2 security generate_artifacts` reads; everything that it does not allow is forbidden."""
    root = ElementTree.Element("policy", version=VERSION)
    enclaves = ElementTree.SubElement(root, "enclaves")
    for path, wanted in allowed.items():
        profiles = ElementTree.SubElement(ElementTree.SubElement(enclaves, "enclave", path=path), "profiles")
        namespace, _, node = path.rpartition("/")
        profile = ElementTree.SubElement(profiles, "profile", ns=namespace or "/", node=node)
        for rule, (plural, attribute) in RULES.items():
            if names := sorted({one.name for one in wanted if (one.role, one.kind) == rule}):
                listed = ElementTree.SubElement(profile, plural, {attribute: "ALLOW"})
                for name in names:
                    ElementTree.SubElement(listed, rule[1]).text = name
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"
