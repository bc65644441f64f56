"""What is known of an object before it is pushed: its outline and hypothesised supports, from a YAML file or from Table 1."""

import csv
import pathlib
from dataclasses import dataclass
from typing import Annotated, TypeVar

import numpy as np
import pydantic
import yaml

from pushfric_core.errors import InvalidInput
from pushfric_core.outline import Outline
from pushfric_core.planar import Array
from pushfric_core.simulation import TABLE_1

Point = tuple[float, float]
OBJECT_FILE = "object.yaml"
"""A bag's folder may say under this name of what object it is."""

Model = TypeVar("Model", bound=pydantic.BaseModel)


class Strict(pydantic.BaseModel):
    """A part of a YAML file: unknown keys and numbers that are not finite are refused."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class SupportFile(Strict):
    """Hypothesised support points: exactly one of grid, points and spacing."""

    grid: tuple[int, int] | None = None  # columns and rows over the bounding box shrunk by inset
    inset: float = 0.002  # [m]
    points: Annotated[list[Point], pydantic.Field(min_length=1)] | None = None  # [m]
    spacing: float | None = None  # [m], of a grid as close to it as fits the bounding box

    @pydantic.model_validator(mode="after")
    def _one_way(self) -> "SupportFile":
        if sum(way is not None for way in (self.grid, self.points, self.spacing)) != 1:
            raise ValueError("expected exactly one of grid, points and spacing")
        return self

    def points_over(self, outline: Outline) -> Array:
        """The support points (n, 2) [m]."""
        if self.points is not None:
            return np.array(self.points)
        if self.grid is not None:
            return outline.grid(*self.grid, self.inset)
        assert self.spacing is not None
        if not self.spacing > 0:
            raise ValueError(f"spacing must be positive, got {self.spacing:g} m")
        columns, rows = np.maximum(1, np.round((outline.size - 2 * self.inset) / self.spacing).astype(int) + 1)
        return outline.grid(int(columns), int(rows), self.inset)


class HypothesisFile(Strict):
    """One hypothesis to be told apart from others (section 5.2)."""

    name: str
    center_of_friction: Point | None = None  # [m]
    support: SupportFile | None = None
    rotation_deg: float = 0.0


class ObjectFile(Strict):
    """An object's YAML file."""

    name: Annotated[str, pydantic.Field(min_length=1)]
    outline: Annotated[list[Point], pydantic.Field(min_length=3)]  # corners in order [m]
    support: SupportFile = SupportFile(grid=(6, 6))
    height: Annotated[float, pydantic.Field(ge=0)] = 0.0  # of the outline the camera sees, over the table [m]
    hypotheses: list[HypothesisFile] = []


@dataclass(frozen=True)
class ObjectModel:
    """An object as the cell knows it, in the object frame."""

    name: str
    outline: Outline
    support_points: Array  # (n, 2) hypothesised [m]
    height: float  # of the outline the camera sees, over the table [m]
    file: ObjectFile  # what it was made from


def load_object(name_or_path: str) -> ObjectModel:
    """An object of Table 1 by name, or one from a YAML file.

    Raises:
        InvalidInput: neither, or the file does not describe an object.
    """
    if name_or_path in TABLE_1:
        known = TABLE_1[name_or_path]
        vertices = [(float(x), float(y)) for x, y in known.outline.vertices]
        return make_object(
            ObjectFile(name=name_or_path, outline=vertices, support=SupportFile(grid=known.grid, inset=known.inset)),
            name_or_path,
        )
    path = pathlib.Path(name_or_path)
    if not path.is_file():
        raise InvalidInput(f"no object {name_or_path!r}: expected a YAML file or one of {', '.join(TABLE_1)}")
    return make_object(read_yaml(path, ObjectFile), str(path))


def make_object(file: ObjectFile, where: str) -> ObjectModel:
    """The object a file describes; `where` names the file in errors.

    Raises:
        InvalidInput: the outline or the support points make no sense.
    """
    try:
        outline = Outline(np.array(file.outline))
        return ObjectModel(file.name, outline, file.support.points_over(outline), file.height, file)
    except ValueError as error:
        raise InvalidInput(f"{where}: {error}") from error


def save_object(model: ObjectModel, path: pathlib.Path) -> None:
    """Write the object's YAML file."""
    content = model.file.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    path.write_text(yaml.safe_dump(content, sort_keys=False))


def read_yaml(path: pathlib.Path, model: type[Model]) -> Model:
    """A YAML file as a pydantic model.

    Raises:
        InvalidInput: cannot be read, is not YAML, or does not fit the model; one line naming file, field and expectation.
    """
    try:
        content = yaml.safe_load(path.read_text())
        return model.model_validate(content)
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInput(f"{path}: cannot be read: {error}") from error
    except yaml.YAMLError as error:
        raise InvalidInput(f"{path}: not YAML: {' '.join(str(error).split())}") from error
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        field = ".".join(map(str, first["loc"])) or "the file"
        raise InvalidInput(f"{path}: {field}: {first['msg']}, got {str(first['input'])[:60]!r}") from error


def read_points(path: pathlib.Path) -> Array:
    """Support points (n, 2) [m] from a CSV file with columns x,y.

    Raises:
        InvalidInput: names the file, the line, and what was expected there.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.DictReader(stream, skipinitialspace=True)
            if missing := [name for name in ("x", "y") if name not in (reader.fieldnames or [])]:
                raise InvalidInput(f"{path}: missing column {', '.join(missing)}; expected x, y")
            points = [_point(row, f"{path}, line {reader.line_num}") for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InvalidInput(f"{path}: cannot be read: {error}") from error
    if not points:
        raise InvalidInput(f"{path}: no support points; expected a row for each")
    return np.array(points)


def _point(row: dict[str, str], where: str) -> Point:
    try:
        x, y = float(row["x"]), float(row["y"])
    except (TypeError, ValueError):
        raise InvalidInput(f"{where}: x and y must be numbers, got {row['x']!r}, {row['y']!r}") from None
    if not np.isfinite((x, y)).all():
        raise InvalidInput(f"{where}: x and y must be finite, got {x}, {y}")
    return x, y
