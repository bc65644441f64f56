"""Import of real pushes: an aluminium triangle, CMU Manipulation Lab.

J. Zhou, R. Paolini, J. A. Bagnell, M. T. Mason, "A convex polynomial force-motion model for planar sliding: identification and
application", ICRA 2016. A log holds, for each push, the object's pose before and after, the readings of a force sensor and the
poses of the tool; so each push gives one observation: its finite motion, with the contact in the middle of it.
"""

import gzip
import math
import pathlib
import re
import zlib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from pushfric_core.bags.bag_writer import BagWriter
from pushfric_core.bags.cdr import encoder
from pushfric_core.bags.message_types import record
from pushfric_core.bags.offered_qos import OfferedQos
from pushfric_core.bags.samples import observation_to_msg
from pushfric_core.datasets.imported import Imported
from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_core.files.csv_table import Row, read_table
from pushfric_core.files.file_errors import as_named_here
from pushfric_core.files.object_file import OBJECT_FILE, ObjectFile, ObjectModel, SupportFile, make_object, save_object
from pushfric_core.geometry import planar
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array, Pose, Twist, compose, exp, inverse, rotation, transform, velocity_at
from pushfric_core.trajectories.observation import Observation

NAME = "zhou2015"
TOPIC, TYPE = "/cell/observation", "pushfric_msgs/msg/Observation"

CORNERS = [(0.0, 0.0), (0.15, 0.0), (0.0, 0.15)]
"""Corners of the triangle [m]; the right angle is at the origin."""

GRID = SupportFile(grid=(10, 10), inset=0.0075)
"""Hypothesised support: the middles of 15 mm cells, of which 55 lie on the triangle."""

TOUCHING = 0.25
"""The contact begins when the force first exceeds this fraction of its maximum."""

BUILDING_UP = 0.3
"""The mean force leaves out this first fraction of the contact, in which the force builds up, as push_points.csv does."""

LARGEST_GAP = 0.004
"""A push is left out if, in its middle, the finger is farther than this from the outline [m]: the log must be wrong."""

SENSOR_TO_TOOL = np.array(((-1.0, -1.0), (-1.0, 1.0))) / math.sqrt(2)
"""From the sensor's reading to the force ON the object, in the frame of the tool."""

COLUMNS = ("object", "log", "push", "cx_mm", "cy_mm", "nx", "ny", "dx_mm", "dy_mm", "dtheta_rad", "fx_N", "fy_N")
NAMES = {
    "contact_point": "cx_mm, cy_mm",
    "contact_normal": "nx, ny",
    "the twist": "dx_mm, dy_mm, dtheta_rad",
    "force": "fx_N, fy_N",
    "push_id": "push",
}
"""The columns of each field of an observation."""

TIPS = ("tip0x_mm", "tip0y_mm", "tip1x_mm", "tip1y_mm")
MILLIMETRE = 1e-3

LOG_LIMIT = 64 * 2**20
"""Largest size of a log after decompression [bytes]; the longest of the data set has 2 MB."""

LARGEST = 1e12
"""Largest number accepted in a log; times are seconds since 1970."""

SECOND = 10**9


def import_pushes(source: pathlib.Path, out: pathlib.Path) -> list[Imported]:
    """Write a bag of observations, with its object's YAML file, for the log or for each log of a CSV.

    Args:
        source: a log (.txt or .txt.gz), or push_points.csv.
        out: folder of the bag; for a CSV with several logs, of the bags.
    Raises:
        InvalidInput: the source cannot be read, or a bag exists already.
    """
    if not source.is_file():
        raise InvalidInput(f"{source}: no such file; expected a log of {NAME} or its push_points.csv")
    if source.suffix != ".csv":
        return [write_bag(out, _object_of(source), read_log(source))]
    logs = read_push_points(source)
    return [
        write_bag(out if len(logs) == 1 else out / pathlib.Path(log).stem, _object_of(pathlib.Path(log)), observations)
        for log, observations in logs.items()
    ]


def read_push_points(path: pathlib.Path) -> dict[str, list[Observation]]:
    """The observations of push_points.csv, log by log. The file has no times, so each push counts as one second.

    Raises:
        InvalidInput: a column or a number is missing.
    """
    logs: dict[str, list[Observation]] = {}
    for row in read_table(path, COLUMNS, "data points", f"push_points.csv of {NAME}").rows:
        cx, cy, nx, ny, dx, dy, turn, fx, fy = row.numbers(COLUMNS[3:])
        try:
            push = int(row.texts["push"] or "")
            motion = Twist(dx * MILLIMETRE, dy * MILLIMETRE, turn)
            observation = Observation(
                contact_point=(cx * MILLIMETRE, cy * MILLIMETRE),
                contact_normal=(nx, ny),
                twist=motion,
                push_id=push,
                stamp=(push + 1) * SECOND,
                force=(fx, fy),
                tip_velocity=_tip_velocity(row, motion, (cx * MILLIMETRE, cy * MILLIMETRE)),
            )
        except InvalidInput:
            raise
        except (TypeError, ValueError, PushfricError) as error:
            raise InvalidInput(f"{row.where}: {as_named_here(error, NAMES)}") from error
        logs.setdefault(row.texts["log"] or "", []).append(observation)
    return logs


