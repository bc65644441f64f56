"""The samples of the two streams, the frames in which they show a push, and how these become observations."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pushfric_core.geometry.contact import PushingLine
from pushfric_core.geometry.planar import Array, Pose
from pushfric_core.settings import check_ranges, setting


class PoseSample(NamedTuple):
    """Where the object was seen.

    Example:
        >>> from pushfric_core import Pose, PoseSample
        >>> PoseSample(stamp=1_000_000_000, pose=Pose(0.1, 0.2, 0.0)).pose.x
        0.1
    """

    stamp: int  # of the image [ns]
    pose: Pose  # of the object in the table frame


class PusherSample(NamedTuple):
    """A report of the pusher.

    Example:
        >>> from pushfric_core import PusherSample, PushingLine
        >>> line = PushingLine(origin=(0.0, -0.1), direction=(0.0, 1.0), tip_radius=0.003)
        >>> PusherSample(1_000_000_000, 0.075, 0.02, line, push_id=0).tip.round(3).tolist()
        [0.0, -0.025]
    """

    stamp: int  # [ns]
    position: float  # stroke [m]
    speed: float  # along the line [m/s]
    line: PushingLine  # of a tip that moves freely: through the tip, along its velocity
    push_id: int | None  # None between pushes and while retracting

    @property
    def tip(self) -> Array:
        """The centre of the tip (2,), table frame [m]."""
        (x, y), (along_x, along_y) = self.line.origin, self.line.direction
        return np.array((x + self.position * along_x, y + self.position * along_y))


class ContactFrame(NamedTuple):
    """A frame in contact, and the tip that pushed."""

    stamp: int
    pose: Pose
    pusher: PusherSample  # the report before it
    tip: Array  # (2,) where it was, table frame [m]
    speed: float  # of the tip along its line [m/s]
    doubt: float  # the reports leave that open by this much [m/s]
    steady: bool  # whether the reports before and after have the same speed
    free: bool  # whether the reports before and after differ in their lines


@dataclass(frozen=True)
class TrajectoryConfig:
    """How poses become observations; the defaults are the paper's.

    Example:
        >>> from pushfric_core import Outline, Trajectory, TrajectoryConfig
        >>> trajectory = Trajectory(Outline.rectangle(0.12, 0.06), TrajectoryConfig(window=7))
        >>> trajectory.config.stride
        5
    """

    window: int = setting(5, "frames in the centred window that smooths the poses; odd", 1, 101)
    stride: int = setting(5, "frames from one observation of a push to the next", 1, 1000)
    contact_tolerance: float = setting(0.001, "the tip counts as touching up to this far from the outline [m]", 0.0, 0.1)
    minimum_speed: float = setting(0.002, "the object counts as moving if its fastest corner is this fast [m/s]", 0.0, 10.0)
    longest_gap: float = setting(0.5, "frames further apart than this end a run of observations [s]", 0.0, 60.0)
    pose_lag: float = setting(0.0, "poses are stamped this much too late against the pusher states [s]", -1.0, 1.0)

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.window % 2 == 0:
            raise ValueError(f"window must be odd, to be centred on a frame, got {self.window}")
