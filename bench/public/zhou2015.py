"""Import of real pushes: an aluminium triangle, CMU Manipulation Lab.

J. Zhou, R. Paolini, J. A. Bagnell, M. T. Mason, "A convex polynomial force-motion model for planar sliding: identification and
application", ICRA 2016. A log holds, for each push, the object's pose before and after, the readings of a force sensor and the
poses of the tool; so each push gives one observation: its finite motion, with the contact in the middle of it.
"""

import gzip
import math
import pathlib
import zlib
from collections.abc import Iterator

import numpy as np

from bench.public.strokes import LARGEST, SECOND, Imported
from pushfric_core import InvalidInput, Observation, Outline, PushfricError
from pushfric_core.bags.bag_writer import BagWriter
from pushfric_core.bags.message_types import encoder, record
from pushfric_core.bags.samples import observation_to_msg
from pushfric_core.errors import blaming
from pushfric_core.files.csv_files import read_table
from pushfric_core.files.object_file import OBJECT_FILE, ObjectFile, ObjectModel, SupportFile, make_object, save_object
from pushfric_core.geometry.planar import Array, Pose, Twist, compose, exp, inverse, log, rotation, transform, velocity_at

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
TIPS = ("tip0x_mm", "tip0y_mm", "tip1x_mm", "tip1y_mm")
MILLIMETRE = 1e-3


def import_pushes(source: pathlib.Path, out: pathlib.Path) -> list[Imported]:
    """Write a bag of observations, with its object's YAML file, for the log or for each log of a CSV.

    Args:
        source: a log (.txt or .txt.gz), or push_points.csv.
        out: folder of the bag; for a CSV with several logs, of the bags.
    Raises:
        InvalidInput: the source cannot be read, or a bag exists already.
    """
    logs = read_push_points(source) if source.suffix == ".csv" else {source.name: read_log(source)}
    return [
        write_bag(out if len(logs) == 1 else out / pathlib.Path(name).stem, name.partition("__exp")[0], observations)
        for name, observations in logs.items()
    ]


def read_push_points(path: pathlib.Path) -> dict[str, list[Observation]]:
    """The observations of push_points.csv, log by log. The file has no times, so each push counts as one second.

    Raises:
        InvalidInput: a column or a number is missing.
    """
    logs: dict[str, list[Observation]] = {}
    for row in read_table(path, COLUMNS, "observations", f"push_points.csv of {NAME}").rows:
        push, cx, cy, nx, ny, dx, dy, turn, fx, fy = row.numbers(COLUMNS[2:])
        contact, motion = (cx * MILLIMETRE, cy * MILLIMETRE), Twist(dx * MILLIMETRE, dy * MILLIMETRE, turn)
        tip, stamp = None, (int(push) + 1) * SECOND
        if all(row.texts.get(name) for name in TIPS):  # the contact's motion plus that of the tip in the object's frame
            begin, end = np.reshape(row.numbers(TIPS), (2, 2)) * MILLIMETRE
            tip = velocity_at(motion, contact) + end - begin
        with blaming(row.where, ValueError, PushfricError):
            one = Observation(contact, (nx, ny), motion, int(push), stamp=stamp, force=(fx, fy), tip_velocity=tip)
        logs.setdefault(row.texts["log"], []).append(one)
    return logs


def read_log(path: pathlib.Path) -> list[Observation]:
    """The observations of a log: one for each push whose finger met an edge.

    Raises:
        InvalidInput: the file is not a log, or ends early.
    """
    try:
        with gzip.open(path, "rb") if path.suffix == ".gz" else path.open("rb") as stream:
            content = np.array(stream.read().split(), dtype=float)
        if not (np.abs(content) <= LARGEST).all():
            raise ValueError(f"expected numbers within {LARGEST:g}")
        numbers, outline = iter(content.tolist()), Outline(np.array(CORNERS))
        pushes = [_observation(index, numbers, outline) for index in range(int(next(numbers)))]
    except (OSError, ValueError, EOFError, zlib.error) as error:
        raise InvalidInput(f"{path}: not a log of {NAME}: {error}") from error
    except StopIteration as error:
        raise InvalidInput(f"{path}: ends in the middle of a push") from error
    observations = [one for one in pushes if one is not None]
    if not observations:
        raise InvalidInput(f"{path}: no push met an edge of the triangle")
    return observations


def _pose(row: Array) -> Pose:
    x, y, _, w, i, j, k = row.tolist()
    return Pose(x * MILLIMETRE, y * MILLIMETRE, math.atan2(2 * (w * k + i * j), w * w + i * i - j * j - k * k))


def _observation(index: int, numbers: Iterator[float], outline: Outline) -> Observation | None:
    """The observation of the next push of a log; None without a finger at an edge, a motion or a force during the contact.

    A push is the object's pose before and after it, in the robot's frame, position [mm] and quaternion; a table of forces: time
    [s] and reading [N]; and one of the tool: time and pose.
    """

    def table(rows: int, columns: int) -> Array:
        return np.array([next(numbers) for _ in range(rows * columns)]).reshape(rows, columns)

    before, after = map(_pose, table(2, 7))
    readings, poses = table(int(next(numbers)), 3), table(int(next(numbers)), 8)
    if not len(readings) or not len(poses):
        raise ValueError("a push without forces or tool poses")
    tool = np.array([(row[0], *_pose(row[1:])) for row in poses])
    motion = log(compose(inverse(before), after))
    forces = readings[:, 1:] - readings[0, 1:]
    size = np.hypot(*forces.T)
    touched, end = float(readings[np.argmax(size > TOUCHING * size.max()), 0]), float(tool[-1, 0])
    middle = (touched + end) / 2
    pressed = readings[:, 0] >= touched + BUILDING_UP * max(end - touched, 0.0)
    first, halfway, last = np.column_stack([np.interp((touched, middle, end), tool[:, 0], column) for column in tool.T[1:]])
    pose = compose(before, exp(motion, 0.5))
    distance, point, normal, edge = outline.nearest(transform(inverse(pose), halfway[:2]))
    if edge is None or abs(distance) > LARGEST_GAP or not any(motion) or not pressed.any():
        return None
    # the tip's places in the object's frame at first touch and at the end: its motion there adds to the contact's motion
    velocity = velocity_at(motion, point) + (transform(inverse(after), last[:2]) - transform(inverse(before), first[:2]))
    force = rotation(halfway[2] - pose.theta) @ (SENSOR_TO_TOOL @ forces[pressed].mean(axis=0))
    stamp = round(middle * SECOND)
    return Observation(point, normal, motion, index, stamp=stamp, pose=pose, force=force, tip_velocity=velocity)


def object_on(name: str) -> ObjectModel:
    """The triangle on supports of this name, as one knows it before it is pushed."""
    return make_object(ObjectFile(name=name, outline=CORNERS, support=GRID), name)


def write_bag(folder: pathlib.Path, name: str, observations: list[Observation]) -> Imported:
    """Write a bag of observations of the triangle on supports of this name, with its object's YAML file."""
    with BagWriter(folder) as writer:
        writer.add_topic(TOPIC, TYPE, [])
        encode = encoder(TYPE)
        for observation in sorted(observations, key=lambda o: o.stamp):
            writer.write(TOPIC, observation.stamp, encode(observation_to_msg(observation, name, record)))
    save_object(object_on(name), folder / OBJECT_FILE)
    return Imported(folder, name, len(observations))
