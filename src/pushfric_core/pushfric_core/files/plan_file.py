"""A push plan as a YAML file."""

import math
import pathlib
from collections.abc import Iterable, Sequence

import pydantic
import yaml

from pushfric_core.errors import blaming
from pushfric_core.estimation.push_plan import PlannedPush, even_pushes, placement, slipping_pushes
from pushfric_core.files.disk import write_whole
from pushfric_core.files.object_file import Length, ObjectModel
from pushfric_core.files.yaml_files import Strict, read_yaml
from pushfric_core.geometry.contact import PushingLine
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.table_1 import TABLE_1

EDGE_PUSHES = 5
"""Number of pushes along each edge if no plan is given."""

ANY_LINE = PushingLine((0.0, 0.0), (0.0, 1.0), 0.0)
"""A line for the check of a plan; whether a push can be placed does not depend on it."""


class PushEntry(Strict):
    """A push against an edge."""

    edge: int
    offset: Length = 0.0  # of the contact from the middle of the edge, along the edge [m]
    angle_deg: float = 0.0  # of the direction from the inward normal, counter-clockwise


class PlanFile(Strict):
    """The pushes, in order."""

    pushes: list[PushEntry] = pydantic.Field(min_length=1)


def load_plan(path: str, model: ObjectModel) -> list[PlannedPush]:
    """The pushes of a plan file; without a path, as many along each edge as in the paper, or a few, and some that slip.

    Raises:
        InvalidInput: the file is not a plan, or names an edge or offset that the object does not have.
    """
    if not path:
        known = TABLE_1.get(model.name)
        if known is not None and known.outline == model.outline:
            return _default_plan(model.outline, known.pushes)
        return _default_plan(model.outline, [EDGE_PUSHES] * len(model.outline.vertices))
    pushes = []
    for index, entry in enumerate(read_yaml(pathlib.Path(path), PlanFile).pushes):
        push = PlannedPush(entry.edge, entry.offset, math.radians(entry.angle_deg))
        with blaming(f"{path}: pushes.{index}"):
            placement(model.outline, push, ANY_LINE, 0.0)
        pushes.append(push)
    return pushes


def _default_plan(outline: Outline, counts: Sequence[int]) -> list[PlannedPush]:
    """Pushes along each edge, evenly spaced and perpendicular, but for four on two edges, which slip: mu_c needs three."""
    pushed = [edge for edge, count in enumerate(counts) if count]
    sharp = (pushed[0], pushed[len(pushed) // 2])
    even = [count - 2 * (edge in sharp) for edge, count in enumerate(counts)]
    return even_pushes(outline, even) + slipping_pushes(outline, sharp)


def save_plan(pushes: Iterable[PlannedPush], path: pathlib.Path) -> None:
    """Write a plan file.

    Raises:
        InvalidInput: the file cannot be written.
    """
    entries = [{"edge": push.edge, "offset": push.offset, "angle_deg": math.degrees(push.angle)} for push in pushes]
    write_whole(path, yaml.safe_dump({"pushes": entries}, sort_keys=False))
