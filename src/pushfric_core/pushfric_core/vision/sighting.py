"""The result of a tracker for a frame, and the protocol of every tracker."""

from typing import TYPE_CHECKING, NamedTuple, Protocol

from pushfric_core.errors import PushfricError
from pushfric_core.geometry.planar import Array, Pose

if TYPE_CHECKING:
    from pushfric_core.files.object_file import ObjectModel
    from pushfric_core.vision.camera import Camera, Image

UNMEASURED = 1e3
"""Variance of height, roll and pitch [m^2, rad^2], which the tracker does not measure: it takes them to be 0.

A variance of 0 would claim that they are exact. Filters ignore a coordinate with a variance of this order since robot_pose_ekf
(robot_localization: "Migrating from robot_pose_ekf"); the -1 of sensor_msgs/Imu stands for a whole matrix.
"""


NO_OBJECT = "no object"
"""Why an object is not seen where there is none."""


class NotSeen(PushfricError):
    """A frame does not show where the object is; the text says why."""


class Sighting(NamedTuple):
    """The object as seen in one frame."""

    pose: Pose  # in the table frame
    residual_px: float  # rms distance between what was found and its place in this pose
    visible_fraction: float  # found fraction of what can be found
    orientations: int  # number of orientations that fit equally well
    covariance: Array  # (3, 3) of (x, y, theta) in the table frame [m, m, rad]
    size: float | None = None  # how large it looks, relative to its file; None: not measured, for example with a hidden edge
    doubt: str = ""  # what does not quite fit although the pose can be used, with the likely cause; empty: nothing


class Tracker(Protocol):
    """Finds one object in the images of one camera."""

    def track(self, image: "Image", expected: Pose | None = None) -> Sighting:
        """The object's pose in one frame.

        Args:
            image: (height, width) mono8 frame, the size of the camera's.
            expected: approximate pose, in the table frame; of orientations that look alike, the nearest is taken.
        Raises:
            NotSeen: the frame does not show where the object is.
        """


class TrackerDriver(Protocol):
    """The settings of one kind of tracker, which open it: a frozen dataclass of `pushfric_core.settings.setting` fields.

    The class is an entry point of the group `pushfric.trackers`; its name there is the setting `tracker` of CameraConfig. Its
    settings stand next to those of CameraConfig, in a cell's file and as parameters of the tracker: no name may occur twice.
    """

    def open_tracker(self, camera: "Camera", model: "ObjectModel", height: float) -> Tracker:
        """A tracker of an object whose outline or markers are `height` [m] over the table.

        Raises:
            InvalidInput: the object cannot be found in this camera's images, or a file that the settings name is wrong.
        """

    def absence(self) -> str | None:
        """The need of the tracker before it can find anything, such as the name of a file, as a line of text; None if none."""
