"""The settings of the nodes; each class is a section of a cell's file, or is given by the command line.

The settings of the pusher are in pushers/pusher.py and its driver, those of trackers in vision/, and those of the estimator in
pushfric_core and in estimator_settings.py.
"""

import dataclasses
import enum
import ipaddress
import math
import re
import secrets
from dataclasses import dataclass
from typing import NamedTuple

from pushfric_core.settings import AUTO, REQUIRED, Ranged, check_ranges, setting

LOOPBACK = "127.0.0.1"
"""Only this machine reaches it."""

VIEW_PORT = 8088
"""Default port of the live view."""


class Discovery(enum.Enum):
    """Who can reach the nodes of a cell; the names are those of ROS_AUTOMATIC_DISCOVERY_RANGE."""

    LOCALHOST = "localhost"
    SUBNET = "subnet"


NAMESPACE = "/cell"
"""Default namespace of a cell."""

QUALITIES = ("sensor_data", "reliable", "latched")
"""The qualities of service that a publisher of the cell may have."""


@dataclass(frozen=True)
class CellConfig:
    """The cell's name, and who can reach it."""

    namespace: str = setting(NAMESPACE, "namespace of all nodes and topics; each cell needs its own")
    discovery: Discovery = setting(
        Discovery.LOCALHOST,
        "who can reach the nodes, and so move the pusher: localhost: programs on this machine; subnet: on its network too",
    )

    def __post_init__(self) -> None:
        if re.fullmatch("(/[A-Za-z_][A-Za-z0-9_]*)+", self.namespace) is None:
            raise ValueError(f"namespace must be like {NAMESPACE} or /hall/cell_2, got {self.namespace!r}")


@dataclass(frozen=True)
class FrameConfig:
    """Names of the frames of a cell."""

    frame_prefix: str = setting(
        AUTO, f"put before the names of the frames, such as left/; {AUTO}: nothing in {NAMESPACE}, otherwise the namespace"
    )

    def __post_init__(self) -> None:
        if re.fullmatch("([A-Za-z0-9_]+/)*", self.frame_prefix) is None and self.frame_prefix != AUTO:
            raise ValueError(f"frame_prefix must be like left/ or empty, got {self.frame_prefix!r}")

    def within(self, namespace: str) -> str:
        """The prefix in a namespace, so that two cells do not publish transforms of one frame."""
        if self.frame_prefix != AUTO:
            return self.frame_prefix
        return "" if namespace in ("/", NAMESPACE) else f"{namespace[1:]}/"


@dataclass(frozen=True)
class ObjectConfig:
    """The pushed object."""

    object: str = setting(REQUIRED, "name of an object of Table 1, or path of an object YAML", path=True)


@dataclass(frozen=True)
class CameraConfig(Ranged):
    """The source of images, how they map to the table, and which tracker finds the object in them. Section `camera`."""

    calibration: str = setting(
        REQUIRED,
        "path of the camera's calibration YAML: CameraInfo's fields and table_homography",
        path=True,
        names="the camera's calibration YAML",
    )
    source: str = setting(
        "0",
        "topic: image_raw; compressed: image_raw/compressed; else a device index, URL, video file, folder or glob of pictures",
    )
    object_height: float = setting(
        0.0, "height of the outline or markers over the table [m]; 0: as in the object's file", 0.0, 1.0
    )
    time_offset: float = setting(0.0, "time added to the stamps of the images [s]", -10.0, 10.0)
    tracker: str = setting(
        AUTO,
        "how the object is found: contour, fiducial, or another entry point of the group pushfric.trackers; "
        f"{AUTO}: fiducial if fiducials is given, else contour",
    )


@dataclass(frozen=True)
class RequiredSubscribersConfig:
    """The nodes that must not miss a pose. From the graph."""

    heard_by: tuple[str, ...] = setting((), "nodes that must receive the poses before the first one is published")


@dataclass(frozen=True)
class TipConfig(Ranged):
    """The tip that another robot moves. Section `tip`."""

    tip_radius: float = setting(REQUIRED, "of the round tip [m]", 0.0, 1.0)
    near: float = setting(0.01, "a push lasts while the tip is this near to the object [m]", 0.0, 1.0)


@dataclass(frozen=True)
class TipNodeConfig:
    """The bag from which a restarted tip source goes on. From the graph."""

    bag: str = setting("", "folder of the run's bag, from which a restarted node continues the numbers of pushes; empty: none")


@dataclass(frozen=True)
class ExperimentConfig(Ranged):
    """Where a plan begins, from the command line; and what the graph knows of the other nodes and of who is there."""

    start: int = setting(1, "number of the first push, to continue an interrupted plan", 1, 2**31)
    lifeless: float = setting(
        1.0, "no push begins if the last heartbeat of an awaited node is older than this; as requires_timeout [s]", 0.1, 60.0
    )
    attended: bool = setting(True, "somebody is there to end an alarm of the pusher; otherwise it ends the run")


