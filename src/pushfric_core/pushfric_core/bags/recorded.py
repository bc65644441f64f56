"""A recording, a bag or a CSV of observations: its settings, its observations, and an account of its messages."""

import contextlib
import functools
import os
import pathlib
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pushfric_core.bags.rosbag2_metadata import METADATA, NO_BAG
from pushfric_core.bags.run_record import TYPES, PlanRecord, RunRecord, content
from pushfric_core.bags.samples import INPUTS
from pushfric_core.belief.symptoms import tip_stays_away
from pushfric_core.errors import InvalidInput, UninformativePush, extra
from pushfric_core.estimation.estimator import FORCE_TERMS, Estimator, Warn
from pushfric_core.files.csv_files import read_observations
from pushfric_core.files.estimator_settings import TOPIC as SETTINGS_TOPIC
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.model_file import prior
from pushfric_core.files.object_file import OBJECT_FILE, PRIOR_FILE, ObjectModel, load_object
from pushfric_core.geometry.outline import Outline
from pushfric_core.trajectories.ledger import FOREIGN, REFUSED, DoubtCode, Ledger
from pushfric_core.trajectories.observation import Observation
from pushfric_core.trajectories.observation_maker import ObservationMaker
from pushfric_core.trajectories.samples import TrajectoryConfig

if TYPE_CHECKING:
    from pushfric_core.bags.bag import Bag

POSE_TOPICS, OBSERVATION_TOPICS, WRENCH = ("object_pose", "pusher_state"), ("observation",), "wrench"
"""The topics from which observations are made, the topic of observations themselves, and that of forces."""

BAG_FILES = (METADATA, "*.mcap")
"""Patterns of files, of which a bag's folder contains at least one."""


class ObservationSource(NamedTuple):
    """The source of a bag's observations."""

    kind: str  # poses or observations: the estimator node's parameter `source`
    namespace: str  # of the cell that was recorded
    topics: tuple[str, ...]  # full names


def check_source(path: pathlib.Path) -> None:
    """Check that a path leads to something that may contain observations.

    Raises:
        InvalidInput: there is no such file, or it is a folder without a bag, or of several, one of which must be named.
    """
    if not os.path.exists(path):
        raise InvalidInput(f"{path}: no such file; expected a bag or a CSV of observations")
    if bags := bags_in(path):
        raise InvalidInput(f"{path}: is a folder of bags, expected one of them: {', '.join(map(str, bags))}")
    if path.is_dir() and not is_bag(path):
        raise InvalidInput(f"{path}: {NO_BAG}")


def is_bag(folder: pathlib.Path) -> bool:
    """Whether a folder contains a bag's files."""
    return any(file for name in BAG_FILES for file in folder.glob(name))


def is_csv(path: pathlib.Path) -> bool:
    """Whether this is the name of a CSV, not of a folder."""
    return path.suffix.lower() == ".csv" and not path.is_dir()


def bags_in(path: pathlib.Path) -> list[pathlib.Path]:
    """The bags in a folder that is not itself a bag, in order; otherwise none."""
    if not path.is_dir() or is_bag(path):
        return []
    return sorted({file.parent for name in BAG_FILES for file in path.glob(f"*/{name}")})


def beside(path: pathlib.Path, name: str) -> pathlib.Path | None:
    """The file of this name in a bag's folder, such as OBJECT_FILE or PRIOR_FILE, if there is one."""
    file = (path if path.is_dir() else path.parent) / name
    return file if not is_csv(path) and file.is_file() else None


