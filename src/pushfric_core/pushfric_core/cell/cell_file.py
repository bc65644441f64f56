"""A cell's YAML file: every setting of every node, in sections.

A section holds the fields of one node's settings classes. Its values are read as the node's parameters are, so the file is
refused for the same reasons as the node, in the same words.
"""

import dataclasses
import os
import pathlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pushfric_core.cell.mount import MountConfig
from pushfric_core.cell.node_settings import (
    CameraConfig,
    CellConfig,
    Discovery,
    FrameConfig,
    ImagesConfig,
    ModelConfig,
    ObjectConfig,
    PlanConfig,
    PlannerConfig,
    RecorderConfig,
    SimulationConfig,
    TipConfig,
    ViewConfig,
)
from pushfric_core.errors import blaming
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.yaml_files import yaml_content
from pushfric_core.plugins import PUSHERS, SOURCES, chosen_tracker, plugin, spare_trackers, tracker_kinds
from pushfric_core.pushers.pusher import PusherConfig, PusherDriver
from pushfric_core.settings import key_of, read

ROOT = (CellConfig, FrameConfig, ObjectConfig)
ROOT_KEYS = tuple(key_of(one) for config in ROOT for one in dataclasses.fields(config))
SECTIONS: dict[str, tuple[type, ...]] = {
    "camera": (CameraConfig,),
    "pusher": (PusherConfig,),
    "plan": (PlanConfig,),
    "estimator": (*EstimatorSettings.PARTS, ModelConfig),
    "recorder": (RecorderConfig, ImagesConfig),
    "view": (ViewConfig,),
    "planner": (PlannerConfig,),
    "poses": (MountConfig,),
    "tip": (MountConfig, TipConfig),
    "simulation": (SimulationConfig,),
}
"""The settings of each section, without those of the camera's tracker, the pusher's driver, and the sources."""

INSTEAD = {"poses": "camera", "tip": "pusher"}
"""A section that, if it is there, takes the place of another one."""


def driver_kinds(section: str, values: Mapping[str, Any]) -> list[Any]:
    """The settings classes of the drivers that a section asks for.

    Raises:
        ValueError: there is no such driver.
    """
    if section == "camera":
        return tracker_kinds(values.get("tracker", CameraConfig.tracker))
    if section in INSTEAD:
        return [plugin(SOURCES, values.get("source", MountConfig.source))]
    return [plugin(PUSHERS, values.get("driver", PusherConfig.driver))] if section == "pusher" else []


@dataclass(frozen=True)
class CellFile:
    """A robot cell."""

    object: str  # name of an object of Table 1, or path of an object YAML
    camera: CameraConfig | None  # None: another tracker's poses are followed
    tracker: Any  # settings of the tracker: a pushfric_core.vision.sighting.TrackerDriver
    pusher: PusherConfig | None  # None: another robot's tip is followed
    driver: PusherDriver | None  # settings of the pusher's driver
    plan: PlanConfig = field(default_factory=PlanConfig)
    estimator: EstimatorSettings = field(default_factory=EstimatorSettings)
    recorder: RecorderConfig = field(default_factory=RecorderConfig)
    view: ViewConfig = field(default_factory=ViewConfig)
    planner: PlannerConfig = field(default_factory=PlannerConfig)
    simulation: SimulationConfig = field(default_factory=SimulationConfig)
    namespace: str = CellConfig.namespace
    discovery: Discovery = CellConfig.discovery
    frames: FrameConfig = field(default_factory=FrameConfig)
    model: ModelConfig = field(default_factory=ModelConfig)
    images: ImagesConfig = field(default_factory=ImagesConfig)
    poses: Sequence[Any] = ()  # settings of what is followed instead of the camera, if anything is
    tip: Sequence[Any] = ()  # the same instead of the pusher


def load_cell(path: pathlib.Path) -> CellFile:
    """Read a cell's file (cell.yaml); relative paths in it count from its own folder.

    Raises:
        InvalidInput: it cannot be read or does not describe a cell; one line that names file and key.
    """
    content = yaml_content(path)
    with blaming(path):
        return _cell(content, path.resolve().parent)


def _cell(content: Any, folder: pathlib.Path) -> CellFile:
    whole, known = _mapping("a cell's file", content), (*ROOT_KEYS, *SECTIONS)
    if unknown := [str(key) for key in whole if key not in known]:
        raise ValueError(f"expected any of {', '.join(known)}, got {', '.join(unknown)}")
    both = [(name, other) for name, other in INSTEAD.items() if name in whole and other in whole]
    left_out = {other if name in whole else name for name, other in INSTEAD.items()} - whole.keys()

    def section(name: str) -> tuple[Any, ...]:
        if name in left_out:
            return ()
        values = _mapping(name, whole.pop(name, {}))
        with blaming(name, error=ValueError):
            configs = [*SECTIONS[name], *driver_kinds(name, values)]
            spare = spare_trackers(values.get("tracker", CameraConfig.tracker)) if name == "camera" else []
            return read(_beside(values, folder, [*configs, *spare]), *configs, *spare, keys=True)[: len(configs)]

    made = {name: section(name) for name in SECTIONS}
    (camera, *trackers), (pusher, driver) = made["camera"] or (None,), made["pusher"] or (None, None)
    (*estimator, model), (recorder, images) = made["estimator"], made["recorder"]
    for name, other in both:
        raise ValueError(f"{name}: takes the place of the section {other}, expected one of the two")
    (plan,) = made["plan"]
    if pusher is not None and plan.distance > (longest := min(pusher.stroke, pusher.max_distance)):
        raise ValueError(f"plan: distance must be at most {longest:g}, as stroke and max_distance allow, got {plan.distance:g}")
    if pusher is not None and plan.speed > pusher.max_speed:
        raise ValueError(f"plan: speed must be at most {pusher.max_speed:g}, as max_speed allows, got {plan.speed:g}")
    named, frames, pushed = read(_beside(whole, folder, ROOT), *ROOT)
    with blaming("camera", error=ValueError):
        tracker = chosen_tracker(trackers) if trackers else None
    return CellFile(
        pushed.object,
        camera,
        tracker,
        pusher,
        driver,
        estimator=EstimatorSettings.of(*estimator),
        model=model,
        recorder=recorder,
        images=images,
        frames=frames,
        namespace=named.namespace,
        discovery=named.discovery,
        poses=made["poses"],
        tip=made["tip"],
        **{name: made[name][0] for name in ("plan", "view", "planner", "simulation")},
    )


def _mapping(name: str, content: Any) -> dict[Any, Any]:
    if not isinstance(content, dict):
        raise ValueError(f"{name} must be keys with values, got {'nothing' if content is None else repr(content)[:80]}")
    return dict(content)


def _beside(values: Mapping[str, Any], folder: pathlib.Path, configs: Sequence[type]) -> dict[str, Any]:
    """The values, with paths into the cell's folder made absolute: of files there, and of YAML files that are nowhere."""
    paths = {key_of(field) for config in configs for field in dataclasses.fields(config) if field.metadata.get("path")}

    def lies_there(value: str) -> bool:
        return os.path.exists(folder / value) or (value.endswith(".yaml") and not os.path.exists(value))

    return {
        key: str(folder / value) if key in paths and isinstance(value, str) and value and lies_there(value) else value
        for key, value in values.items()
    }
