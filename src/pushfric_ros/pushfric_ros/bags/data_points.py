"""Estimation from files, without a graph: a bag or a CSV -> observations -> the estimate a live run would end with."""

import pathlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple, TypeVar

from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_core.estimate import Estimate
from pushfric_core.estimator import FORCE_TERMS, Estimator
from pushfric_core.observation import Observation
from pushfric_core.recognition import Ranking, Recognizer
from pushfric_core.sensed_force import SensedForce
from pushfric_core.trajectory import Trajectory, TrajectoryConfig
from pushfric_ros.bags import bag
from pushfric_ros.files.estimator_settings import TOPIC as SETTINGS_TOPIC
from pushfric_ros.files.estimator_settings import EstimatorSettings
from pushfric_ros.files.object_file import OBJECT_FILE, ObjectModel
from pushfric_ros.files.observation_file import read_observations
from pushfric_ros.messages.conversions import (
    force_sample_from_msg,
    observation_from_msg,
    pose_sample_from_msg,
    pusher_sample_from_msg,
)

Warn = Callable[[str], None]

Taken = TypeVar("Taken")

POSES, OBSERVATIONS, WRENCH = ("object_pose", "pusher_state"), ("observation",), "wrench"
"""Topics that data points are made from, the one of data points themselves, and the one their forces are made from."""


BAG_FILES = ("metadata.yaml", "*.mcap")
"""What a bag's folder holds, the one or the other at least."""


class Source(NamedTuple):
    """What a bag's data points come from."""

    kind: str  # poses or observations: the estimator node's parameter `source`
    namespace: str  # of the cell that was recorded
    topics: tuple[str, ...]  # full names


def check_source(path: pathlib.Path) -> None:
    """Whether something is there that may hold data points.

    Raises:
        InvalidInput: there is nothing, or a folder of bags, of which one must be named.
    """
    if not path.exists():
        raise InvalidInput(f"{path}: no such file; expected a bag or a CSV of observations")
    if path.is_dir() and not any(file for name in BAG_FILES for file in path.glob(name)):
        bags = sorted({str(file.parent) for name in BAG_FILES for file in path.glob(f"*/{name}")})
        if bags:
            raise InvalidInput(f"{path}: is a folder of bags, expected one of them: {', '.join(bags)}")


def object_beside(path: pathlib.Path) -> pathlib.Path | None:
    """The object's YAML file that lies in a bag's folder, if there is one."""
    file = (path if path.is_dir() else path.parent) / OBJECT_FILE
    return file if path.suffix != ".csv" and file.is_file() else None


def source_of(path: pathlib.Path, with_forces: bool = False) -> Source:
    """What the data points of a bag come from: poses where there are any, so that they are made as in a live run.

    Args:
        path: the bag.
        with_forces: poses need the force sensor's topic beside them.
    Raises:
        InvalidInput: it holds neither poses with pusher states nor observations, or cannot be read.
    """
    poses = (*POSES, WRENCH) if with_forces else POSES
    names = [topic.name for topic in bag.describe(path).topics if topic.message_count]
    for kind, wanted in (("poses", poses), ("observations", OBSERVATIONS)):
        for namespace in (name.rpartition("/")[0] for name in names if name.endswith(f"/{wanted[0]}")):
            topics = tuple(f"{namespace}/{name}" for name in wanted)
            if set(topics) <= set(names):
                return Source(kind, namespace, topics)
    raise InvalidInput(f"{path}: no data points; expected the topics {' and '.join(poses)}, or {OBSERVATIONS[0]}")


def recorded_settings(path: pathlib.Path) -> EstimatorSettings:
    """How the estimator of the recorded run estimated; the defaults of a CSV, and of a bag that does not say.

    Raises:
        InvalidInput: the bag cannot be read, or says it in words that are not understood.
    """
    if path.suffix == ".csv":
        return EstimatorSettings()
    topics = [topic.name for topic in bag.describe(path).topics if topic.name.rpartition("/")[2] == SETTINGS_TOPIC]
    last = deque(bag.read(path, topics) if topics else (), maxlen=1)
    try:
        return EstimatorSettings.from_text(bag.deserialize(last[0]).data) if last else EstimatorSettings()
    except ValueError as error:
        raise InvalidInput(f"{path}: {last[0].topic} is not understood: {error}") from error


