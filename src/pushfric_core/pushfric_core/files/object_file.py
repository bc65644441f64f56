"""An object before it is pushed: outline and hypothesised supports, from a YAML file or Table 1."""

import math
import os
import pathlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import pydantic
import yaml

from pushfric_core.errors import InvalidInput, blaming
from pushfric_core.estimation.recognition import Hypothesis
from pushfric_core.files.csv_files import read_table
from pushfric_core.files.disk import write_whole
from pushfric_core.files.yaml_files import Strict, edited_yaml, fitting, read_yaml
from pushfric_core.files.yaml_text import Value, load_yaml
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array
from pushfric_core.geometry.table_1 import LOOKALIKES, ORIENTATIONS, TABLE_1
from pushfric_core.plausible import FARTHEST, LARGEST, check_within, other_unit
from pushfric_core.wording import shortened


def within(most: float, unit: str) -> Any:
    """Pydantic's check that a number is within its bounds."""

    def check(value: float) -> float:
        check_within("the number", (value,), most, unit)
        return value

    return pydantic.AfterValidator(check)


Length = Annotated[float, within(FARTHEST, "m")]
Point = tuple[Length, Length]
CAMERA_FILE = "camera.yaml"
PRIOR_FILE = "prior.yaml"
"""Name of the model in a bag's folder that the recorded run went on from."""

OBJECT_FILE = "object.yaml"
"""Name of the file in a bag's folder that describes its object."""


ROW_LIMIT = 300
"""Support points in a row of a grid."""

Rows = Annotated[int, pydantic.Field(ge=-ROW_LIMIT, le=ROW_LIMIT)]


class SupportFile(Strict):
    """Hypothesised support points: exactly one of grid, points and spacing."""

    grid: tuple[Rows, Rows] | None = None  # columns and rows over the bounding box shrunk by inset
    inset: Length = 0.002  # [m]
    points: Annotated[list[Point], pydantic.Field(min_length=1)] | None = None  # [m]
    spacing: float | None = None  # of a grid [m]; adjusted slightly to fit the bounding box

    @pydantic.model_validator(mode="after")
    def _one_way(self) -> "SupportFile":
        if sum(way is not None for way in (self.grid, self.points, self.spacing)) != 1:
            raise ValueError("expected exactly one of grid, points and spacing")
        return self

    def points_over(self, outline: Outline) -> Array:
        """The support points (n, 2) over an outline, object frame [m].

        Raises:
            ValueError: the grid or the spacing is impossible for this outline.
        """
        if self.points is not None:
            return np.array(self.points)
        if self.grid is not None:
            return outline.grid(*self.grid, self.inset)
        assert self.spacing is not None
        spacing, longest = self.spacing, float(max(outline.size))
        if not 0 < spacing <= longest:
            asked = other_unit("m", lambda factor: 0 < spacing * factor <= longest)
            raise ValueError(f"spacing must lie in (0, {longest:g}] m, got {spacing:g}{asked}")
        size = outline.size - 2 * self.inset
        if max(size) >= (ROW_LIMIT - 0.5) * spacing:  # a quotient may be too large for a number
            raise ValueError(f"spacing must give at most {ROW_LIMIT} points a row, got {spacing:g} m")
        columns, rows = (max(1, round(length / spacing) + 1) for length in size.tolist())
        return outline.grid(columns, rows, self.inset)


class HypothesisFile(Strict):
    """A hypothesis for recognition (section 5.2)."""

    name: Annotated[str, pydantic.Field(min_length=1)]
    center_of_friction: Point | None = None  # [m]
    support: SupportFile | None = None  # None: that of the object
    rotation_deg: float = 0.0  # rotation of both about the centroid of the outline, counter-clockwise

    def over(self, outline: Outline, support_points: Array) -> Hypothesis:
        """The hypothesis as the core takes it.

        It is rotated about the centroid of the outline, because every rotation after which an outline looks the same leaves
        the centroid where it is, wherever the origin of the object frame is.

        Args:
            outline: of the object.
            support_points: (n, 2) those of the object [m].
        Raises:
            ValueError: the hypothesis has impossible support points of its own.
        """
        with blaming(f"hypothesis {self.name!r}", error=ValueError):
            points = support_points if self.support is None else self.support.points_over(outline)
        center = None if self.center_of_friction is None else np.array(self.center_of_friction)
        centroid = outline.polygon.centroid
        return Hypothesis(self.name, points, center).turned(math.radians(self.rotation_deg), (centroid.x, centroid.y))


class ObjectFile(Strict):
    """An object's YAML file."""

    name: Annotated[str, pydantic.Field(min_length=1)]
    outline: Annotated[list[Point], pydantic.Field(min_length=3)]  # corners in order [m]
    support: SupportFile = SupportFile(grid=(6, 6))
    height: Annotated[float, pydantic.Field(ge=0), within(LARGEST, "m")] = (
        0.0  # of the outline the camera sees, over the table [m]
    )
    hypotheses: list[HypothesisFile] = pydantic.Field(default_factory=list)

    @pydantic.field_validator("hypotheses")
    @classmethod
    def _names_differ(cls, hypotheses: list[HypothesisFile]) -> list[HypothesisFile]:
        names = [hypothesis.name for hypothesis in hypotheses]
        if len(set(names)) < len(names):
            raise ValueError(f"expected names that differ, got {', '.join(names)}")
        return hypotheses


