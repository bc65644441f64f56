"""All input from outside is accepted, or refused in one line; each case here once ended a process or took all its memory."""

import math
import os
import pathlib
import struct
import subprocess
import sys
import time
import zlib

import hostile_input
import numpy as np
import pytest
from geometry_msgs.msg import Point, PoseWithCovarianceStamped, Quaternion, Vector3, WrenchStamped
from geometry_msgs.msg import Pose as PoseMsg
from rclpy.serialization import serialize_message
from std_msgs.msg import Header, String

from pushfric_core import InvalidInput, Outline
from pushfric_core.bags import samples
from pushfric_core.bags.bag import Bag
from pushfric_core.bags.bag_writer import BagWriter
from pushfric_core.bags.recorded import Recorded, check_source
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.object_file import load_object, read_points
from pushfric_core.files.yaml_files import yaml_content
from pushfric_core.files.yaml_text import DEPTH_LIMIT, INTEGER_LIMIT, NODE_LIMIT, TEXT_LIMIT, load_yaml
from pushfric_core.vision import PIXEL_LIMIT
from pushfric_core.vision.camera import picture_from
from pushfric_msgs.msg import Observation, PusherState

HUGE = 1e200


@pytest.mark.parametrize("name", hostile_input.targets())
def test_mutated_input_is_taken_or_refused_in_one_line(tmp_path, name, pytestconfig):
    """Some seeds that are always the same; with `--fuzz MINUTES`, other ones follow."""
    for seed in range(25):
        hostile_input.attempt(name, seed, tmp_path)
    deadline = time.monotonic() + 60 * pytestconfig.getoption("fuzz") / len(hostile_input.targets())
    seed = time.time_ns() % 2**32
    while time.monotonic() < deadline:
        hostile_input.attempt(name, seed, tmp_path)
        seed += 1


# --- YAML ---


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a: !!int ''", "line 1: expected plain values, got the tag 'tag:yaml.org,2002:int'"),
        ("a: 1\nb: !!bool x", "line 2: expected plain values"),
        ("[" * 3000, f"expected at most {DEPTH_LIMIT} levels of lists and mappings"),
        ("a: 0x" + "f" * 5000, "a whole number beyond 64 bits"),
        (f"a: {INTEGER_LIMIT}", "a whole number beyond 64 bits"),
        ("a: &a [*a]", "the alias 'a' names nothing that is complete"),
        ("a: \0", "control characters are not allowed"),
        ("#" * (TEXT_LIMIT + 1), f"expected at most {TEXT_LIMIT} characters"),
    ],
)
def test_yaml_beyond_a_limit_is_refused(text, expected):
    with pytest.raises(ValueError, match=expected) as error:
        load_yaml(text)
    assert len(str(error.value).splitlines()) == 1


def test_an_alias_bomb_is_refused_and_honest_aliases_are_taken():
    levels = [f"{name}: &{name} [{', '.join([f'*{inner}'] * 9)}]" for inner, name in zip("abcdefgh", "bcdefghi", strict=True)]
    with pytest.raises(ValueError, match=f"expected at most {NODE_LIMIT} values"):
        load_yaml("\n".join(["a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1]", *levels]))
    assert load_yaml("a: &a [1, 2]\nb: *a") == {"a": [1, 2], "b": [1, 2]}
    nested = "a: &a {k: 1}\nb: {c: &c {<<: *a, k: 2}}\nd: {<<: *c, k: 3}"
    assert load_yaml(nested) == {"a": {"k": 1}, "b": {"c": {"k": 2}}, "d": {"k": 3}}


def test_files_that_cannot_be_are_refused(tmp_path):
    for name in ("a\0b", "x" * 5000, "/dev/null/x", str(tmp_path)):
        with pytest.raises(InvalidInput, match="no object"):
            load_object(name)
    for name in ("x" * 300, "a\0b"):
        with pytest.raises(InvalidInput, match="no such file"):
            check_source(pathlib.Path(name))
        with pytest.raises(InvalidInput, match=r"cannot be read: (File name too long|embedded null byte)"):
            Bag(name)
    hostile_input.attempt("cell", 100483, tmp_path)  # names a calibration of 5000 characters
    hostile_input.attempt("model", 33253, tmp_path)  # weights whose sum is off by just what is allowed
    with pytest.raises(InvalidInput, match="cannot be read: embedded null byte"):
        yaml_content(tmp_path / "a\0b")
    with pytest.raises(InvalidInput, match="expected at most"):
        yaml_content(pathlib.Path("/dev/zero"))
    os.mkfifo(tmp_path / "pipe.yaml")
    with pytest.raises(InvalidInput, match="cannot be read: it is a pipe"):
        yaml_content(tmp_path / "pipe.yaml")


# --- messages ---


@pytest.mark.parametrize("field", ["x", "y", "z", "w"])
@pytest.mark.parametrize("value", [HUGE, -HUGE, 1e308, math.nan, math.inf])
def test_a_quaternion_beyond_reason_is_refused(field, value):
    msg = PoseWithCovarianceStamped()
    setattr(msg.pose.pose.orientation, field, value)
    with pytest.raises(ValueError, match="a pose "):
        samples.pose_sample_from_msg(msg)