def read_log(path: pathlib.Path) -> list[Observation]:
    """The observations of a log: one for each push whose finger met an edge.

    Raises:
        InvalidInput: the file is not a log, or ends early.
    """
    try:
        with gzip.open(path, "rb") if path.suffix == ".gz" else path.open("rb") as stream:
            content = stream.read(LOG_LIMIT + 1)
        if len(content) > LOG_LIMIT:
            raise ValueError(f"it holds more than {LOG_LIMIT} bytes")
        numbers = (match[0] for match in re.finditer(r"\S+", content.decode()))
        outline = Outline(np.array(CORNERS))
        pushes = (_push(numbers) for _ in range(int(next(numbers))))
        found = [_observation(index, push, outline) for index, push in enumerate(pushes)]
    except (OSError, ValueError, EOFError, zlib.error) as error:
        raise InvalidInput(f"{path}: not a log of {NAME}: {error}") from error
    except (StopIteration, RuntimeError) as error:
        raise InvalidInput(f"{path}: ends in the middle of a push") from error
    observations = [observation for observation in found if observation is not None]
    if not observations:
        raise InvalidInput(f"{path}: no push met an edge of the triangle")
    return observations


class _Push(NamedTuple):
    """A push in a log, in metres."""

    before: Pose  # of the object, in the robot's frame
    after: Pose
    forces: Array  # (m, 3) time [s], sensor reading [N]
    tool: Array  # (k, 4) time [s], position [m], orientation [rad]


def _number(text: str) -> float:
    value = float(text)
    if not abs(value) <= LARGEST:
        raise ValueError(f"expected numbers within {LARGEST:g}, got {text[:40]}")
    return value


def _push(numbers: Iterator[str]) -> _Push:
    def table(columns: int) -> Array:
        rows = int(next(numbers))
        return np.array([_number(next(numbers)) for _ in range(rows * columns)]).reshape(rows, columns)

    before, after = (np.array([_number(next(numbers)) for _ in range(7)]) for _ in range(2))
    forces, tool = table(3), table(8)
    if not len(forces) or not len(tool):
        raise ValueError("a push without forces or tool poses")
    headings = np.array([_heading(row[4:]) for row in tool])
    return _Push(_pose(before), _pose(after), forces, np.column_stack((tool[:, 0], tool[:, 1:3] * MILLIMETRE, headings)))


def _pose(row: Array) -> Pose:
    return Pose(float(row[0]) * MILLIMETRE, float(row[1]) * MILLIMETRE, _heading(row[3:]))


def _heading(quaternion: Array) -> float:
    w, x, y, z = quaternion
    return math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)


def _observation(index: int, push: _Push, outline: Outline) -> Observation | None:
    """The observation of a push; None without a finger at an edge, a motion or a force during the contact."""
    motion = planar.log(compose(inverse(push.before), push.after))
    forces = push.forces[:, 1:] - push.forces[0, 1:]
    size = np.hypot(*forces.T)
    touched, end = float(push.forces[np.argmax(size > TOUCHING * size.max()), 0]), float(push.tool[-1, 0])
    middle = (touched + end) / 2
    pressed = push.forces[:, 0] >= touched + BUILDING_UP * max(end - touched, 0.0)
    x, y, heading = (float(np.interp(middle, push.tool[:, 0], column)) for column in push.tool.T[1:])
    pose = compose(push.before, exp(motion, 0.5))
    tip = transform(inverse(pose), (x, y))
    # the foot of the perpendicular on the nearest edge
    gaps = np.sum((tip - outline.vertices) * outline.normals, axis=1)
    edge = int(np.argmax(gaps))
    contact = tip - gaps[edge] * outline.normals[edge]
    if abs(gaps[edge]) > LARGEST_GAP or not outline.contains(contact) or not any(motion) or not pressed.any():
        return None
    # the tip's places in the object's frame at first touch and at the end: its motion there adds to the contact's motion
    first, last = (
        np.array([np.interp(time, push.tool[:, 0], column) for column in push.tool.T[1:3]]) for time in (touched, end)
    )
    travel = transform(inverse(push.after), last) - transform(inverse(push.before), first)
    tip_velocity = velocity_at(motion, contact) + travel
    in_tool = SENSOR_TO_TOOL @ forces[pressed].mean(axis=0)
    fx, fy = rotation(heading - pose.theta) @ in_tool
    nx, ny = outline.normals[edge]
    return Observation(
        contact_point=(float(contact[0]), float(contact[1])),
        contact_normal=(float(nx), float(ny)),
        twist=motion,
        push_id=index,
        stamp=round(middle * SECOND),
        pose=pose,
        force=(float(fx), float(fy)),
        tip_velocity=(float(tip_velocity[0]), float(tip_velocity[1])),
    )


def _tip_velocity(row: Row, motion: Twist, contact: tuple[float, float]) -> tuple[float, float] | None:
    """The contact's motion plus that of the tip in the object's frame; None if the file has no tips."""
    if any(not row.texts.get(name) for name in TIPS):
        return None
    x0, y0, x1, y1 = (number * MILLIMETRE for number in row.numbers(TIPS))
    vx, vy = velocity_at(motion, np.asarray(contact))
    return float(vx) + x1 - x0, float(vy) + y1 - y0


def _object_of(log: pathlib.Path) -> str:
    """The part of a log's name that says what the triangle stood on."""
    return log.name.partition("__exp")[0]


def object_on(name: str) -> ObjectModel:
    """The triangle on supports of this name, as one knows it before it is pushed."""
    return make_object(ObjectFile(name=name, outline=CORNERS, support=GRID), name)


def write_bag(folder: pathlib.Path, name: str, observations: list[Observation]) -> Imported:
    """Write a bag of observations of the triangle on supports of this name, with its object's YAML file."""
    with BagWriter(folder) as writer:
        writer.add_topic(TOPIC, TYPE, [OfferedQos(depth=len(observations), reliability="reliable", durability="volatile")])
        encode = encoder(TYPE)
        for observation in sorted(observations, key=lambda o: o.stamp):
            writer.write(TOPIC, observation.stamp, encode(observation_to_msg(observation, name, record)))
    save_object(object_on(name), folder / OBJECT_FILE)
    return Imported(folder, name, len(observations))
