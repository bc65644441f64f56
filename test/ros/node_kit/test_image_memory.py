"""The shared memory of a process that publishes images; each test has its own process, as Fast DDS reads its settings once."""

import json
import os
import subprocess
import sys

import pytest
from sensor_msgs.msg import Image

from pushfric_ros.node_kit import image_memory
from pushfric_ros.node_kit.image_memory import FILE_VARIABLES, PROFILES, make_room_for_images
from pushfric_ros.node_kit.qos import SENSOR_QUEUE

LARGE = 16 * 2**20

SEGMENTS = """
import json, re
import rclpy
from pushfric_ros.node_kit.image_memory import make_room_for_images
make_room_for_images()
rclpy.init()
node = rclpy.create_node("camera")
sizes = []
for line in open("/proc/self/maps"):
    begin, end, path = re.match(r"(\\w+)-(\\w+) .{4} \\w+ \\S+ \\d+ *(.*)", line).groups()
    if re.match(r"/dev/shm/fast(rtps|dds)_[0-9a-f]{16}$", path):
        sizes.append(int(end, 16) - int(begin, 16))
print(json.dumps(sizes))
"""

CAMERA = """
import sys, time
import rclpy
from sensor_msgs.msg import Image
from pushfric_ros.node_kit.image_memory import make_room_for_images
from pushfric_ros.node_kit.qos import SENSOR_DATA
make_room_for_images()
rclpy.init()
output = rclpy.create_node("camera").create_publisher(Image, "/image", SENSOR_DATA)
while not output.get_subscription_count():
    time.sleep(0.01)
sys.stdin.readline()  # the other side has found this one, too
image = Image(height=480, width=640, encoding="bgr8", step=1920, data=bytes(921600))
for number in range(10):
    image.header.stamp.sec = number
    output.publish(image)
sys.stdin.read()
"""


@pytest.fixture
def unset(monkeypatch):
    for name in (*FILE_VARIABLES, "FASTDDS_BUILTIN_TRANSPORTS", "RMW_IMPLEMENTATION"):
        monkeypatch.delenv(name, raising=False)


def segments() -> list[int]:
    """Sizes [bytes] of the segments that the middleware maps in a process that publishes images."""
    return json.loads(subprocess.run([sys.executable, "-c", SEGMENTS], capture_output=True, check=True, timeout=60).stdout)


def test_the_segment_is_large(unset):
    assert max(segments()) >= LARGE


def test_ten_colour_images_in_a_burst_arrive(ros, unset):
    """The default segment is too small for a single one."""
    heard: list[int] = []
    viewer = ros.node("viewer")
    images = viewer.create_subscription(Image, "/image", lambda msg: heard.append(msg.header.stamp.sec), SENSOR_QUEUE)
    camera = subprocess.Popen([sys.executable, "-c", CAMERA], stdin=subprocess.PIPE)
    try:
        ros.wait_for(images.get_publisher_count, timeout=120, what="the camera")
        camera.stdin.write(b"\n")
        camera.stdin.flush()
        ros.wait_for(lambda: len(heard) == 10, timeout=120, what="ten images")
    finally:
        camera.communicate(timeout=120)
    assert heard == list(range(10))


@pytest.mark.parametrize(
    "name", ["FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS"]
)
def test_the_configuration_of_the_user_is_kept(unset, monkeypatch, name):
    monkeypatch.setenv(name, "UDPv4")
    before = dict(os.environ)
    make_room_for_images()
    assert dict(os.environ) == before


@pytest.mark.parametrize("name", image_memory.FILES)
def test_a_profile_file_of_the_user_is_kept(unset, monkeypatch, tmp_path, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).touch()
    make_room_for_images()
    assert not set(FILE_VARIABLES) & set(os.environ)


@pytest.mark.parametrize(("attribute", "value"), [("FREE", 2**60), ("SHARED_MEMORY", PROFILES)])
def test_with_little_shared_memory_nothing_is_changed(unset, monkeypatch, attribute, value):
    monkeypatch.setattr(image_memory, attribute, value)
    make_room_for_images()
    assert not set(FILE_VARIABLES) & set(os.environ)