@dataclass(frozen=True)
class PlanConfig:
    """The push plan, and when the object counts as placed. Section `plan`."""

    plan: str = setting(
        "",
        "path of a push plan; empty: a few pushes along each edge, as the paper's for an object of Table 1, four of which slip",
        key="file",
        path=True,
    )
    choose: int = setting(
        0, "number of pushes to choose one by one, to shrink the region of p_CF fastest; 0: the pushes of the plan", 0, 1000
    )
    distance: float = setting(0.05, "length of a push [m]", 0.001, 10.0)
    speed: float = setting(0.02, "speed of a push [m/s]", 0.0001, 1.0)
    gap: float = setting(0.005, "distance from the resting tip to the object when it is placed [m]", 0.0, 0.1)
    position_tolerance: float = setting(0.01, "greatest distance of the placed object from its place [m]", 0.0, 1.0)
    angle_tolerance: float = setting(0.2, "greatest error of the placed object's angle [rad]", 0.0, math.pi)
    still: float = setting(0.5, "the object must lie still for this long [s]", 0.0, 60.0)
    still_distance: float = setting(
        0.0005, "an object lies still if it moves by less than this [m] and turns by less than this over 10 cm", 0.0, 0.1
    )
    awaits: tuple[str, ...] = setting(("estimator", "recorder"), "nodes whose diagnostics must be OK before the first push")
    clock_tolerance: float = setting(
        2.0, "the stamps of poses and of the pusher may differ by this much from this computer's time [s]", 0.01, 1e4
    )
    follow_tolerance: float = setting(
        0.005,
        "a push is stopped when the object, as it is seen, is this far from where the pusher must have put it [m]",
        0.001,
        10.0,
    )
    lost_object: float = setting(1.0, "a push is stopped when the object is not seen for this long [s of wall time]", 0.1, 60.0)
    lost_result: float = setting(
        3.0, "a push is given up when the pusher idles or is silent for this long [s of wall time]", 0.1, 60.0
    )

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.plan and self.choose:
            raise ValueError(f"give a plan's file or choose, not both, got {self.plan!r} and {self.choose}")


class KnownTopic(NamedTuple):
    """A topic that the recorder subscribes to at once, before anyone publishes it."""

    name: str
    type_name: str
    quality: str  # one of QUALITIES


@dataclass(frozen=True)
class RecorderConfig:
    """Recordings in addition to the cell's topics. Section `recorder`."""

    topics: tuple[str, ...] = setting(
        (), f"more topics, each 'name package/msg/Type qos' with qos one of {', '.join(QUALITIES)}"
    )
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


SWITCHES = {
    "lamp": ("the lamp is on", "the lamp is off"),
    "unplug": ("the camera is plugged in", "the camera is unplugged"),
    "emergency_stop": ("the emergency stop is released", "the emergency stop is pressed"),
}
"""The switches that a person at a simulated cell can turn over: what each says at first, and then."""


REPORT_FILE = "report.html"
"""File in a bag's folder: the result of the run, as a page."""


@dataclass(frozen=True)
class ShownConfig:
    """The recorded run that the view shows. From the graph."""

    report: str = setting("", "file of the page that the run leaves behind; empty: none")
    played: bool = setting(False, "the page teaches how to operate the cell, card by card")


class Images(enum.Enum):
    """Which of the camera's images a bag holds."""

    OFF = "off"
    KEYFRAMES = "keyframes"
    ALL = "all"


@dataclass(frozen=True)
class ImagesConfig:
    """Which images are recorded. In the section `recorder`; the tracker publishes them."""

    images: Images = setting(
        Images.KEYFRAMES,
        "images in the bag, as JPEG: off; keyframes: the placed object, begin, middle and end of each push, and each loss of"
        " the object, 15 MB at most; all",
    )


def _known_topic(text: str) -> KnownTopic:
    words = text.split()
    if len(words) != 3 or words[2] not in QUALITIES:
        raise ValueError(f"topics must be 'name package/msg/Type {'|'.join(QUALITIES)}', got {text!r}")
    return KnownTopic(*words)


@dataclass(frozen=True)
class RecordingConfig(Ranged):
    """Where a recording goes. From the command line."""

    bag: str = setting(REQUIRED, "folder of the bag, new or empty", names="the folder to record into")
    object: str = setting("", "written into the bag's folder: name of an object of Table 1, or path of an object YAML")
    model: str = setting("", "path of the model that the estimator starts with; copied into the bag's folder")
    calibration: str = setting("", "path of the camera's calibration; copied into the bag's folder")


