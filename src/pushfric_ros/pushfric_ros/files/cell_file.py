"""A cell's YAML file: camera, pusher, object, push plan and how it estimates."""

import pathlib
from typing import Annotated, Any

import pydantic

from pushfric_ros.files.estimator_settings import EstimatorSettings
from pushfric_ros.files.object_file import Point, Strict, read_yaml
from pushfric_ros.pushers.pusher import PusherConfig


class CameraEntry(Strict):
    """Where images come from, and how they map to the table."""

    source: str = "0"  # device index, URL, video file or image folder; topic or compressed: subscribe
    calibration: str  # path of the camera's calibration YAML
    fiducials: str = ""  # path of the YAML of the markers on the object; empty: it is seen by its outline
    object_height: Annotated[float, pydantic.Field(ge=0, le=1)] = 0.0  # over the table [m]; 0: as the object's file says
    threshold: Annotated[int, pydantic.Field(ge=0, le=255)] = 0  # of brightness; 0: found in each frame (Otsu)
    time_offset: float = 0.0  # added to the stamps of the images [s]


class PusherEntry(Strict):
    """The linear stage and its line on the table."""

    port: str  # serial port of the GRBL controller
    baud: int = PusherConfig.baud
    axis: str = PusherConfig.axis  # with a minus sign where the forward stroke goes to negative coordinates
    home: bool = (
        PusherConfig.home
    )  # seek the home switch at activation; otherwise work zero of the controller is stroke position 0
    line_origin: Point  # centre of the tip at stroke position 0, in the table frame [m]
    line_direction: Point  # of the forward stroke, in the table frame
    tip_radius: Annotated[float, pydantic.Field(ge=0)]  # [m]
    stroke: Annotated[float, pydantic.Field(gt=0)]  # travel [m]
    max_speed: Annotated[float, pydantic.Field(gt=0)]  # [m/s]


class PlanEntry(Strict):
    """What is pushed where, and how."""

    file: str = ""  # path of a push plan; empty: a few pushes along each edge
    # this many pushes are chosen one by one instead, to shrink the region of p_CF fastest; 0: those of the file
    choose: Annotated[int, pydantic.Field(ge=0, le=1000)] = 0
    distance: Annotated[float, pydantic.Field(gt=0)] = 0.05  # [m]
    speed: Annotated[float, pydantic.Field(gt=0)] = 0.02  # [m/s]

    @pydantic.model_validator(mode="after")
    def _one_way(self) -> "PlanEntry":
        if self.file and self.choose:
            raise ValueError("give file or choose, not both")
        return self


class CellFile(Strict):
    """One robot cell."""

    namespace: str = "/cell"
    object: str  # name of an object of Table 1, or path of an object YAML
    camera: CameraEntry
    pusher: PusherEntry
    plan: PlanEntry = PlanEntry()
    # parameters of the estimator node: see EstimatorSettings
    estimator: dict[str, Any] = pydantic.Field(default={})

    @pydantic.field_validator("estimator")
    @classmethod
    def _known(cls, values: dict[str, Any]) -> dict[str, Any]:
        return EstimatorSettings.from_parameters(values).parameters(values)


def load_cell(path: pathlib.Path) -> CellFile:
    """A cell file; relative paths in it are meant from its own folder.

    Raises:
        InvalidInput: it cannot be read or does not describe a cell.
    """
    cell = read_yaml(path, CellFile)
    folder = path.resolve().parent

    def beside(name: str) -> str:
        return str(folder / name) if name and (folder / name).exists() else name

    files = {name: beside(getattr(cell.camera, name)) for name in ("calibration", "fiducials")}
    camera = cell.camera.model_copy(update=files)
    plan = cell.plan.model_copy(update={"file": beside(cell.plan.file)})
    return cell.model_copy(update={"object": beside(cell.object), "camera": camera, "plan": plan})
