"""The simulated cell: physics, camera, controller and operator behind the real interfaces; it publishes the clock.

With a real controller, the physics, the camera and the operator remain: they follow the tip that the actuator reports, in real
time, and no clock is published.
"""

import math
import pathlib
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMsg
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import String

from pushfric_core.bags.samples import pose_from_msg, pusher_sample_from_msg
from pushfric_core.cell.node_settings import SWITCHES, FrameConfig, ObjectConfig, SimulatedRunConfig, SimulationConfig
from pushfric_core.errors import SolverFailed
from pushfric_core.files.object_file import load_object
from pushfric_core.geometry.planar import Pose
from pushfric_core.geometry.support import Support
from pushfric_core.geometry.table_1 import TABLE_1
from pushfric_core.mechanics.simulation import PushedObject
from pushfric_core.plugins import SIMULATIONS, plugin
from pushfric_core.pushers.pusher import StageConfig
from pushfric_core.settings import REQUIRED, check_ranges, setting
from pushfric_core.simulated.camera import SimulatedCamera
from pushfric_core.simulated.serial_controller import SerialController
from pushfric_core.vision.camera import load_camera
from pushfric_msgs.msg import PusherState
from pushfric_ros.messages.conversions import image_to_msg, stamp_to_msg
from pushfric_ros.node_kit.diagnostics import Diagnostics, Health, Level
from pushfric_ros.node_kit.parameters import declare
from pushfric_ros.node_kit.process import run_node
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE, SENSOR_DATA
from pushfric_ros.node_kit.timers import wall_timer

STEPS_PER_FRAME = 4
"""Number of physics steps, and of ticks of /clock, from one frame to the next."""

START = 1_000_000_000_000_000_000
"""Simulated time begins here [ns], so that no stamp looks like the 0 of a missing stamp."""

OVERDUE, OVERDUE_STEP = 1.6, 0.05
"""While the moving pusher's position has not been asked for in this many periods, a step takes this long [s of wall time].

So the reports of a stroke lie close together on a busy machine, too; elsewhere, no step is held back.
"""

LAG = 0.15
"""With a real controller, a frame shows the world as it was this long ago [s]: two reports enclose the tip's place then."""

ASKEW = 0.6
"""A simulated person turns the object from its place by at most so much [rad], never end for end."""

REPORTS = 100
"""Number of the pusher's reports that are kept."""


@dataclass(frozen=True)
class SimulatedCellConfig:
    """How the simulated camera and controller take the place of real ones."""

    calibration: str = setting(REQUIRED, "path of the camera's calibration YAML", names="the camera's calibration YAML")
    port_link: str = setting("", "path at which the controller's serial port appears; empty: a real controller")
    controller: str = setting("grbl", "the controller at that port: an entry point of the group pushfric.simulations")
    poll_rate: float = setting(20.0, "how often the actuator asks for the position [Hz]", 1.0, 100.0)
    object_height: float = setting(0.0, "of the outline over the table [m]; 0: as the object's file says", 0.0, 1.0)

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.port_link and not pathlib.Path(self.port_link).parent.is_dir():
            raise ValueError(f"port_link must be a path in an existing folder, got {self.port_link!r}")