class Recorded:
    """A bag, or a CSV of observations, which is opened once.

    Args:
        path: the file or the bag.
        namespace: of the cell; None: the bag has only one.
        bag: at this path, if it has been opened already.
    Attributes:
        on_observation: called with each observation as soon as it is read.
    Raises:
        InvalidInput: there is no such file, it is a folder of several bags, or it cannot be read.
        MissingPackage: it is a bag, and the packages that read bags are not installed.
    """

    def __init__(self, path: pathlib.Path, namespace: str | None = None, bag: "Bag | None" = None) -> None:
        check_source(path)
        self.path, self._namespace = path, namespace
        self.on_observation: Callable[[Observation], None] = lambda observation: None
        self._bag = bag if bag is not None or is_csv(path) else _opened(path)

    @property
    def settings(self) -> EstimatorSettings:
        """The settings of the recorded run's estimator; the defaults for a CSV, and for a bag without settings.

        Raises:
            InvalidInput: the settings in the bag cannot be read, or it holds several cells.
        """
        return self._own_settings[0] or EstimatorSettings()

    @functools.cached_property
    def _own_settings(self) -> tuple[EstimatorSettings | None, InvalidInput | None]:
        """The last settings in the bag that are understood, and why others are not."""
        bag = self._bag
        topic = "" if bag is None else f"{self._cell(bag)}/{SETTINGS_TOPIC}"
        type_name = None if bag is None else _recorded_types(bag).get(topic)
        if bag is None or type_name is None:
            return None, None
        _check_type(bag, topic, type_name)
        settings = strange = None
        for one in bag.messages([topic]):
            try:
                settings = EstimatorSettings.from_text(content(bag, one, lambda message: str(message.data)))
            except ValueError as error:
                strange = InvalidInput(f"{self.path}: {topic} is not understood: {error}")
        if settings is None and strange is not None:
            raise strange
        return settings, strange

    def source(self, with_forces: bool) -> ObservationSource:
        """The source of a bag's observations: poses if there are any, so that they are made as in a live run.

        Args:
            with_forces: poses are useful only with the topic of the force sensor.
        Raises:
            InvalidInput: the bag contains neither poses with pusher states nor observations, or those of several cells.
        """
        bag = self._bag
        if bag is None:
            raise InvalidInput(f"{self.path}: expected a bag")
        poses = (*POSE_TOPICS, WRENCH) if with_forces else POSE_TOPICS
        recorded, cell = _recorded_types(bag), self._cell(bag)
        for kind, wanted in (("poses", poses), ("observations", OBSERVATION_TOPICS)):
            topics = tuple(f"{cell}/{name}" for name in wanted)
            if cell is not None and set(topics) <= set(recorded):
                for topic in topics:
                    _check_type(bag, topic, recorded[topic])
                return ObservationSource(kind, cell, topics)
        where = "" if self._namespace is None else f" of {cell or '/'}"
        raise InvalidInput(
            f"{bag.path}: no observations{where}; expected the topics {' and '.join(poses)}, or {OBSERVATION_TOPICS[0]}"
        )

    def holding(self, topic: str) -> list[str]:
        """That topic, if this is a bag that has it."""
        return [] if self._bag is None else [one.name for one in self._bag.summary.topics if one.name == topic]

    def messages(self, types: Mapping[str, str]) -> Iterator[tuple[str, Any]]:
        """The messages of other topics of the cell, each with its topic's name: those of these types that can be read."""
        if (bag := self._bag) is None:
            return
        names = bag.summary.names(self._cell(bag), types)
        for message in bag.messages(names) if names else ():
            with contextlib.suppress(ValueError, AttributeError):  # the ledger says so
                yield names[message.topic], bag.deserialize(message)

    def read(self, model: ObjectModel, settings: EstimatorSettings, warn: Warn, partial: bool = False) -> "Reading":
        """The observations, with those of the model that the recorded run went on from first.

        Args:
            model: the object.
            settings: how poses become observations, which pushes are left out, and whether forces are needed.
            warn: called with a line for each message that is refused, each doubt and remark, and one for a damaged bag.
            partial: accept a bag from which messages are missing.
        Raises:
            InvalidInput: the file cannot be read, or does not contain the observations that are needed.
            DamagedBag: messages are missing from the bag.
        """
        bag, path = self._bag, self.path
        if bag is None:
            found, ledger, plan = read_observations(path, model.outline), Ledger(), PlanRecord()
            for observation in found:
                self.on_observation(observation)
        else:
            if not partial:
                bag.require_whole()
            if bag.damage is not None:
                warn(bag.what_is_missing())
            for note in bag.notes:
                warn(f"{path}: {note}")
            source = self.source(settings.with_forces)
            found, ledger, plan = self._account(bag, source, model, settings, warn)
            for line in ledger.lines:
                warn(f"{path}: {line}")
            if not found:
                raise InvalidInput(f"{path}: its {source.kind} give no observation of {model.name}")
        named, known = ({*one.excluded, *one.kept, *one.slipping} for one in (settings, self.settings))
        for push_id in sorted(named - known):
            if all(observation.push_id != push_id for observation in found):
                raise InvalidInput(f"{path}: no observation of push {push_id}, which is to be left out, kept, or said to slip")
        reading = Reading(found, settings.excluded, ledger, plan)
        if settings.with_forces and all(observation.force is None for observation in reading.observations):
            raise InvalidInput(f"{path}: no observation has a measured force, which the terms {', '.join(FORCE_TERMS)} need")
        return reading

    def ledger(self) -> Ledger | None:
        """The account of a bag of a run: what does not add up, and what became of its messages; None if the bag holds no run.

        Without the object's file next to the bag, it is not known which observations its poses give, and nothing is said of it.

        Raises:
            InvalidInput: the bag, or a file next to it, cannot be read.
        """
        if self._bag is None or self._cell(self._bag) is None:
            return None
        file, settings = beside(self.path, OBJECT_FILE), self.settings
        model, source = None if file is None else load_object(str(file)), self.source(settings.with_forces)
        return self._account(self._bag, source, model, settings, lambda _: None)[1]

    def _account(
        self, bag: "Bag", source: ObservationSource, model: ObjectModel | None, settings: EstimatorSettings, warn: Warn
    ) -> tuple[list[Observation], Ledger, PlanRecord]:
        """The observations of a bag, those that its run went on from first, and what became of its messages."""
        ledger, record, before = Ledger(), RunRecord(bag, source.namespace), beside(self.path, PRIOR_FILE)
        (own, strange), outline = self._own_settings, Outline.rectangle(0.1, 0.1) if model is None else model.outline
        earlier = [] if model is None or before is None else prior(before, model)
        found: list[Observation] = []
        for observation in _made(bag, source, outline, settings.trajectory, ledger, record, warn):
            for one in (observation,) if found else (*earlier, observation):
                self.on_observation(one)
            found.append(observation)
        _enter_unread(bag, source, ledger)
        ledger.doubt_refused()
        if strange is not None:
            ledger.doubt(DoubtCode.NOT_UNDERSTOOD, f"a message is left out: {strange}")
        for text in bag.lost:
            ledger.doubt(DoubtCode.LOST_BEFORE, f"was recovered; before that, {text}")
        if model is None:
            ledger.forget_the_outline()
        of_the_run = found if model is not None and _is_recorded(self.path, model) else None
        record.close(ledger, of_the_run, settings, own, len(earlier))
        return (earlier if found else []) + found, ledger, record.plan

    def _cell(self, bag: "Bag") -> str | None:
        """The namespace of the cell to read: the one that is given, or the only one with observations; None: there is none.

        Raises:
            InvalidInput: there are several, and none is given.
        """
        if self._namespace is not None:
            return f"/{self._namespace.strip('/')}".rstrip("/")
        found = cells(bag)
        if len(found) > 1:
            which = f"{len(found)} cells, {', '.join(cell or '/' for cell in found)}"
            raise InvalidInput(f"{bag.path}: holds the observations of {which}; choose one with --namespace")
        return found[0] if found else None