@dataclass(frozen=True)
class ObjectModel:
    """An object as the cell knows it; all positions are in the object frame."""

    name: str
    outline: Outline
    support_points: Array  # (n, 2) hypothesised support points [m]
    height: float  # of the outline the camera sees, over the table [m]
    hypotheses: tuple[Hypothesis, ...]  # for recognition; often empty
    file: ObjectFile  # the file it was made from


def load_object(name_or_path: str) -> ObjectModel:
    """An object of Table 1 by name, or one from a YAML file.

    Raises:
        InvalidInput: there is no such object or file, or the file does not describe an object.
    """
    if name_or_path in TABLE_1:
        known = TABLE_1[name_or_path]
        support = SupportFile(grid=known.grid, inset=known.inset)
        hypotheses = _table_1_hypotheses(name_or_path)
        file = ObjectFile(name=name_or_path, outline=_points(known.outline.vertices), support=support, hypotheses=hypotheses)
        return make_object(file, name_or_path)
    path = pathlib.Path(name_or_path)
    if path.suffix != ".yaml" and not os.path.isfile(path):
        raise InvalidInput(f"no object {shortened(name_or_path)}: expected a YAML file or one of {', '.join(TABLE_1)}")
    return make_object(read_yaml(path, ObjectFile), str(path))


def make_object(file: ObjectFile, where: str) -> ObjectModel:
    """The object that a file describes; `where` names the file in errors.

    Raises:
        InvalidInput: the outline or some support points are impossible.
    """
    with blaming(where):
        outline = Outline(np.array(file.outline))
        points = file.support.points_over(outline)
        _check_on("support points", points, outline)
        if (points == points[0]).all():
            raise ValueError(f"the support points must differ, got only ({points[0, 0]:g}, {points[0, 1]:g})")
        hypotheses = tuple(hypothesis.over(outline, points) for hypothesis in file.hypotheses)
        for hypothesis in hypotheses:
            _check_on(f"the support points of {hypothesis.name}", hypothesis.support_points, outline)
            if hypothesis.center_of_friction is not None:
                _check_on(f"the center_of_friction of {hypothesis.name}", hypothesis.center_of_friction[None], outline)
        return ObjectModel(file.name, outline, points, file.height, hypotheses, file)


def _check_on(what: str, points: Array, outline: Outline) -> None:
    """Refuse points (n, 2) [m] that are farther off than the object is long; feet may stick out. Raises ValueError."""
    longest = float(max(outline.size))
    low, high = outline.lower - longest, outline.lower + outline.size + longest

    def off(points: Array) -> Array:
        return np.asarray(((points < low) | (points > high)).any(axis=1))

    if (wrong := points[off(points)]).size:
        x, y = wrong[0]
        asked = other_unit("m", lambda factor: not off(points * factor).any())
        raise ValueError(f"{what} must lie within {longest:g} m of the outline, got ({x:g}, {y:g}) m{asked}")


def _table_1_hypotheses(name: str) -> list[HypothesisFile]:
    """The hypotheses that the paper compares for an object of Table 1: other objects, or orientations, that look the same."""
    if name in LOOKALIKES:
        return [HypothesisFile(name=other, center_of_friction=center) for other, center in LOOKALIKES.items()]
    feet = SupportFile(points=_points(TABLE_1[name].support.points))
    return [
        HypothesisFile(name=f"turned by {turn} degrees", support=feet, center_of_friction=(0.0, 0.0), rotation_deg=turn)
        for turn in ORIENTATIONS.get(name, ())
    ]


def _points(xy: Array) -> list[Point]:
    return [(float(x), float(y)) for x, y in xy]


def save_object(model: ObjectModel, path: pathlib.Path) -> None:
    """Write the YAML file of an object.

    Raises:
        InvalidInput: the file cannot be written.
    """
    content = model.file.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    write_whole(path, yaml.safe_dump(content, sort_keys=False))


def edited_object(target: pathlib.Path, values: Mapping[str, Value]) -> tuple[str, ObjectModel]:
    """The text of an object's file with new values, and the object; everything else in the text stays.

    Args:
        target: the file, which need not exist.
        values: by key.
    Raises:
        InvalidInput: the file cannot be read, or does not fit the values; for example, support points lie outside.
    """
    if target.exists():
        text = edited_yaml(target, None, values)
    else:
        text = yaml.safe_dump({"name": target.stem, **values}, sort_keys=False, default_flow_style=None, width=120)
    with fitting(target):
        return text, make_object(ObjectFile.model_validate(load_yaml(text)), str(target))


def read_points(path: pathlib.Path) -> Array:
    """Support points (n, 2) [m] from a CSV file with columns x,y.

    Raises:
        InvalidInput: the file cannot be read as such a table; the text names the file, the line, and what was expected there.
    """
    return np.array([row.lengths(("x", "y")) for row in read_table(path, ("x", "y"), "support points").rows])
