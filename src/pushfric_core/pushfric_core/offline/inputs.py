"""Loads what commands and notebooks are given: observations, the object of a bag or a CSV, and its support points."""

import contextlib
import os
import pathlib
import warnings
from collections.abc import Iterable

from pushfric_core.bags.recorded import Recorded, beside, check_source
from pushfric_core.errors import InvalidInput
from pushfric_core.estimation.estimator import Estimator, Warn
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.model_file import SUFFIXES, ModelFile, load_model
from pushfric_core.files.object_file import (
    OBJECT_FILE,
    ObjectFile,
    ObjectModel,
    SupportFile,
    load_object,
    make_object,
    read_points,
)
from pushfric_core.files.yaml_files import fitting, read_yaml, yaml_content
from pushfric_core.geometry.table_1 import TABLE_1
from pushfric_core.trajectories.observation import Observation
from pushfric_core.trajectories.observations import Observations


def object_of(path: pathlib.Path, name: str, warn: Warn, option: str = "--object OBJ.yaml") -> tuple[ObjectModel, str]:
    """The object that is named, or the one next to the bag; and where it came from.

    Args:
        path: the bag or the CSV.
        name: name of the object, or path of its YAML; empty: the one next to the bag.
        warn: called with a line if the bag has another object than the one that is named.
        option: how the caller names an object, for the error.
    Raises:
        InvalidInput: there is no such object, or its file does not describe an object.
    """
    check_source(path)
    next_to_bag = beside(path, OBJECT_FILE)
    if not name and next_to_bag is None:
        raise InvalidInput(f"{path} does not name the pushed object; give {option} or one of {', '.join(TABLE_1)}")
    where = name or str(next_to_bag)
    model = load_object(where)
    if name and next_to_bag is not None:
        with contextlib.suppress(InvalidInput):  # one that cannot be read is a reason to name another
            own = load_object(str(next_to_bag))
            if (own.name, own.outline) != (model.name, model.outline):
                warn(f"{path}: its own object {own.name!r} is not used, but the given {model.name!r}")
    return model, where


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
        with fitting("--grid"):
            support, where = SupportFile(grid=grid, inset=model.file.support.inset), "--grid"
    else:
        return model
    return make_object(model.file.model_copy(update={"support": support}), where)


class Recording(Observations):
    """The result of `load`: observations, and what was recorded with them.

    Args:
        observations: in order.
        object: that was pushed: its `name`, `outline`, `support_points` (n, 2) [m], object frame, and `hypotheses`.
        settings: of the recorded run's estimator; the defaults if none were recorded. `settings.estimator` is its config.

    Example:
        >>> import pathlib
        >>> from pushfric_core import load
        >>> columns = "push_id,contact_x,contact_y,normal_x,normal_y,vx,vy,omega"
        >>> _ = pathlib.Path("pushes.csv").write_text(f"{columns}\\n0,0.01,-0.032,0,-1,0,0.02,0.1\\n")
        >>> recording = load("pushes.csv", object="wood_rect4")
        >>> estimate = recording.new_estimator().add(recording)
        >>> estimate.data_points
        1
    """

    def __init__(self, observations: Iterable[Observation], object: ObjectModel, settings: EstimatorSettings) -> None:
        super().__init__(observations)
        self.object, self.settings = object, settings

    def new_estimator(self) -> Estimator:
        """An estimator without observations, over the object's support points and with the recorded settings.

        `recording.new_estimator().add(recording)` is the estimate of `pushfric estimate`. The same by hand:
        `Estimator(recording.object.support_points, recording.settings.estimator, outline=recording.object.outline)`, and `keep`
        for each push in `recording.settings.kept`.
        """
        return self.settings.new_estimator(self.object.support_points, outline=self.object.outline)


def load(
    source: str | os.PathLike[str], object: str | os.PathLike[str] = "", partial: bool = False, namespace: str | None = None
) -> Recording | ModelFile | ObjectModel:
    """The observations of a bag or a CSV, with the object that was pushed: what `pushfric estimate` estimates from.

    Of a saved model, the file itself, with the names of the JSON of `estimate` as attributes; of an object, as `edit` and
    `calibrate` know it, its outline and support points.

    A warning (UserWarning) names each message that is refused, and whatever does not add up in the bag.

    Args:
        source: the bag (folder or .mcap), or the CSV of observations (docs/files.md), object frame, SI units; or the model
            that `estimate --save` has written (.yaml); or an object of Table 1 by name, or its YAML.
        object: an object of Table 1 by name, or the path of its YAML; may be left out for a bag with object.yaml next to it.
        partial: accept a bag from which messages are missing.
        namespace: of the cell; None: the bag has only one.
    Raises:
        InvalidInput: the source or the object cannot be read; one line says what is wrong, where, and what was expected.
        DamagedBag: messages are missing from the bag.
        MissingPackage: the packages that read bags are not installed.

    Example:
        >>> import pathlib
        >>> from pushfric_core import load
        >>> columns = "push_id,contact_x,contact_y,normal_x,normal_y,vx,vy,omega"
        >>> _ = pathlib.Path("pushes.csv").write_text(f"{columns}\\n0,0.01,-0.032,0,-1,0,0.02,0.1\\n")
        >>> recording = load("pushes.csv", object="wood_rect4")
        >>> len(recording), recording.object.support_points.shape
        (1, (15, 2))
    """
    path = pathlib.Path(source)
    if path.suffix in SUFFIXES and not path.is_dir():
        content = yaml_content(path)
        if isinstance(content, dict) and "outline" in content:
            return make_object(read_yaml(path, ObjectFile, content), str(path))
        return load_model(path, content)[0]
    if str(path) in TABLE_1 and not path.exists():
        return load_object(str(path))
    if not path.exists():
        raise InvalidInput(f"{path}: no such file; expected a bag, a CSV of observations, a model or an object")
    said: list[str] = []
    try:
        model, _ = object_of(path, os.fspath(object), said.append, "object='OBJ.yaml'")
        recorded = Recorded(path, namespace)
        reading = recorded.read(model, recorded.settings, said.append, partial)
    finally:
        for line in said:
            warnings.warn(line, stacklevel=2)
    return Recording(reading.observations, model, recorded.settings)
