"""The bag of a run: where it goes, what an interrupted run leaves in it, and the course of its estimates."""

import contextlib
import pathlib
from collections.abc import Iterator

from pushfric_core.errors import PushfricError
from pushfric_core.estimate import Estimate
from pushfric_core.estimator import Estimator
from pushfric_core.observation import Observation
from pushfric_ros.commands.console import console, warn
from pushfric_ros.files.estimator_settings import EstimatorSettings
from pushfric_ros.files.object_file import OBJECT_FILE, ObjectModel, load_object

RUNS = pathlib.Path("runs")
"""Folder for bags, unless the command line gives another."""


@contextlib.contextmanager
def telling_what_is_left(bag: pathlib.Path) -> Iterator[None]:
    """If Ctrl-C interrupts the run, tell the operator which bag it leaves."""
    try:
        yield
    except KeyboardInterrupt:
        console.print(left_behind(bag), markup=False)
        raise


def left_behind(bag: pathlib.Path) -> str:
    """What an interrupted run has left, in words."""
    if not bag.exists() or not any(bag.iterdir()):
        return "interrupted before there was a bag"
    try:
        _, _, data = _recorded(bag)
    except PushfricError as error:
        return f"bag left in {bag}, which gives no estimate: {error}"
    return f"bag left in {bag} (pushes: {len({point.push_id for point in data})}); ./pushfric estimate {bag} reads it"


def course_of(bag: pathlib.Path) -> tuple[list[Estimate], tuple[Observation, ...]]:
    """The estimates after each data point, and the data points, from a recorded bag; for figures."""
    from pushfric_ros.bags import data_points

    model, settings, data = _recorded(bag)
    estimator = Estimator(model.support_points, settings.estimator)
    return list(data_points.taken(estimator.add, data, warn)), estimator.observations


def _recorded(bag: pathlib.Path) -> tuple[ObjectModel, EstimatorSettings, list[Observation]]:
    """The object of a bag, the settings it was estimated with, and its data points."""
    from pushfric_ros.bags import data_points  # not before the run has ended: it would hold 10 MB meanwhile

    model, settings = load_object(str(bag / OBJECT_FILE)), data_points.recorded_settings(bag)
    return model, settings, data_points.observations(bag, model, settings, warn)