class SimulatedCellNode(Node):
    """Steps the simulation from a wall-clock timer and publishes /clock."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("simulated_cell", **kwargs)
        self._place = place = declare(self, SimulatedCellConfig)
        name, stage, run = declare(self, ObjectConfig).object, declare(self, StageConfig), declare(self, SimulatedRunConfig)
        self._config = config = declare(self, SimulationConfig)
        self._rng = np.random.default_rng(run.seed)
        self._line = stage.line
        self._object = pushed_object(name, config.contact_friction)
        self._present = False
        self._placing: tuple[float, Pose] | None = None  # (when [s], where)
        self._elapsed = 0.0
        self._steps = 0
        camera = load_camera(place.calibration)
        height = place.object_height or load_object(name).height
        self._camera = SimulatedCamera(
            camera, self._object.outline.vertices, height, self._rng, noise_sigma=config.noise, blur_px=config.blur
        )
        self._info = CameraInfo(**camera.info_fields())
        topics = Diagnostics(self, self._health, declare(self, FrameConfig).within(self.get_namespace()))
        self._image_out = topics.advertise(Image, "image_raw", SENSOR_DATA)
        self._info_out = topics.advertise(CameraInfo, "camera_info", SENSOR_DATA)
        self.create_subscription(PoseStamped, "placement", self._on_placement, LATCHED)
        self.create_subscription(PoseStamped, "hand", self._on_hand, RELIABLE)
        self._switched = dict.fromkeys(SWITCHES, False)
        self.create_subscription(String, "switch", self._on_switch, RELIABLE)
        self._controller: SerialController | None = None
        self._reports: deque[tuple[int, float]] = deque(maxlen=REPORTS)  # (when [ns], where [m]) of a real pusher
        self._shown = 0  # the time that the last frame of its world shows [ns]
        self._wall_start = self._stepped = time.monotonic()
        if place.port_link:
            self._clock_out = topics.advertise(ClockMsg, "/clock", RELIABLE)
            make = plugin(SIMULATIONS, place.controller)
            self._controller = make(lambda: self._elapsed, travel=stage.stroke, max_speed=stage.max_speed)
            self._controller.start()
            link = pathlib.Path(place.port_link)
            link.unlink(missing_ok=True)
            link.symlink_to(self._controller.port)  # a pseudo-terminal, whose name is not known beforehand
            period, step = 1 / (config.frame_rate * STEPS_PER_FRAME) / run.speed, self._step
        else:
            topics.subscribe(PusherState, "pusher_state", self._on_pusher_state, RELIABLE)
            period, step = 1 / config.frame_rate, self._follow
        wall_timer(self, period, step)

    def wind_up(self) -> bool:
        """True once the actuator has left the port: a controller that went first would look like a lost one."""
        return self._controller is None or not self._controller.opened

    def destroy_node(self) -> None:
        """Remove the simulated serial port, too."""
        if self._controller is not None:
            pathlib.Path(self._place.port_link).unlink(missing_ok=True)
            self._controller.close()
        super().destroy_node()

    def _step(self) -> None:
        """Advance by one step of simulated time, but not far beyond what the actuator has noticed."""
        assert self._controller is not None
        now = time.monotonic()
        if self._controller.unasked() > OVERDUE / self._place.poll_rate and now - self._stepped < OVERDUE_STEP:
            return
        self._stepped = now
        self._steps += 1
        self._elapsed = self._steps / (self._config.frame_rate * STEPS_PER_FRAME)
        stamp = START + round(self._elapsed * 1e9)
        self._operate()
        self._controller.hold_in_reset(self._switched["emergency_stop"])
        self._push(self._controller.position())
        self._clock_out.publish(ClockMsg(clock=stamp_to_msg(stamp)))
        if self._steps % STEPS_PER_FRAME == 0:
            self._publish_frame(stamp)

    def _follow(self) -> None:
        """With a real controller, in real time: publish a frame of what was there a moment ago, as far as that is reported."""
        then = self.get_clock().now().nanoseconds - round(LAG * 1e9)
        self._elapsed = time.monotonic() - self._wall_start
        self._operate()
        if self._reports:
            stamps, positions = zip(*self._reports, strict=True)
            then = min(then, stamps[-1])  # reports of a busy machine are late
            first = stamps[0]  # differences of stamps are exact as floats, stamps are not
            self._push(float(np.interp(then - first, [stamp - first for stamp in stamps], positions)))
        if then > self._shown:
            self._shown = then
            self._publish_frame(then)

    def _on_pusher_state(self, msg: PusherState) -> None:
        try:
            sample = pusher_sample_from_msg(msg)
        except ValueError as error:
            self.get_logger().error(f"pusher_state refused: {error}", once=True)
            return
        if not self._reports or sample.stamp > self._reports[-1][0]:
            self._reports.append((sample.stamp, msg.position))

    def _push(self, position: float) -> None:
        """Move the tip to a stroke position [m], and the object out of its way."""
        if self._present:
            try:
                self._object.push(self._line, position)
            except SolverFailed as error:
                self.get_logger().error(f"the object was taken away: {error}")
                self._present = False

    def _operate(self) -> None:
        """Put the object down once the operator has held it long enough."""
        if self._placing is not None and self._elapsed >= self._placing[0]:
            self._object.pose, self._placing, self._present = self._placing[1], None, True

    def _publish_frame(self, stamp: int) -> None:
        if self._switched["unplug"]:
            return
        image = image_to_msg(self._camera.render(self._object.pose if self._present else None), stamp)
        self._info.header = image.header
        self._image_out.publish(image)
        self._info_out.publish(self._info)

    def _on_placement(self, msg: PoseStamped) -> None:
        """Take the object away and put it almost in its place, as a human operator would."""
        try:
            wanted = pose_from_msg(msg.pose)
        except ValueError as error:
            self.get_logger().error(f"placement ignored: {error}")
            return
        off = self._config.placement_error
        x = y = turn = 0.0
        while math.hypot(x, y) < off:  # never right by chance
            x, y, turn = self._rng.normal(0.0, off, 3).clip(-2 * off, 2 * off)
        self._present = False
        turn = min(max(turn / 0.02, -ASKEW), ASKEW)
        self._placing = (self._elapsed + self._config.away, Pose(wanted.x + x, wanted.y + y, wanted.theta + turn))

    def _on_hand(self, msg: PoseStamped) -> None:
        """Have the object where a person lays it in the view."""
        try:
            self._object.pose = pose_from_msg(msg.pose)
        except ValueError as error:
            self.get_logger().error(f"hand ignored: {error}")
            return
        self._placing, self._present = None, True

    def _on_switch(self, msg: String) -> None:
        """Turn a switch over, as a person at the cell does; a real controller has an emergency stop of its own."""
        if msg.data in SWITCHES and not (msg.data == "emergency_stop" and self._controller is None):
            self._switched[msg.data] = not self._switched[msg.data]
            self._camera.lit = not self._switched["lamp"]

    def _health(self) -> Health:
        speed = self._elapsed / max(time.monotonic() - self._wall_start, 1e-9)
        values: dict[str, Any] = {"simulated time [s]": round(self._elapsed, 3), "multiple of real time": round(speed, 2)}
        values |= {name: SWITCHES[name][turned] for name, turned in self._switched.items()}
        turned = "; ".join(SWITCHES[name][True] for name in SWITCHES if self._switched[name])
        return Health(Level.WARN if turned else Level.OK, turned or "simulating", values)


def pushed_object(name: str, contact_friction: float) -> PushedObject:
    """The object that is pushed: one of Table 1 as it is, or one from a file, with equal weights on its support points.

    Args:
        name: of the object of Table 1, or path of its file.
        contact_friction: mu_c of an object from a file.
    Raises:
        InvalidInput: there is no such object.
    """
    model = load_object(name)
    if name in TABLE_1:
        support, mu_c = TABLE_1[name].support, TABLE_1[name].mu_c
    else:
        count = len(model.support_points)
        support, mu_c = Support(model.support_points, np.full(count, 1 / count)), contact_friction
    return PushedObject(model.outline, support, mu_c, Pose(0.0, 0.0, 0.0))


def main() -> None:
    run_node(SimulatedCellNode, winds_up=True, images=True)
