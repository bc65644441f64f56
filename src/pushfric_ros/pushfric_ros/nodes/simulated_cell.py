"""The simulated cell: physics, camera, GRBL controller and operator behind the interfaces of the real ones; keeps the clock."""

import array
import contextlib
import os
import pathlib
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMsg
from sensor_msgs.msg import CameraInfo, Image

from pushfric_core.contact import pushing_line
from pushfric_core.errors import InvalidInput, SolverFailed
from pushfric_core.planar import Pose
from pushfric_core.settings import setting
from pushfric_core.simulation import TABLE_1, PushedObject
from pushfric_ros.messages.conversions import pose_from_msg, stamp_to_msg
from pushfric_ros.node_kit.diagnostics import Diagnostics, Health, Level
from pushfric_ros.node_kit.image_memory import make_room_for_images
from pushfric_ros.node_kit.parameters import declare
from pushfric_ros.node_kit.process import run_node
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE, SENSOR_DATA
from pushfric_ros.pushers.pusher import PusherConfig
from pushfric_ros.simulated.camera import SimulatedCamera
from pushfric_ros.simulated.grbl_firmware import SimulatedGrbl
from pushfric_ros.vision.camera import load_camera

STEPS_PER_FRAME = 4
"""Steps of the physics, and ticks of /clock, from one frame to the next."""

START = 1_000_000_000_000_000_000
"""Simulated time begins here [ns], so that no stamp looks like the 0 of a missing one."""


@dataclass(frozen=True)
class SimulatedCellConfig:
    """The cell that is simulated."""

    object: str = setting("rubber_rect4", "name of an object of Table 1")
    calibration: str = setting("", "path of the camera's calibration YAML")
    port_link: str = setting("", "path at which the controller's serial port appears")
    line_origin: tuple[float, ...] = setting(
        PusherConfig.line_origin, "centre of the tip at stroke position 0, in the table frame [m]"
    )
    line_direction: tuple[float, ...] = setting(
        PusherConfig.line_direction, "unit vector of the forward stroke, in the table frame"
    )
    tip_radius: float = setting(PusherConfig.tip_radius, "[m]", 0.0, 0.1)
    stroke: float = setting(PusherConfig.stroke, "travel of the linear stage [m]", 0.001, 10.0)
    max_speed: float = setting(PusherConfig.max_speed, "of the linear stage [m/s]", 0.0001, 10.0)
    frame_rate: float = setting(14.0, "of the camera [Hz]", 0.1, 200.0)
    speed: float = setting(
        5.0, "multiple of real time; a slower machine slows the simulated clock, and loses nothing", 0.01, 100.0
    )
    noise: float = setting(2.0, "of a pixel, standard deviation, of 255; a camera without any would seem frozen", 0.5, 100.0)
    blur: float = setting(0.7, "of the lens, standard deviation [px]", 0.0, 10.0)
    away: float = setting(0.3, "the operator holds the object out of view for this long when placing it [s]", 0.0, 10.0)
    placement_error: float = setting(0.001, "of the operator, standard deviation [m]; the angle errs by it over 2 cm", 0.0, 0.1)
    seed: int = setting(0, "of camera noise and operator", 0, 2**31)

    def __post_init__(self) -> None:
        if not self.calibration:
            raise ValueError("calibration must name the camera's calibration YAML, got nothing")
        pushing_line(self.line_origin, self.line_direction, self.tip_radius)
        if not pathlib.Path(self.port_link or "/").parent.is_dir() or not self.port_link:
            raise ValueError(f"port_link must be a path in an existing folder, got {self.port_link!r}")


