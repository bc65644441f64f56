"""The simulated cell: physics, camera, GRBL controller and operator behind the real interfaces; it publishes the clock."""

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
from pushfric_core.settings import REQUIRED, setting
from pushfric_core.simulation import PushedObject
from pushfric_core.table_1 import TABLE_1
from pushfric_ros.files.node_settings import FrameConfig, ObjectConfig, SimulatedRunConfig, SimulationConfig
from pushfric_ros.messages.conversions import pose_from_msg, stamp_to_msg
from pushfric_ros.messages.frames import CAMERA
from pushfric_ros.node_kit import executable
from pushfric_ros.node_kit.diagnostics import Diagnostics, Health, Level
from pushfric_ros.node_kit.parameters import declare
from pushfric_ros.node_kit.process import run_node
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE, SENSOR_DATA
from pushfric_ros.pushers.pusher import StageConfig
from pushfric_ros.simulated.camera import SimulatedCamera
from pushfric_ros.simulated.grbl_firmware import SimulatedGrbl
from pushfric_ros.vision.camera import load_camera

STEPS_PER_FRAME = 4
"""Number of physics steps, and of ticks of /clock, from one frame to the next."""

START = 1_000_000_000_000_000_000
"""Simulated time begins here [ns], so that no stamp looks like the 0 of a missing stamp."""


@dataclass(frozen=True)
class SimulatedCellConfig:
    """Where the simulated camera and controller take the place of real ones."""

    calibration: str = setting(REQUIRED, "path of the camera's calibration YAML")
    port_link: str = setting(REQUIRED, "path at which the controller's serial port appears")

    def __post_init__(self) -> None:
        if not self.calibration:
            raise ValueError("calibration must name the camera's calibration YAML, got ''")
        if not self.port_link or not pathlib.Path(self.port_link).parent.is_dir():
            raise ValueError(f"port_link must be a path in an existing folder, got {self.port_link!r}")


class SimulatedCellNode(Node):
    """Steps the simulation from a wall-clock timer and publishes /clock."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("simulated_cell", **kwargs)
        self._place = place = declare(self, SimulatedCellConfig)
        name, stage, run = declare(self, ObjectConfig).object, declare(self, StageConfig), declare(self, SimulatedRunConfig)
        self._config = config = declare(self, SimulationConfig)
        if name not in TABLE_1:
            raise InvalidInput(f"the simulated cell has no object {name!r}; expected one of {', '.join(TABLE_1)}")
        truth = TABLE_1[name]
        self._rng = np.random.default_rng(run.seed)
        self._line = pushing_line(stage.line_origin, stage.line_direction, stage.tip_radius)
        self._object = PushedObject(truth.outline, truth.support, truth.mu_c, Pose(0.0, 0.0, 0.0))
        self._present = False
        self._placing: tuple[float, Pose] | None = None  # (when [s], where)
        self._elapsed = 0.0
        self._steps = 0
        camera = load_camera(place.calibration)
        self._camera = SimulatedCamera(
            camera, truth.outline.vertices, 0.0, self._rng, noise_sigma=config.noise, blur_px=config.blur
        )
        self._info = CameraInfo(**camera.info_fields())
        self._diagnostics = topics = Diagnostics(self, self._health, declare(self, FrameConfig).within(self.get_namespace()))
        self._clock_out = topics.advertise(ClockMsg, "/clock", RELIABLE)
        self._image_out = topics.advertise(Image, "image_raw", SENSOR_DATA)
        self._info_out = topics.advertise(CameraInfo, "camera_info", SENSOR_DATA)
        self.create_subscription(PoseStamped, "placement", self._on_placement, LATCHED)
        self._grbl = SimulatedGrbl(lambda: self._elapsed, travel=stage.stroke, max_speed=stage.max_speed)
        self._grbl.start()
        self._link(place.port_link)
        period = 1 / (config.frame_rate * STEPS_PER_FRAME)
        self._period = period
        self._wall_start = time.monotonic()
        self.create_timer(period / run.speed, self._step, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def destroy_node(self) -> None:
        """Remove the serial port, too."""
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self._place.port_link)
        self._grbl.close()
        super().destroy_node()

    def _link(self, path: str) -> None:
        """Link the pseudo-terminal, whose name is not known beforehand, to a known path."""
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
        """Put the object down once the operator has held it long enough."""
        if self._placing is not None and self._elapsed >= self._placing[0]:
            self._object.pose, self._placing, self._present = self._placing[1], None, True

    def _publish_frame(self, stamp: Any) -> None:
        frame = self._camera.render(self._object.pose if self._present else None)
        height, width = frame.shape
        image = Image(height=height, width=width, encoding="mono8", step=width)
        image.header.frame_id, image.header.stamp = CAMERA, stamp
        image.data = array.array("B", frame.tobytes())
        self._info.header = image.header
        self._image_out.publish(image)
        self._info_out.publish(self._info)

    def _on_placement(self, msg: PoseStamped) -> None:
        """Take the object away and put it almost where it is wanted, as a human operator would."""
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
    run_node(SimulatedCellNode, images=True)


if __name__ == "__main__":
    executable.main()
