"""Estimation from files, without a graph: a bag or a CSV -> observations -> the estimate with which a live run would end."""

import dataclasses
import os
import pathlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple, TypeVar

from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_core.estimate import Estimate
from pushfric_core.estimator import FORCE_TERMS, Estimator
from pushfric_core.misplacement import tip_stays_away
from pushfric_core.observation import Observation
from pushfric_core.observation_maker import ObservationMaker
from pushfric_core.recognition import Ranking, Recognizer
from pushfric_core.trajectory import TrajectoryConfig
from pushfric_ros.bags.bag import Bag
from pushfric_ros.bags.contents import BagMessage
from pushfric_ros.bags.rosbag2_metadata import METADATA
from pushfric_ros.files.estimator_settings import TOPIC as SETTINGS_TOPIC
from pushfric_ros.files.estimator_settings import EstimatorSettings
from pushfric_ros.files.model_file import prior
from pushfric_ros.files.object_file import OBJECT_FILE, PRIOR_FILE, ObjectModel
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
"""The topics from which data points are made, the topic of data points themselves, and that of forces."""

TYPES = {
    "object_pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "pusher_state": "pushfric_msgs/msg/PusherState",
    "observation": "pushfric_msgs/msg/Observation",
    "wrench": "geometry_msgs/msg/WrenchStamped",
    SETTINGS_TOPIC: "std_msgs/msg/String",
}
"""Types of the messages on these topics."""

BAG_FILES = (METADATA, "*.mcap", "*.mcap.zstd", "*.db3", "*.db3.zstd")
"""Patterns of files, of which a bag's folder contains at least one."""


class Source(NamedTuple):
    """The source of a bag's data points."""

    kind: str  # poses or observations: the estimator node's parameter `source`
    namespace: str  # of the cell that was recorded
    topics: tuple[str, ...]  # full names


def check_source(path: pathlib.Path) -> None:
    """Check that a path leads to something that may contain data points.

    Raises:
        InvalidInput: there is no such file, or it is a folder of several bags, one of which must be named.
    """
    if not os.path.exists(path):
        raise InvalidInput(f"{path}: no such file; expected a bag or a CSV of observations")
    if bags := bags_in(path):
        raise InvalidInput(f"{path}: is a folder of bags, expected one of them: {', '.join(map(str, bags))}")


def is_bag(folder: pathlib.Path) -> bool:
    """Whether a folder contains a bag's files."""
    return any(file for name in BAG_FILES for file in folder.glob(name))


def bags_in(path: pathlib.Path) -> list[pathlib.Path]:
    """The bags in a folder that is not itself a bag, in order; otherwise none."""
    if not path.is_dir() or is_bag(path):
        return []
    return sorted({file.parent for name in BAG_FILES for file in path.glob(f"*/{name}")})


def object_beside(path: pathlib.Path) -> pathlib.Path | None:
    """The object's YAML file in a bag's folder, if there is one."""
    file = (path if path.is_dir() else path.parent) / OBJECT_FILE
    return file if path.suffix != ".csv" and file.is_file() else None


def prior_beside(path: pathlib.Path) -> pathlib.Path | None:
    """The model in a bag's folder that the recorded run went on from, if there is one."""
    file = (path if path.is_dir() else path.parent) / PRIOR_FILE
    return file if path.suffix != ".csv" and file.is_file() else None


def source_of(path: pathlib.Path, with_forces: bool = False) -> Source:
    """The source of a bag's data points: poses if there are any, so that they are made as in a live run.

    Args:
        path: the bag.
        with_forces: poses are useful only with the topic of the force sensor.
    Raises:
        InvalidInput: the bag contains neither poses with pusher states nor observations, or cannot be read.
    """
    return _source(Bag(path), with_forces)


