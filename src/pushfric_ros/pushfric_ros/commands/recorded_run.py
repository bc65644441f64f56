"""The bag of a run: where it goes, what an interrupted run leaves in it, and the course of its estimates."""

import pathlib
from collections.abc import Collection

from pushfric_core.errors import PushfricError
from pushfric_core.estimate import Estimate
from pushfric_core.observation import Observation
from pushfric_core.planar import Twist
from pushfric_msgs.msg import FrictionEstimate
from pushfric_ros.commands.console import warn
from pushfric_ros.files.estimator_settings import EstimatorSettings
from pushfric_ros.files.object_file import OBJECT_FILE, ObjectModel, load_object

RUNS = pathlib.Path("runs")
"""Folder for bags, unless the command line gives another."""


def left_behind(bag: pathlib.Path) -> str:
    """What an interrupted run has left, in words."""
    if not bag.exists() or not any(bag.iterdir()):
        return "interrupted before there was a bag"
    try:
        _, _, data = _recorded(bag)
    except PushfricError as error:
        return f"bag left in {bag}, which gives no estimate: {error}"
    return f"bag left in {bag} (pushes: {len({point.push_id for point in data})}); ./pushfric estimate {bag} reads it"


def disagreements(bag: pathlib.Path, live: FrictionEstimate | None, pushed: Collection[int], aborted: int) -> list[str]:
    """The differences between the bag, the live estimate and the plan of a finished run, in words; empty if they agree.

    Args:
        bag: folder of the bag.
        live: the last estimate that the run published; None if there was none.
        pushed: ids of the pushes of the plan that were carried out.
        aborted: number of those pushes that did not reach their end.
    """
    from pushfric_ros.bags import data_points

    said = [f"{aborted} of {len(pushed)} pushes were aborted"] if aborted else []
    try:
        model, settings, data = _recorded(bag)
        made = data_points.recorded_observations(bag, model, settings, warn)
    except PushfricError as error:
        return [*said, f"the bag {bag} gives no estimate: {error}"]
    if empty := sorted(set(pushed) - {point.push_id for point in data} - {*settings.excluded}):
        said.append(f"no data point came from push {', '.join(str(push_id + 1) for push_id in empty)}")
    estimator = settings.new_estimator(model.support_points)
    # the node has told of the data points that it refused
    counts = (0, 0)
    for estimate in data_points.taken(estimator.take, data, lambda _: None):
        counts = estimate.data_points, estimate.pushes
    live_counts = (0, 0) if live is None else (live.data_points, live.pushes)
    if counts != live_counts or {*map(_content, made)} != {*map(_content, data)}:
        said.append(
            "the live estimate missed messages that are in the bag, or the other way round: it has {} data points of {} "
            "pushes, the bag {} of {}; read the bag with ./pushfric estimate {}".format(*live_counts, *counts, bag)
        )
    return said


def _content(point: Observation) -> tuple[int, int, Twist]:
    return point.stamp, point.push_id, point.twist


def course_of(bag: pathlib.Path) -> tuple[list[Estimate], tuple[Observation, ...]]:
    """The estimates after each data point, and the data points, from a recorded bag; for figures."""
    from pushfric_ros.bags import data_points

    model, settings, data = _recorded(bag)
    estimator = settings.new_estimator(model.support_points)
    return list(data_points.taken(estimator.take, data, warn)), estimator.observations


def _recorded(bag: pathlib.Path) -> tuple[ObjectModel, EstimatorSettings, list[Observation]]:
    """The object of a bag, the settings it was estimated with, and its data points."""
    from pushfric_ros.bags import data_points  # not before the run has ended: it would hold 10 MB meanwhile

    model, settings = load_object(str(bag / OBJECT_FILE)), data_points.recorded_settings(bag)
    return model, settings, data_points.observations(bag, model, settings, warn)
