"""Bags: whether images at 60 Hz are recorded without loss, and how fast a recorded run is estimated again."""

import array
import json
import pathlib
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import Image

from pushfric_core.estimator import Estimator
from pushfric_ros.bags import data_points
from pushfric_ros.bags.bag import Bag
from pushfric_ros.files.estimator_settings import EstimatorSettings
from pushfric_ros.files.object_file import OBJECT_FILE, load_object
from pushfric_ros.graph.graph import NodeSpec
from pushfric_ros.graph.supervisor import command
from pushfric_ros.node_kit.network import configured
from pushfric_ros.node_kit.qos import SENSOR_DATA

RATE, SECONDS = 60.0, 10.0
"""Rate of the images [Hz], and how long they are published [s]."""

WIDTH, HEIGHT = 640, 480
TOPIC = "/bench/image_raw"
DEMO_BAG = pathlib.Path(__file__).resolve().parents[1] / "bags/rubber_rect4"

PATIENCE = 20.0
"""Longest time that the recorder may take to appear, and to end [s]."""

ROUNDS = 5

Figures = dict[str, Any]


def measure(progress: Callable[[str], None]) -> Figures:
    """Record colour images of noise, which cannot be compressed, through the middleware; then estimate the demo's bag.

    Returns:
        "images": {published, published_hz, recorded, recorder_cores (CPU time over wall time), megabytes}. "offline":
        {seconds_recorded, cpu_seconds, times_real_time}: median CPU time of reading the bag, making its data points from poses
        and estimating after each.
    """
    progress("recording images")
    images = _record_images()
    progress("estimating a bag")
    return {"images": images, "offline": _estimate_demo()}


def _record_images() -> Figures:
    """Record images that a process of its own publishes, as a camera driver does."""
    with tempfile.TemporaryDirectory(prefix="pushfric-bench-") as name:
        folder = pathlib.Path(name)
        spec = NodeSpec("recorder", {"bag": str(folder / "bag"), "topics": [f"{TOPIC} sensor_msgs/msg/Image sensor_data"]})
        with _process(command(spec, "/bench", folder)) as recorder:
            publisher = subprocess.run([sys.executable, __file__, str(SECONDS)], stdout=subprocess.PIPE, text=True, check=True)
            published = json.loads(publisher.stdout)
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            recorder.terminate()
            recorder.wait(PATIENCE)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu_seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        summary = Bag(folder / "bag").summary
        return {
            **published,
            "recorded": summary.message_count,
            "recorder_cores": cpu_seconds / SECONDS,
            "megabytes": sum(file.stat().st_size for file in (folder / "bag").iterdir()) / 1e6,
        }


@contextmanager
def _process(arguments: list[str]) -> Iterator["subprocess.Popen[bytes]"]:
    process = subprocess.Popen(arguments)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


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
    deadline = time.monotonic() + PATIENCE
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


def _estimate_demo() -> Figures:
    model = load_object(str(DEMO_BAG / OBJECT_FILE))
    summary = Bag(DEMO_BAG).summary
    seconds_recorded = (summary.end_ns - summary.start_ns) / 1e9
    cpu_seconds = []
    for _ in range(ROUNDS):
        begin = time.process_time()
        data = data_points.observations(DEMO_BAG, model, EstimatorSettings(), _warn)
        data_points.estimate(Estimator(model.support_points), data, _warn)
        cpu_seconds.append(time.process_time() - begin)
    median = float(np.median(cpu_seconds))
    return {"seconds_recorded": seconds_recorded, "cpu_seconds": median, "times_real_time": seconds_recorded / median}


def _warn(line: str) -> None:
    print(f"warning: {line}", file=sys.stderr)


if __name__ == "__main__":
    print(json.dumps(_publish_images(float(sys.argv[1]))))