def observations(path: pathlib.Path, model: ObjectModel, settings: EstimatorSettings, warn: Warn) -> list[Observation]:
    """The data points of a CSV file or a bag, in order, without those of excluded pushes.

    Args:
        path: the file or the bag.
        model: the object.
        settings: how poses become data points, which pushes are left out, and whether forces are needed.
        warn: gets a line for each message that is refused.
    Raises:
        InvalidInput: the file cannot be read, or holds no data points, or not such as are needed.
    """
    check_source(path)
    if path.suffix == ".csv":
        found = read_observations(path, model.outline)
    else:
        source = source_of(path, settings.with_forces)
        if source.kind == "poses":
            found = list(_from_poses(path, source, model, settings.trajectory, warn))
        else:
            found = list(_recorded(path, source, model, warn))
        if not found:
            raise InvalidInput(f"{path}: its {source.kind} give no data point of {model.name}")
    for push_id in settings.excluded:
        if all(observation.push_id != push_id for observation in found):
            raise InvalidInput(f"{path}: no data point of push {push_id}, which is to be left out")
    found = [observation for observation in found if observation.push_id not in settings.excluded]
    if settings.with_forces and all(observation.force is None for observation in found):
        raise InvalidInput(f"{path}: no data point has a measured force, which the terms {', '.join(FORCE_TERMS)} need")
    return found


def _from_poses(
    path: pathlib.Path, source: Source, model: ObjectModel, config: TrajectoryConfig, warn: Warn
) -> Iterator[Observation]:
    trajectory = Trajectory(model.outline, config)
    pose_topic, pusher_topic, *force_topic = source.topics
    forces = SensedForce() if force_topic else None
    for message in bag.read(path, source.topics):
        try:
            content = bag.deserialize(message)
            if message.topic == pose_topic:
                made = trajectory.add_pose(pose_sample_from_msg(content))
            elif message.topic == pusher_topic:
                made = trajectory.add_pusher(pusher_sample_from_msg(content))
            else:
                assert forces is not None
                yield from forces.add_force(force_sample_from_msg(content))
                continue
            for observation in made:
                yield from [observation] if forces is None else forces.add_observation(observation)
        except ValueError as error:
            warn(f"{message.topic} refused: {error}")
    if forces is not None and forces.waiting:
        warn(f"{path}: ends before the force of its last {forces.waiting} data points was measured; they are left out")


def _recorded(path: pathlib.Path, source: Source, model: ObjectModel, warn: Warn) -> Iterator[Observation]:
    for message in bag.read(path, source.topics):
        try:
            observation = observation_from_msg(bag.deserialize(message))
            observation.check_contact(model.outline)
        except (ValueError, PushfricError) as error:
            warn(f"{message.topic} refused: {error}")
        else:
            yield observation


def taken(take: Callable[[Observation], Taken], data: Iterable[Observation], warn: Warn) -> Iterator[Taken]:
    """What comes of each data point, one by one, as in a live node; `warn` gets a line for each that is refused."""
    for observation in data:
        try:
            yield take(observation)
        except PushfricError as error:
            warn(f"data point of push {observation.push_id} refused: {error}")


def last(results: Iterable[Taken]) -> Taken:
    """What comes of all the data points.

    Raises:
        InvalidInput: all of them were refused.
    """
    newest = deque(results, maxlen=1)
    if not newest:
        raise InvalidInput("no data point could be used, expected at least one")
    return newest[0]


def estimate(estimator: Estimator, data: Iterable[Observation], warn: Warn) -> Estimate:
    """The estimate after the last data point; raises and warns as `taken` and `last`."""
    return last(taken(estimator.add, data, warn))


def recognize(recognizer: Recognizer, data: Iterable[Observation], warn: Warn) -> Ranking:
    """The ranking after the last data point; raises and warns as `taken` and `last`."""
    return last(taken(recognizer.add, data, warn))
