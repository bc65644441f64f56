"""Loads what several commands are given: the object of a bag or a CSV, and its support points."""

import pathlib

import pydantic

from pushfric_core.errors import InvalidInput
from pushfric_core.table_1 import TABLE_1
from pushfric_ros.bags import data_points
from pushfric_ros.files.object_file import ObjectModel, SupportFile, complaint, load_object, make_object, read_points


def object_of(path: pathlib.Path, name: str) -> tuple[ObjectModel, str]:
    """The object that is named, or the one next to the bag; and where it came from.

    Args:
        path: the bag or the CSV.
        name: name of the object, or path of its YAML; empty: the one next to the bag.
    Raises:
        InvalidInput: there is no such object, or its file does not describe an object.
    """
    data_points.check_source(path)
    next_to_bag = data_points.object_beside(path)
    if not name and next_to_bag is None:
        raise InvalidInput(f"{path} does not name the pushed object; give --object OBJ.yaml or one of {', '.join(TABLE_1)}")
    where = name or str(next_to_bag)
    return load_object(where), where


def with_support(model: ObjectModel, grid: tuple[int, int] | None, file: pathlib.Path | None) -> ObjectModel:
    """The object with other support points, if any are given; hypotheses with their own support points keep them.

    Raises:
        InvalidInput: both a grid and a file are given, or one of them is unusable.
    """
    if file is not None and grid is not None:
        raise InvalidInput("give --grid or --support-points, not both")
    if file is not None:
        support, where = SupportFile(points=[(x, y) for x, y in read_points(file).tolist()]), str(file)
    elif grid is not None:
        try:
            support, where = SupportFile(grid=grid, inset=model.file.support.inset), "--grid"
        except pydantic.ValidationError as error:
            raise InvalidInput(f"--grid: {complaint(error)}") from error
    else:
        return model
    return make_object(model.file.model_copy(update={"support": support}), where)
