"""The settings of the nodes; each class is a section of a cell's file, or is given by the command line.

The settings of the pusher are in pushers/pusher.py and its driver, those of trackers in vision/, and those of the estimator in
pushfric_core and in estimator_settings.py.
"""

import enum
import math
from dataclasses import dataclass
from typing import NamedTuple

from pushfric_core.settings import AUTO, REQUIRED, check_ranges, setting
from pushfric_ros.messages.qos import QUALITIES


@dataclass(frozen=True)
class ObjectConfig:
    """What is pushed."""

    object: str = setting(REQUIRED, "name of an object of Table 1, or path of an object YAML", path=True)


@dataclass(frozen=True)
class CameraConfig:
    """Where images come from, how they map to the table, and what finds the object in them. Section `camera`."""

    calibration: str = setting(
        REQUIRED, "path of the camera's calibration YAML: CameraInfo's fields and table_homography", path=True
    )
    source: str = setting(
        "0",
        "topic: image_raw; compressed: image_raw/compressed; else a device index, URL, video file, folder or glob of pictures",
    )
    object_height: float = setting(0.0, "of the outline or markers over the table [m]; 0: as the object's file says", 0.0, 1.0)
    time_offset: float = setting(0.0, "added to the stamps of the images [s]", -10.0, 10.0)
    tracker: str = setting(
        AUTO,
        "what finds the object: contour, fiducial, or another entry point of the group pushfric.trackers; "
        f"{AUTO}: fiducial if fiducials is given, else contour",
    )

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.calibration:
            raise ValueError("calibration must name the camera's calibration YAML, got ''")


@dataclass(frozen=True)
class ExperimentConfig:
    """Where a plan begins; the command line's to give."""

    start: int = setting(1, "push of the plan to begin with, to continue an interrupted one", 1, 2**31)

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True)
class PlanConfig:
    """What is pushed where, and when the object counts as placed. Section `plan`."""

    plan: str = setting(
        "", "path of a push plan; empty: the paper's plan, or a few pushes along each edge", key="file", path=True
    )
    choose: int = setting(
        0, "number of pushes to choose one by one, to shrink the region of p_CF fastest; 0: those of the plan", 0, 1000
    )
    distance: float = setting(0.05, "length of a push [m]", 0.001, 10.0)
    speed: float = setting(0.02, "speed of a push [m/s]", 0.0001, 1.0)
    gap: float = setting(0.005, "distance from the resting tip to the object when it is placed [m]", 0.0, 0.1)
    position_tolerance: float = setting(0.01, "the object may lie this far from its place [m]", 0.0, 1.0)
    angle_tolerance: float = setting(0.2, "the object may be turned by this much from what is wanted [rad]", 0.0, math.pi)
    still: float = setting(0.5, "the object must lie still for this long [s]", 0.0, 60.0)
    still_distance: float = setting(0.0005, "still: moved less than this [m], turned less than it over 10 cm", 0.0, 0.1)
    awaits: tuple[str, ...] = setting(
        ("estimator", "recorder"), "nodes that must report that they are well before the first push"
    )
    lost_object: float = setting(1.0, "a push is stopped when the object is unseen for this long, of wall time [s]", 0.1, 60.0)
    lost_result: float = setting(
        3.0, "a push is given up when the pusher idles or is silent for this long, of wall time [s]", 0.1, 60.0
    )

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.plan and self.choose:
            raise ValueError(f"give a plan's file or choose, not both, got {self.plan!r} and {self.choose}")


class KnownTopic(NamedTuple):
    """A topic that is subscribed at once, before anyone publishes it."""

    name: str
    type_name: str
    quality: str  # one of QUALITIES