def _source(bag: Bag, with_forces: bool) -> Source:
    poses = (*POSES, WRENCH) if with_forces else POSES
    recorded = {topic.name: topic.type_name for topic in bag.summary.topics if topic.message_count}
    for kind, wanted in (("poses", poses), ("observations", OBSERVATIONS)):
        for namespace in (name.rpartition("/")[0] for name in recorded if name.endswith(f"/{wanted[0]}")):
            topics = tuple(f"{namespace}/{name}" for name in wanted)
            if set(topics) <= set(recorded):
                for topic in topics:
                    _check_type(bag, topic, recorded[topic])
                return Source(kind, namespace, topics)
    raise InvalidInput(f"{bag.path}: no data points; expected the topics {' and '.join(poses)}, or {OBSERVATIONS[0]}")


def _check_type(bag: Bag, topic: str, type_name: str) -> None:
    expected = TYPES[topic.rpartition("/")[2]]
    if type_name != expected:
        raise InvalidInput(f"{bag.path}: {topic} holds messages of {type_name[:80]}, expected {expected}")


def recorded_settings(path: pathlib.Path) -> EstimatorSettings:
    """The settings of the recorded run's estimator; the defaults for a CSV, and for a bag without settings.

    Raises:
        InvalidInput: the bag, or the settings in it, cannot be read.
    """
    if path.suffix == ".csv":
        return EstimatorSettings()
    bag = Bag(path)
    topics = {topic.name: topic.type_name for topic in bag.summary.topics if topic.name.rpartition("/")[2] == SETTINGS_TOPIC}
    for topic, type_name in topics.items():
        _check_type(bag, topic, type_name)
    last = deque(bag.messages(topics) if topics else (), maxlen=1)
    try:
        return (
            EstimatorSettings.from_text(_content(bag, last[0], lambda message: str(message.data)))
            if last
            else EstimatorSettings()
        )
    except ValueError as error:
        raise InvalidInput(f"{path}: {last[0].topic} is not understood: {error}") from error


def observations(
    path: pathlib.Path, model: ObjectModel, settings: EstimatorSettings, warn: Warn, partial: bool = False
) -> list[Observation]:
    """The data points of a CSV file or a bag, in order, without those of excluded pushes.

    Those of the model that the recorded run went on from come first.

    Args:
        path: the file or the bag.
        model: the object.
        settings: how poses become data points, which pushes are left out, and whether forces are needed.
        warn: called with a line for each message that is refused, and one for a damaged bag.
        partial: accept a bag from which messages are missing.
    Raises:
        InvalidInput: the file cannot be read, or does not contain the data points that are needed.
        DamagedBag: messages are missing from the bag.
    """
    check_source(path)
    if path.suffix == ".csv":
        found = read_observations(path, model.outline)
    else:
        bag = Bag(path)
        if not partial:
            bag.require_whole()
        if bag.damage is not None:
            warn(bag.what_is_missing())
        source = _source(bag, settings.with_forces)
        if source.kind == "poses":
            found = list(_from_poses(bag, source, model, settings.trajectory, warn))
        else:
            found = list(_recorded(bag, source, model, warn))
        if not found:
            raise InvalidInput(f"{path}: its {source.kind} give no data point of {model.name}")
        if (earlier := prior_beside(path)) is not None:
            found = prior(earlier, model) + found
    for push_id in settings.excluded:
        if all(observation.push_id != push_id for observation in found):
            raise InvalidInput(f"{path}: no data point of push {push_id}, which is to be left out")
    found = [observation for observation in found if observation.push_id not in settings.excluded]
    if settings.with_forces and all(observation.force is None for observation in found):
        raise InvalidInput(f"{path}: no data point has a measured force, which the terms {', '.join(FORCE_TERMS)} need")
    return found


def recorded_observations(path: pathlib.Path, model: ObjectModel, settings: EstimatorSettings, warn: Warn) -> list[Observation]:
    """The data points that the recorded run made itself, in order, without those of excluded pushes; for a bag with poses.

    Raises:
        InvalidInput: the bag cannot be read.
    """
    bag = Bag(path)
    namespace = _source(bag, settings.with_forces).namespace
    topics = tuple(f"{namespace}/{name}" for name in OBSERVATIONS)
    found = _recorded(bag, Source("observations", namespace, topics), model, warn)
    return [observation for observation in found if observation.push_id not in settings.excluded]