def test_other_magnitudes_beyond_reason_are_refused():
    with pytest.raises(ValueError, match="a position must lie within 100 m"):
        samples.pose_from_msg(PoseMsg(position=Point(x=HUGE), orientation=Quaternion(w=1.0)))
    wrench = WrenchStamped()
    wrench.header.frame_id, wrench.wrench.force.x = "table", HUGE
    with pytest.raises(ValueError, match="a force must lie within 10000 N"):
        samples.force_sample_from_msg(wrench)
    for fields, expected in [
        ({"position": HUGE}, "a pusher state must lie within 100 m or m/s"),
        ({"tip_radius": -0.001}, "tip radius must be at least 0"),
        ({"push_id": -2}, "push id must be at least 0"),
    ]:
        with pytest.raises(ValueError, match=expected):
            samples.pusher_sample_from_msg(PusherState(direction=Vector3(x=1.0), **fields))
    for take in (samples.pose_sample_from_msg, samples.pusher_sample_from_msg):
        with pytest.raises(ValueError, match="must have frame_id 'table', got 'world'"):
            take(PusherState(header=Header(frame_id="world")))
    for fields, expected in [
        ({"half_width": HUGE}, "half_width must lie within 3 m"),
        ({"force": Vector3(x=HUGE)}, "force must lie within 10000 N"),
        ({"push_id": -1}, "push_id must lie in"),
        ({"contact_point": Point(x=HUGE)}, "contact_point must lie within 100 m"),
    ]:
        msg = Observation(contact_normal=Vector3(x=1.0), **fields)
        msg.twist.linear.x = 0.1
        with pytest.raises(ValueError, match=expected):
            samples.observation_from_msg(msg)


def png(width: int, height: int) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", b"") + chunk(b"IEND", b"")


def test_a_picture_too_large_is_refused_before_it_is_allocated(tmp_path):
    """In a process of its own, because OpenCV reads the limit when it is loaded."""
    pictures = [tmp_path / "huge.png", tmp_path / "large.png"]
    for path, size in zip(pictures, (100_000, 20_000), strict=True):
        path.write_bytes(png(size, size))
    script = """
import sys, pathlib
import pushfric_ros.nodes.tracker
import numpy as np
from pushfric_core.vision.camera import picture_from
for path in sys.argv[1:]:
    try:
        picture_from(np.frombuffer(pathlib.Path(path).read_bytes(), np.uint8), "png")
    except ValueError as error:
        print(error)
"""
    run = subprocess.run([sys.executable, "-c", script, *pictures], stdout=subprocess.PIPE, text=True, check=True, timeout=60)
    assert run.stdout == f"not a picture of at most {PIXEL_LIMIT} pixels: 57 bytes of format 'png'\n" * 2


@pytest.mark.parametrize("data", [b"", b"no picture", png(8, 8), png(0, 8)])
def test_what_is_no_picture_is_refused(data):
    with pytest.raises(ValueError, match=r"not a picture: \d+ bytes of format 'png'"):
        picture_from(np.frombuffer(data, np.uint8), "png")


# --- bags ---


def test_a_topic_of_another_type_is_refused(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        for topic in ("observation", "estimator_settings"):
            swapped = "std_msgs/msg/String" if topic == "observation" else "pushfric_msgs/msg/Observation"
            writer.add_topic(f"/cell/{topic}", swapped, [])
        writer.write("/cell/observation", 1, serialize_message(String(data="surprise")))
        writer.write("/cell/estimator_settings", 1, serialize_message(Observation()))
    with pytest.raises(InvalidInput, match="/cell/observation holds messages of std_msgs/msg/String, expected pushfric_msgs"):
        Recorded(tmp_path / "bag").read(load_object("rubber_rect4"), EstimatorSettings(), pytest.fail)
    with pytest.raises(InvalidInput, match="/cell/estimator_settings holds messages of pushfric_msgs/msg/Observation"):
        _ = Recorded(tmp_path / "bag").settings


def test_malformed_messages_in_a_whole_bag_are_refused_one_by_one(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/cell/observation", "pushfric_msgs/msg/Observation", [])
        for stamp, raw in enumerate((b"", b"\0\1\0\0", b"\xff" * 300)):
            writer.write("/cell/observation", stamp, raw)
    refused: list[str] = []
    with pytest.raises(InvalidInput, match="its observations give no observation of rubber_rect4"):
        Recorded(tmp_path / "bag").read(load_object("rubber_rect4"), EstimatorSettings(), refused.append)
    assert refused.pop().endswith("bag: 3 of 3 observations are refused: the values are impossible")
    assert len(refused) == 3
    assert all("not a pushfric_msgs/msg/Observation" in line for line in refused)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[" * 100_000, "must be a JSON object, got lists within lists"),
        ("{}}", "Extra data"),
        ("1", "must be a JSON object, got '1'"),
        ('{"exclude_pushes": [1e999]}', "exclude_pushes must be a list of whole numbers"),
        ('{"window": ' + "9" * 5000 + "}", "5000 digits"),
    ],
)
def test_recorded_settings_that_make_no_sense_are_refused(text, expected):
    with pytest.raises(ValueError, match=expected):
        EstimatorSettings.from_text(text)


# --- tables ---


def test_points_beyond_reason_are_refused(tmp_path):
    path = tmp_path / "points.csv"
    path.write_text("x,y\n1e200,0\n")
    with pytest.raises(InvalidInput, match="line 2: x and y must lie within 100 m"):
        read_points(path)
    with pytest.raises(ValueError, match="an outline must be at most 3 m long and wide, got 1e"):
        Outline(np.array(((0, 0), (HUGE, 0), (0, HUGE))))
