"""Whether images at 60 Hz are recorded without loss."""

import array
import json
import pathlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import Image

from bench.processes import cpu_of_ended_children, running
from pushfric_core.bags.bag import Bag
from pushfric_ros.graph.graph import NodeSpec
from pushfric_ros.graph.supervisor import command
from pushfric_ros.node_kit.network import configured
from pushfric_ros.node_kit.qos import SENSOR_DATA

RATE, SECONDS = 60.0, 10.0
"""Rate of the images [Hz], and how long they are published [s]."""

WIDTH, HEIGHT = 640, 480
TOPIC = "/bench/image_raw"
ROOT = pathlib.Path(__file__).resolve().parents[1]

RECORDING_TIMEOUT = 20.0
"""Longest time that the recorder may take to appear, and to end [s]."""

STEPS = 1

Figures = dict[str, Any]


def measure(progress: Callable[[str], None]) -> Figures:
    """Record colour images of noise, which cannot be compressed, through the middleware.

    Returns:
        "images": {published, published_hz, recorded, recorder_cores (CPU time over wall time), megabytes}.
    """
    progress("recording images")
    return {"images": _record_images()}


def _record_images() -> Figures:
    """Record images that a process of its own publishes, as a camera driver does."""
    with tempfile.TemporaryDirectory(prefix="pushfric-bench-") as name:
        folder = pathlib.Path(name)
        spec = NodeSpec("recorder", {"bag": str(folder / "bag"), "topics": [f"{TOPIC} sensor_msgs/msg/Image sensor_data"]})
        with running(command(spec, "/bench", folder)) as recorder:
            arguments = [sys.executable, "-m", "bench.recording", str(SECONDS)]
            publisher = subprocess.run(arguments, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
            published = json.loads(publisher.stdout)
            before = cpu_of_ended_children()
            recorder.terminate()
            recorder.wait(RECORDING_TIMEOUT)
        cpu_seconds = cpu_of_ended_children() - before
        summary = Bag(folder / "bag").summary
        return {
            **published,
            "recorded": summary.message_count,
            "recorder_cores": cpu_seconds / SECONDS,
            "megabytes": sum(file.stat().st_size for file in (folder / "bag").iterdir()) / 1e6,
        }


def _publish_images(seconds: float) -> Figures:
    """A camera driver: once there is a subscriber, publish images of noise at RATE for this long [s]."""
    with configured(images=True):
        rclpy.init()
        node = Node("camera")
    output = node.create_publisher(Image, TOPIC, SENSOR_DATA)
    rng = np.random.default_rng(0)
    # more images than fit into one chunk of the bag; otherwise the compression would find each of them twice
    pictures = [array.array("B", rng.bytes(HEIGHT * WIDTH * 3)) for _ in range(8)]
    image = Image(height=HEIGHT, width=WIDTH, encoding="bgr8", step=3 * WIDTH)
    deadline = time.monotonic() + RECORDING_TIMEOUT
    while not output.get_subscription_count():
        if time.monotonic() > deadline:
            raise RuntimeError("the recorder did not appear")
        time.sleep(0.01)
    time.sleep(1.0)  # the other side discovers this one a little later, and there is no event for it
    count = round(RATE * seconds)
    begin = time.monotonic()
    for number in range(count):
        time.sleep(max(0.0, begin + number / RATE - time.monotonic()))
        image.header.stamp = node.get_clock().now().to_msg()
        image.data = pictures[number % len(pictures)]
        output.publish(image)
    took = time.monotonic() - begin
    time.sleep(1.0)  # best effort: there is no event when the last image has arrived
    node.destroy_node()
    rclpy.shutdown()
    return {"published": count, "published_hz": count / took}


if __name__ == "__main__":
    print(json.dumps(_publish_images(float(sys.argv[1]))))