def _opened(path: pathlib.Path) -> "Bag":
    with extra("bags", f"the bag {path}"):
        from pushfric_core.bags.bag import Bag  # not above: a CSV needs none of these libraries
    return Bag(path)


def _recorded_types(bag: "Bag") -> dict[str, str]:
    """The type of each topic that has messages."""
    return {topic.name: topic.type_name for topic in bag.summary.topics if topic.message_count}


def cells(bag: "Bag") -> list[str]:
    """The namespaces of the cells with observations."""
    recorded = _recorded_types(bag).keys()
    wanted = (POSE_TOPICS, OBSERVATION_TOPICS)
    found = {name.rpartition("/")[0] for name in recorded}
    return sorted(cell for cell in found if any({f"{cell}/{one}" for one in names} <= recorded for names in wanted))


def _check_type(bag: "Bag", topic: str, type_name: str) -> None:
    expected = TYPES[topic.rpartition("/")[2]]
    if type_name != expected:
        raise InvalidInput(f"{bag.path}: {topic} holds messages of {type_name[:80]}, expected {expected}")


class Reading:
    """The observations of a CSV file or a bag, and their account.

    Attributes:
        observations: the observations, in order, without those of excluded pushes.
        ledger: what became of every message, and what does not add up.
        plan: what became of the plan.
    """

    def __init__(self, found: list[Observation], excluded: Collection[int], ledger: Ledger, plan: PlanRecord) -> None:
        self.observations = [observation for observation in found if observation.push_id not in excluded]
        self.ledger, self.plan = ledger, plan
        self._found, self._excluded = found, excluded

    def settle(self, estimator: Estimator) -> None:
        """Enter what an estimator has made of the observations."""
        self.ledger.settle(
            Counter(one.push_id for one in self._found),
            Counter(one.push_id for one in estimator.observations),
            self._excluded,
            {one.push_id for one in estimator.rejected},
            self.plan.started,
            self.plan.aborted,
        )