def _from_poses(bag: Bag, source: Source, model: ObjectModel, config: TrajectoryConfig, warn: Warn) -> Iterator[Observation]:
    pose_topic, pusher_topic, *force_topic = source.topics
    maker = ObservationMaker(model.outline, config, with_forces=bool(force_topic))
    for message in bag.messages(source.topics):
        try:
            if message.topic == pose_topic:
                yield from maker.add_pose(_content(bag, message, pose_sample_from_msg))
            elif message.topic == pusher_topic:
                yield from maker.add_pusher(_content(bag, message, pusher_sample_from_msg))
            else:
                yield from maker.add_force(_content(bag, message, force_sample_from_msg))
        except ValueError as error:
            warn(f"{message.topic} refused: {error}")
    if maker.apart is not None:
        warn(f"{bag.path}: {tip_stays_away(maker.apart)}")
    if maker.waiting:
        warn(f"{bag.path}: ends before the force of its last data points was measured; left out: {maker.waiting}")


def _recorded(bag: Bag, source: Source, model: ObjectModel, warn: Warn) -> Iterator[Observation]:
    for message in bag.messages(source.topics):
        try:
            observation = _content(bag, message, observation_from_msg)
            observation.check_contact(model.outline)
        except (ValueError, PushfricError) as error:
            warn(f"{message.topic} refused: {error}")
        else:
            yield observation


def _content(bag: Bag, message: BagMessage, convert: Callable[[Any], Taken]) -> Taken:
    """The record that a message contains.

    Raises:
        ValueError: the message contains impossible values.
        InvalidInput: the message was recorded with a definition that lacks one of the fields.
    """
    content = bag.deserialize(message)
    try:
        return convert(content)
    except AttributeError as error:
        raise InvalidInput(f"{bag.path}: {message.topic} was recorded with another definition of its type: {error}") from error


def taken(take: Callable[[Observation], Taken], data: Iterable[Observation], warn: Warn) -> Iterator[Taken]:
    """The result of each data point, one by one, as in a live node; `warn` is called with a line for each that is left out."""
    for observation in data:
        try:
            yield take(observation)
        except PushfricError as error:
            warn(f"data point of push {observation.push_id} refused: {error}")


def last(results: Iterable[Taken]) -> Taken:
    """The result of the last data point.

    Raises:
        InvalidInput: all data points were left out.
    """
    newest = deque(results, maxlen=1)
    if not newest:
        raise InvalidInput("no data point could be used, expected at least one")
    return newest[0]


def estimate(estimator: Estimator, data: Iterable[Observation], warn: Warn) -> Estimate:
    """The estimate after the last data point; raises and warns as `taken` and `last`."""
    return last(taken(estimator.take, data, warn))


def relied_on(data: Iterable[Observation], model: ObjectModel, settings: EstimatorSettings, warn: Warn) -> list[Observation]:
    """The data points that the estimate of a live run would rest on: without those of pushes that are unlike the others.

    `warn` is called with a line for each push, and for each single data point, that is left out.
    """
    config = dataclasses.replace(settings.estimator, confidence=False, tie_break=False)  # they leave out no push
    estimator = dataclasses.replace(settings, estimator=config).new_estimator(model.support_points)
    for _ in taken(estimator.take, data, warn):
        pass
    for push in estimator.rejected:
        warn(f"push {push.push_id} is left out: {push.reason}")
    return list(estimator.observations)


def recognize(recognizer: Recognizer, data: Iterable[Observation], warn: Warn) -> Ranking:
    """The ranking after the last data point; raises and warns as `taken` and `last`."""
    return last(taken(recognizer.add, data, warn))
