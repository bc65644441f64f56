"""Faults between camera and tracker, in the middle of a push.

`python -m faults.camera FAULT FOLDER` runs a simulated cell in real time, whose tracker hears a camera with this fault; its
files are in the folder. `python -m faults.camera FAULT` is that camera.
"""

import contextlib
import pathlib
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from rclpy.node import Node
from sensor_msgs.msg import Image

from faults.cell_run import CellRun
from pushfric_core.bags.samples import stamp_from_msg
from pushfric_core.cell.node_settings import PlanConfig
from pushfric_core.commands.console import console, fail
from pushfric_core.commands.program import run
from pushfric_msgs.msg import PusherState
from pushfric_ros.commands.demo import demo_cell
from pushfric_ros.commands.watch import watch
from pushfric_ros.faults.fault import EndedEarly
from pushfric_ros.faults.processes import end, started
from pushfric_ros.graph import graph
from pushfric_ros.messages.conversions import image_to_msg
from pushfric_ros.node_kit.process import run_node
from pushfric_ros.node_kit.qos import RELIABLE, SENSOR_DATA

NAMESPACE = "/cell"
TRUE, SHOWN = "camera/image_raw", "image_raw"
"""The topic on which the camera publishes, and the topic that the tracker receives."""

BEGIN = 0.015
"""The fault begins when the pusher has come this far [m]: in the middle of the first push."""

BEGUN = "the camera is at fault"
"""What the camera prints then."""

HOUR = 3600 * 10**9

Picture = npt.NDArray[np.uint8]


class Frame(NamedTuple):
    """An image."""

    picture: Picture  # (height, width)
    stamp: int  # [ns]

    def later(self, shift: int) -> "Frame":
        """The same with another stamp."""
        return self._replace(stamp=self.stamp + shift)


@dataclass
class Seen:
    """What the camera has seen since the fault began."""

    first: list[Frame] = field(default_factory=list)  # the first frames, up to two
    last: deque[Frame] = field(default_factory=lambda: deque(maxlen=8))
    count: int = 0

    @property
    def now(self) -> Frame:
        """The newest frame."""
        return self.last[-1]


def _one_pixel(seen: Seen) -> Picture:
    picture = seen.first[0].picture.copy()
    picture[3, seen.count % 600] ^= 1
    return picture


def _without_object(seen: Seen) -> Picture:
    picture = seen.now.picture
    return np.minimum(picture, 2 * np.median(picture)).astype(np.uint8)


def _half(seen: Seen) -> Picture:
    picture, columns = seen.now.picture.copy(), np.flatnonzero((seen.now.picture > 128).any(axis=0))
    if len(columns):
        picture[:, : int(columns.mean())] = np.median(picture)
    return picture


def _turn(seen: Seen) -> list[Frame]:
    """Each pair of frames in the wrong order."""
    return [seen.last[-1], seen.last[-2]] if seen.count % 2 == 0 else []


def _torn(seen: Seen) -> Picture:
    return np.vstack((seen.now.picture[:240], seen.last[0].picture[240:]))


UNSEEN, UNFOLLOWING = "the object was not seen for", "the object does not follow the pusher"
CLOCK = "the clock of the camera is 3600 s {} this computer's"

FAULTS: dict[str, tuple[Callable[[Seen], Picture | list[Frame]], str]] = {
    "unplugged": (lambda seen: [], UNSEEN),
    "frozen": (lambda seen: seen.first[0].picture, UNSEEN),
    "frozen except for one pixel": (_one_pixel, UNFOLLOWING),
    "two images that alternate": (lambda seen: seen.first[seen.count % len(seen.first)].picture, f"{UNFOLLOWING}|{UNSEEN}"),
    "image shifted by 40 px": (lambda seen: np.roll(seen.now.picture, 40, axis=1), f"the object leaps by 2[0-9] mm|{UNSEEN}"),
    "black": (lambda seen: np.zeros_like(seen.now.picture), UNSEEN),
    "white": (lambda seen: np.full_like(seen.now.picture, 255), UNSEEN),
    "object taken away": (_without_object, UNSEEN),
    "two objects": (lambda seen: np.maximum(seen.now.picture, np.roll(seen.now.picture, -130, axis=0)), UNSEEN),
    "half an object": (_half, UNSEEN),
    "torn: the lower half is older": (_torn, f"{UNSEEN}|{UNFOLLOWING}"),
    "frames in the wrong order": (_turn, ""),
    "every frame twice": (lambda seen: [seen.now, seen.now], ""),
    "stamps of a foreign clock": (lambda seen: [seen.now.later(HOUR)], CLOCK.format("ahead of")),
    "clock set back by an hour": (lambda seen: [seen.now.later(-HOUR)], CLOCK.format("behind")),
    "clock set forward by an hour": (lambda seen: [seen.now.later(HOUR)], CLOCK.format("ahead of")),
    "clock set back for a second": (lambda seen: [seen.now.later(-HOUR * (seen.count < 14))], ""),
}
"""By the name of the fault: the picture or the frames that the tracker gets, from those that the camera has seen; and why the
run then waits for a person, as a regular expression, if it does."""


