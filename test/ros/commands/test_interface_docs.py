"""docs/interfaces.md and docs/foxglove_layout.json against what the nodes really have."""

import json
import pathlib
import re
import subprocess
import sys

import pytest
from ament_index_python.packages import get_package_prefix

from docs import described_nodes, reference
from pushfric_ros.graph import graph
from pushfric_ros.messages.types import message_class
from pushfric_ros.node_kit.visit import visit

ROOT = pathlib.Path(__file__).parents[3]
INSTALLED = pathlib.Path(get_package_prefix("pushfric_ros")) / "lib/pushfric_ros/recorder_node"


@pytest.fixture(scope="module")
def described():
    """What the nodes tell while a cell is running, whose nodes have the same names."""
    with visit("actuator", graph.NAMESPACE):
        return {description.node: description for description in described_nodes.describe()}


@pytest.fixture(scope="module")
def topics(described):
    """Full name of every topic that a node publishes -> its type."""
    published = [
        endpoint for description in described.values() for endpoint in description.endpoints if endpoint.role == "publishes"
    ]
    return {name if name.startswith("/") else f"{graph.NAMESPACE}/{name}": kind for _, name, kind, _ in published}


def test_the_document_describes_the_nodes(described):
    text = reference.interfaces(described.values())
    assert (ROOT / "docs/interfaces.md").read_text() == text, f"stale; write it again with: {reference.COMMAND}"


def test_every_node_that_is_installed_is_described(described):
    setup = (ROOT / "src/pushfric_ros/setup.py").read_text()
    installed = re.search(r"NODES = \((.*?)\)", setup, re.DOTALL)[1]
    assert list(described) == re.findall(r'"(\w+)"', installed)


def test_recorded_topics_are_published_with_that_type_and_quality(described):
    endpoints = {endpoint.name: endpoint for description in described.values() for endpoint in description.endpoints
                 if endpoint.role == "publishes"}  # fmt: skip
    for name, kind, quality in graph.TOPICS:
        assert endpoints[name].type == kind
        assert ("best effort" in endpoints[name].qos) == (quality == "sensor_data"), name
        assert ("transient local" in endpoints[name].qos) == (quality == "latched"), name


@pytest.fixture(scope="module")
def layout():
    return json.loads((ROOT / "docs/foxglove_layout.json").read_text())


def strings(value):
    """All strings in a JSON value, including the keys of objects."""
    if isinstance(value, dict):
        value = [*value.keys(), *value.values()]
    return [text for item in value for text in strings(item)] if isinstance(value, list) else [value]


def test_the_layout_shows_only_topics_and_fields_that_exist(layout, topics):
    paths = [text for text in strings(layout["configById"]) if isinstance(text, str) and text.startswith("/")]
    assert {"/diagnostics", "/cell/markers", "/cell/overlay/compressed"} <= set(paths)
    for path in paths:
        topic, *fields = path.split(".")
        assert topic in topics, path
        kind = topics[topic]
        for field in fields:
            kind = message_class(kind if "/msg/" in kind else kind.replace("/", "/msg/")).get_fields_and_field_types()[field]
        assert not fields or kind == "double", path


def test_a_node_prints_its_help():
    """Once, the node ignored --help and started; then it would complain here about the missing bag."""
    asked = subprocess.run([sys.executable, INSTALLED, "--help"], capture_output=True, text=True, timeout=120)
    assert (asked.returncode, asked.stderr) == (0, "")
    assert asked.stdout.startswith("usage: ros2 run pushfric_ros recorder_node")