class SimulatedCellNode(Node):
    """Steps the simulation from a wall-clock timer and publishes /clock."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("simulated_cell", **kwargs)
        self._config = config = declare(self, SimulatedCellConfig)
        if config.object not in TABLE_1:
            raise InvalidInput(f"the simulated cell has no object {config.object!r}; expected one of {', '.join(TABLE_1)}")
        truth = TABLE_1[config.object]
        self._rng = np.random.default_rng(config.seed)
        self._line = pushing_line(config.line_origin, config.line_direction, config.tip_radius)
        self._object = PushedObject(truth.outline, truth.support, truth.mu_c, Pose(0.0, 0.0, 0.0))
        self._present = False
        self._placing: tuple[float, Pose] | None = None  # when [s], and where
        self._elapsed = 0.0
        self._steps = 0
        camera = load_camera(config.calibration)
        self._camera = SimulatedCamera(
            camera, truth.outline.vertices, 0.0, self._rng, noise_sigma=config.noise, blur_px=config.blur
        )
        self._info = CameraInfo(**camera.info_fields())
        self._diagnostics = topics = Diagnostics(self, self._health)
        self._clock_out = topics.advertise(ClockMsg, "/clock", RELIABLE)
        self._image_out = topics.advertise(Image, "image_raw", SENSOR_DATA)
        self._info_out = topics.advertise(CameraInfo, "camera_info", SENSOR_DATA)
        self.create_subscription(PoseStamped, "placement", self._on_placement, LATCHED)
        self._grbl = SimulatedGrbl(lambda: self._elapsed, travel=config.stroke, max_speed=config.max_speed)
        self._grbl.start()
        self._link(config.port_link)
        period = 1 / (config.frame_rate * STEPS_PER_FRAME)
        self._period = period
        self._wall_start = time.monotonic()
        self.create_timer(period / config.speed, self._step, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def destroy_node(self) -> None:
        """Take the serial port away with the node."""
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self._config.port_link)
        self._grbl.close()
        super().destroy_node()

    def _link(self, path: str) -> None:
        """Let the pseudo-terminal, whose name nobody can know beforehand, appear under a known one."""
        with contextlib.suppress(FileNotFoundError):
            os.unlink(path)
        os.symlink(self._grbl.port, path)

    def _step(self) -> None:
        self._steps += 1
        self._elapsed = self._steps * self._period
        stamp = stamp_to_msg(START + round(self._elapsed * 1e9))
        self._operate()
        if self._present:
            try:
                self._object.push(self._line, self._grbl.position())
            except SolverFailed as error:
                self.get_logger().error(f"the object was taken away: {error}")
                self._present = False
        self._clock_out.publish(ClockMsg(clock=stamp))
        if self._steps % STEPS_PER_FRAME == 0:
            self._publish_frame(stamp)

    def _operate(self) -> None:
        """Put the object down once the operator's hand has been away with it long enough."""
        if self._placing is not None and self._elapsed >= self._placing[0]:
            self._object.pose, self._placing, self._present = self._placing[1], None, True

    def _publish_frame(self, stamp: Any) -> None:
        frame = self._camera.render(self._object.pose if self._present else None)
        height, width = frame.shape
        image = Image(height=height, width=width, encoding="mono8", step=width)
        image.header.frame_id, image.header.stamp = "camera", stamp
        image.data = array.array("B", frame.tobytes())
        self._info.header = image.header
        self._image_out.publish(image)
        self._info_out.publish(self._info)

    def _on_placement(self, msg: PoseStamped) -> None:
        """Do as a human operator would: take the object away and put it where it is wanted, nearly."""
        try:
            wanted = pose_from_msg(msg.pose)
        except ValueError as error:
            self.get_logger().error(f"placement ignored: {error}")
            return
        x, y, turn = self._rng.normal(0.0, self._config.placement_error, 3).clip(*self._reach())
        self._present = False
        self._placing = (self._elapsed + self._config.away, Pose(wanted.x + x, wanted.y + y, wanted.theta + turn / 0.02))

    def _reach(self) -> tuple[float, float]:
        return -2 * self._config.placement_error, 2 * self._config.placement_error

    def _health(self) -> Health:
        speed = self._elapsed / max(time.monotonic() - self._wall_start, 1e-9)
        values = {"simulated time [s]": round(self._elapsed, 3), "multiple of real time": round(speed, 2)}
        return Health(Level.OK, "simulating", values)


def main() -> None:
    make_room_for_images()
    run_node(SimulatedCellNode)