class FaultyCamera(Node):
    """Passes images on; from the middle of the first push, it passes on what the fault makes of them."""

    def __init__(self, fault: str) -> None:
        super().__init__("faulty_camera", namespace=NAMESPACE)
        (self._shown_of, _), self._seen = FAULTS[fault], Seen()
        self._begun = "foreign" in fault  # this one is there from the start
        self._out = self.create_publisher(Image, SHOWN, SENSOR_DATA)
        self.create_subscription(Image, TRUE, self._on_image, SENSOR_DATA)
        self.create_subscription(PusherState, "pusher_state", self._on_state, RELIABLE)

    def _on_state(self, msg: PusherState) -> None:
        self._begun = self._begun or (msg.push_id != PusherState.NO_PUSH and msg.position > BEGIN)

    def _on_image(self, msg: Image) -> None:
        if not self._begun:
            self._out.publish(msg)
            return
        if not self._seen.count:
            print(BEGUN, flush=True)
        seen, picture = self._seen, np.frombuffer(msg.data, np.uint8).reshape(msg.height, msg.width)
        seen.last.append(Frame(picture, stamp_from_msg(msg.header.stamp)))
        seen.first, seen.count = [*seen.first, seen.now][:2], seen.count + 1
        shown_of = self._shown_of(seen)
        for frame in shown_of if isinstance(shown_of, list) else [Frame(shown_of, seen.now.stamp)]:
            self._out.publish(image_to_msg(frame.picture, frame.stamp))


def start(fault: str, cell: CellRun) -> float:
    """Start a cell with this fault; returns when its camera fails.

    Raises:
        EndedEarly: the first push ended before that.
    """
    cell.start(sys.executable, "-m", "faults.camera", fault, str(cell.folder))
    cell.wait_for_output(rf"{BEGUN}|push \d+ aborted")
    if BEGUN not in cell.output:
        raise EndedEarly(f"the push ended before the fault: {cell.output}")
    return time.monotonic()


def main(fault: str, folder: pathlib.Path) -> None:
    """Run a cell with the tolerances of a real one, whose tracker does not hear its camera."""
    with tempfile.TemporaryDirectory(prefix="pushfric-") as scratch, contextlib.ExitStack() as stack:
        stack.callback(end, started((sys.executable, "-m", "faults.camera", fault), folder, output=None))
        plan = PlanConfig(plan=str(folder / "plan.yaml"))
        cell = replace(demo_cell("wood_rect4", pathlib.Path(scratch)), plan=plan)
        tolerances = {name: getattr(plan, name) for name in ("clock_tolerance", "follow_tolerance", "lost_object")}
        changed = {
            "simulated_cell": lambda spec: replace(spec, remappings={**spec.remappings, SHOWN: TRUE}),
            "experiment": lambda spec: spec.given(**tolerances),
        }
        specs = graph.simulated_cell(cell, str(folder / "bag"), seed=0, speed=1.0)
        specs = [changed.get(spec.name, lambda spec: spec)(spec) for spec in specs]
        ended, _ = watch(console, specs, NAMESPACE, "a faulty camera", False, prompts=True, recorded=folder / "bag")
    if ended.code:
        fail(ended.reason, ended.code)


if __name__ == "__main__":
    _, fault, *folder = sys.argv
    run(lambda: main(fault, pathlib.Path(*folder)) if folder else run_node(lambda: FaultyCamera(fault), images=True))