@dataclass(frozen=True)
class ViewConfig:
    """Where the live view is served, if it is asked for. Section `view`."""

    host: str = setting(
        LOOPBACK, f"address that the page is served on; not {LOOPBACK}: other machines reach it too, and need the token"
    )
    port: int = setting(0, f"port of the page; 0: {VIEW_PORT}, or a free one if that is taken", 0, 65535)
    token: str = setting("", f"what a visitor must show; empty: nothing on {LOOPBACK}, a new one for each run elsewhere")

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.host:
            raise ValueError(f"host must be an address of this machine, such as {LOOPBACK} or 0.0.0.0, got ''")
        if self.token and not re.fullmatch("[A-Za-z0-9_-]{8,}", self.token):
            raise ValueError(f"token must be 8 or more letters, digits, - and _, got {self.token!r}")

    @property
    def is_local(self) -> bool:
        """Whether only this machine reaches the page."""
        return is_loopback(self.host)

    def protected(self) -> "ViewConfig":
        """The same, with a new token if one is needed and none is given."""
        return self if self.is_local or self.token else dataclasses.replace(self, token=secrets.token_urlsafe(12))


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches a server at this address or name."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


@dataclass(frozen=True)
class PlayerConfig(Ranged):
    """The bag to play, and how fast. From the command line."""

    bag: str = setting(REQUIRED, "folder of the bag, or one of its files", names="the bag to play")
    rate: float = setting(1.0, "multiple of the recorded speed", 0.01, 1000.0)
    partial: bool = setting(False, "play a damaged bag even if messages are missing")
    topics: tuple[str, ...] = setting((), "topics to play; none: all")
    clock: bool = setting(True, "publish the bag's time on /clock, 100 times in a second of the bag")
    wait_for: tuple[str, ...] = setting((), "topics that must have a subscriber before the first message is played")
    awaits: tuple[str, ...] = setting((), "nodes that must report that they are well before the first message is played")
    paused: bool = setting(False, "start paused, until ~/pause ends the pause")
    exit_when_done: bool = setting(True, "end the process when everything has been played and acknowledged")


@dataclass(frozen=True)
class PlannerConfig(Ranged):
    """How much work one request may ask of a planner node. Section `planner`."""

    most_pushes: int = setting(10_000, "largest number of pushes, turns or contacts in one request", 1, 1_000_000)
    most_strokes: int = setting(1000, "largest number of strokes in one request", 1, 100_000)
    longest: float = setting(10.0, "the work for one request ends after this long [s of wall time]", 0.1, 3600.0)


class EstimatorInput(enum.Enum):
    """Where the estimator's observations come from."""

    POSES = "poses"
    OBSERVATIONS = "observations"


@dataclass(frozen=True)
class ModelConfig:
    """The model to go on from, and the one to keep. Section `estimator`."""

    model: str = setting(
        "", "path of a model of the object (estimate --save), whose observations come first; empty: none", path=True
    )
    save: str = setting("", "path of the model (.yaml) that the estimator writes at its end; empty: none")


@dataclass(frozen=True)
class EstimatorNodeConfig:
    """Where the observations come from. From the graph."""

    source: EstimatorInput = setting(
        EstimatorInput.POSES, "poses: observations from object_pose and pusher_state; observations: from that topic"
    )
    bag: str = setting("", "folder of the run's bag, from which a restarted estimator resumes; empty: none")


@dataclass(frozen=True)
class SimulationConfig(Ranged):
    """The simulated camera and operator. Section `simulation`."""

    frame_rate: float = setting(14.0, "frames of the camera [Hz]", 0.1, 200.0)
    noise: float = setting(
        2.0, "standard deviation of a pixel's noise [of 255 grey levels]; a camera without noise would seem frozen", 0.5, 100.0
    )
    blur: float = setting(0.7, "standard deviation of the lens's blur [px]", 0.0, 10.0)
    away: float = setting(0.3, "how long the operator holds the object out of view when placing it [s]", 0.0, 10.0)
    contact_friction: float = setting(0.3, "mu_c of tip and object, unless the object is one of Table 1", 0.0, 10.0)
    placement_error: float = setting(
        0.001, "standard deviation and least error of the operator's placement [m]; the angle errs by this over 2 cm", 0.0, 0.1
    )


@dataclass(frozen=True)
class SimulatedRunConfig(Ranged):
    """A run of the simulation. From the command line."""

    seed: int = setting(0, "seed of the camera's noise and the operator's hand", 0, 2**31)
    speed: float = setting(
        5.0, "multiple of real time; on a slow machine the simulated clock runs slower and nothing is lost", 0.01, 100.0
    )