@dataclass(frozen=True)
class RecorderConfig:
    """What is recorded. Section `recorder`, whose topics are recorded besides those of the cell."""

    topics: tuple[str, ...] = setting((), f"each 'name package/msg/Type qos', qos one of {', '.join(QUALITIES)}")
    discover: bool = setting(False, "record every other topic too, from when it is first seen")

    def __post_init__(self) -> None:
        names = [topic.name for topic in self.known_topics]
        if len(set(names)) < len(names):
            raise ValueError(f"topics must name each topic once, got {', '.join(names)}")

    @property
    def known_topics(self) -> list[KnownTopic]:
        """The topics, parsed.

        Raises:
            ValueError: one is not 'name type qos'.
        """
        return [_known_topic(text) for text in self.topics if text]


def _known_topic(text: str) -> KnownTopic:
    words = text.split()
    if len(words) != 3 or words[2] not in QUALITIES:
        raise ValueError(f"topics must be 'name package/msg/Type {'|'.join(QUALITIES)}', got {text!r}")
    return KnownTopic(*words)


@dataclass(frozen=True)
class RecordingConfig:
    """Where a recording goes; the command line's to give."""

    bag: str = setting(REQUIRED, "folder of the bag, new or empty")
    object: str = setting("", "written into the bag's folder: name of an object of Table 1, or path of an object YAML")

    def __post_init__(self) -> None:
        if not self.bag:
            raise ValueError("bag must name the folder to record into, got ''")


@dataclass(frozen=True)
class PlayerConfig:
    """What is played, and how fast; the command line's to give."""

    bag: str = setting(REQUIRED, "folder of the bag, or one of its files")
    rate: float = setting(1.0, "multiple of the recorded speed", 0.01, 1000.0)
    partial: bool = setting(False, "play a damaged bag, of which messages are missing, all the same")
    start: float = setting(0.0, "where to begin, after the beginning of the bag [s]", 0.0)
    loop: bool = setting(False, "start again at the end; the clock jumps back")
    topics: tuple[str, ...] = setting((), "topics to play; none: all")
    exclude_topics: tuple[str, ...] = setting((), "topics not to play")
    clock: bool = setting(True, "publish the bag's time on /clock, 100 times in a second of the bag")
    wait_for: tuple[str, ...] = setting((), "topics that must have a subscriber before the first message")
    paused: bool = setting(False, "begin paused, until ~/pause says otherwise")
    exit_when_done: bool = setting(True, "end the process when all is played and acknowledged")

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.bag:
            raise ValueError("bag must name the bag to play, got ''")


class DataPointSource(enum.Enum):
    """Where the estimator's data points come from."""

    POSES = "poses"
    OBSERVATIONS = "observations"


@dataclass(frozen=True)
class EstimatorNodeConfig:
    """Where the data points come from; the graph's to give."""

    source: DataPointSource = setting(
        DataPointSource.POSES, "poses: data points from object_pose and pusher_state; observations: from that topic"
    )


@dataclass(frozen=True)
class SimulationConfig:
    """What is simulated, and how well. Section `simulation`."""

    frame_rate: float = setting(14.0, "frames of the camera [Hz]", 0.1, 200.0)
    noise: float = setting(
        2.0, "standard deviation of a pixel's noise, of 255 grey levels; without noise, a camera seems frozen", 0.5, 100.0
    )
    blur: float = setting(0.7, "standard deviation of the lens's blur [px]", 0.0, 10.0)
    away: float = setting(0.3, "time for which the operator holds the object out of view when placing it [s]", 0.0, 10.0)
    placement_error: float = setting(
        0.001, "standard deviation of the operator's placement [m]; the angle errs by this over 2 cm", 0.0, 0.1
    )

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True)
class SimulatedRunConfig:
    """Which run of the simulation; the command line's to give."""

    seed: int = setting(0, "seed of the camera's noise and the operator's hand", 0, 2**31)
    speed: float = setting(
        5.0, "multiple of real time; a slow machine slows the simulated clock down and loses nothing", 0.01, 100.0
    )

    def __post_init__(self) -> None:
        check_ranges(self)