def _enter_unread(bag: "Bag", source: ObservationSource, ledger: Ledger) -> None:
    """Enter the messages of other cells, which are not read."""
    for topic in bag.summary.topics:
        namespace, _, name = topic.name.rpartition("/")
        if name in INPUTS and namespace != source.namespace:
            ledger.accounts[INPUTS[name][0]].enter(FOREIGN, topic.message_count)


def _is_recorded(path: pathlib.Path, model: ObjectModel) -> bool:
    """Whether a model has the outline of the object that was recorded, as far as the bag's folder says."""
    file = beside(path, OBJECT_FILE)
    if file is None:
        return True
    recorded = load_object(str(file)).outline.vertices
    return np.array_equal(recorded, model.outline.vertices)


def _made(
    bag: "Bag",
    source: ObservationSource,
    outline: Outline,
    config: TrajectoryConfig,
    ledger: Ledger,
    record: RunRecord,
    warn: Warn,
) -> Iterator[Observation]:
    """The observations of a bag; its record takes the messages of its topics on the way."""
    maker = ObservationMaker(outline, config, with_forces=len(source.topics) > len(POSE_TOPICS))
    for message in bag.messages((*source.topics, *record.topics)):
        if message.topic in record.topics:
            record.take(message)
        if message.topic not in source.topics:
            continue
        kind, sample_from_msg = INPUTS[message.topic.rpartition("/")[2]]
        try:
            yield from maker.add(content(bag, message, sample_from_msg), message.log_time_ns)
        except (ValueError, UninformativePush) as error:
            warn(f"{message.topic} refused: {error}")
            ledger.accounts[kind].enter(REFUSED)
    if source.kind == "poses":
        ledger.absorb(maker.ledger(record.plan.planned, bag.numbered))
    if (apart := maker.trajectory.apart) is not None:
        warn(f"{bag.path}: {tip_stays_away(apart)}")
    if maker.waiting:
        warn(f"{bag.path}: ends before the force of its last observations was measured; left out: {maker.waiting}")
