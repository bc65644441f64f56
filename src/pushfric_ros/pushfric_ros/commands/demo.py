"""The demonstration: the whole graph on a simulated cell, then a summary beside the truth."""

import contextlib
import dataclasses
import pathlib
import tempfile
from collections.abc import Callable, Sequence

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from pushfric_core.errors import InvalidInput
from pushfric_core.estimate import Estimate
from pushfric_core.estimator import Estimator
from pushfric_core.observation import Observation
from pushfric_core.table_1 import TABLE_1
from pushfric_msgs.msg import FrictionEstimate
from pushfric_ros.bags import data_points
from pushfric_ros.commands.interrupt import end_at_once
from pushfric_ros.commands.watch import Monitor
from pushfric_ros.files.cell_file import CellFile
from pushfric_ros.files.estimator_settings import EstimatorSettings
from pushfric_ros.files.node_settings import CameraConfig, PlanConfig, SimulatedRunConfig
from pushfric_ros.files.object_file import OBJECT_FILE, ObjectModel, load_object
from pushfric_ros.graph import graph
from pushfric_ros.graph.supervisor import Ended, Supervisor
from pushfric_ros.pushers.grbl_config import GrblConfig
from pushfric_ros.pushers.pusher import PusherConfig
from pushfric_ros.vision.camera import Camera, save_camera
from pushfric_ros.vision.tracker_settings import ContourConfig

SPEED: float = SimulatedRunConfig.speed
"""Multiple of real time at which the simulated cell runs."""

FIGURE = "figure.png"


def demo_cell(object_name: str, folder: pathlib.Path) -> CellFile:
    """The simulated cell: a camera that looks straight down on a pushing line along y; its files go to `folder`."""
    camera = Camera.looking_down(640, 480, center=(0.0, 0.06), metres_per_pixel=0.000625)
    save_camera(camera, folder / "camera.yaml")
    pusher = PusherConfig(
        line_origin=(0.0, 0.0),
        line_direction=(0.0, 1.0),
        tip_radius=0.003,
        stroke=0.06,
        max_speed=0.1,
    )
    return CellFile(
        object=object_name,
        camera=CameraConfig(source="topic", calibration=str(folder / "camera.yaml")),
        tracker=ContourConfig(),
        pusher=pusher,
        driver=GrblConfig(port=str(folder / "pusher")),
    )


def run_demo(
    console: Console, object_name: str, seed: int, bag: pathlib.Path, live: bool, plan: PlanConfig
) -> tuple[FrictionEstimate | None, Ended]:
    """Run the graph until its plan is finished; returns the last estimate published, and how the run ended."""
    with tempfile.TemporaryDirectory(prefix="pushfric-demo-") as scratch:
        cell = dataclasses.replace(demo_cell(object_name, pathlib.Path(scratch)), plan=plan)
        specs = graph.simulated_cell(cell, str(bag), seed, SPEED)
        console.print(f"simulated cell, {object_name}, at {SPEED:g} times real time; recording {bag}", markup=False)
        ended, last = watch(console, specs, cell.namespace, f"pushing {object_name}", live)
    return last, ended


def watch(
    console: Console,
    specs: list[graph.NodeSpec],
    namespace: str,
    what: str,
    live: bool,
    replayed: Sequence[Observation] | None = None,
    unfinished: Callable[[int], None] | None = None,
) -> tuple[Ended, FrictionEstimate | None]:
    """Run a graph under the eyes of a monitor until it ends and its last estimate is there; Ctrl-C after it ends the process.

    Args:
        specs: the nodes.
        namespace: of all of them.
        what: is going on, for people.
        live: with a display that is drawn anew in place.
        replayed: the data points that a bag holds, where one is played.
        unfinished: an operator watches, who is prompted; told with which push of the plan to go on, if the run ends before.
    """
    steps = None if replayed is None else len({observation.push_id for observation in replayed})

    def say(name: str, line: str) -> None:
        # a node's information is for its log; what it warns of, and the one line of a failed start, is for the operator
        if "[INFO]" not in line and "[DEBUG]" not in line:
            console.print(f"{name}: {line}", highlight=False, markup=False)

    def watched(supervisor: Supervisor) -> tuple[Ended, FrictionEstimate | None]:
        def all_replayed() -> bool:
            return replayed is not None and monitor.estimate is not None and monitor.estimate.data_points >= len(replayed)

        # here, where the supervisor holds signals back, none interrupts its making or its end
        with contextlib.closing(Monitor(console, namespace, what, steps, live, prompts=unfinished is not None)) as monitor:
            try:
                return monitor.watch(supervisor, monitor.settled if replayed is None else all_replayed), monitor.estimate
            finally:
                if unfinished is not None and monitor.next_push is not None:
                    unfinished(monitor.next_push)

    try:
        with Supervisor(specs, namespace, say) as supervisor:
            return watched(supervisor)
    finally:
        end_at_once()


def left_behind(bag: pathlib.Path, warn: data_points.Warn) -> str:
    """What a run that was interrupted has left, for people."""
    if not bag.exists() or not any(bag.iterdir()):
        return "interrupted before there was a bag"
    try:
        _, _, data = _recorded(bag, warn)
    except InvalidInput as error:
        return f"bag left in {bag}, which gives no estimate: {error}"
    return f"bag left in {bag} (pushes: {len({point.push_id for point in data})}); ./pushfric estimate {bag} reads it"


def course_of(bag: pathlib.Path, warn: data_points.Warn) -> tuple[list[Estimate], tuple[Observation, ...]]:
    """The estimates after each data point, and the data points, from what the bag recorded; for figures."""
    model, settings, data = _recorded(bag, warn)
    estimator = Estimator(model.support_points, settings.estimator)
    return list(data_points.taken(estimator.add, data, warn)), estimator.observations


def _recorded(bag: pathlib.Path, warn: data_points.Warn) -> tuple[ObjectModel, EstimatorSettings, list[Observation]]:
    """Of a bag: its object, how the estimator estimated, and the data points."""
    model, settings = load_object(str(bag / OBJECT_FILE)), data_points.recorded_settings(bag)
    return model, settings, data_points.observations(bag, model, settings, warn)


def print_summary(console: Console, name: str, msg: FrictionEstimate) -> None:
    """The last estimate beside the truth of a simulated object."""
    known = TABLE_1[name]
    size, true = known.outline.size, known.support.center_of_friction
    center = (msg.center_of_friction.x, msg.center_of_friction.y)
    table = Table(title=f"{name}: {msg.data_points} data points from {msg.pushes} pushes", title_justify="left", box=None)
    for column in ("", "estimate", "truth", "error"):
        table.add_column(column, justify="right" if column else "left")
    for axis, label in enumerate("xy"):
        error = abs(center[axis] - true[axis])
        table.add_row(
            escape(f"p_CF {label} [mm]"),
            f"{center[axis] * 1e3:.2f}",
            f"{true[axis] * 1e3:.2f}",
            f"{error * 1e3:.2f} mm, {100 * error / size[axis]:.2f} % of the side",
        )
    for radius in msg.confidence:
        off = float(np.hypot(*(np.array(center) - true)))
        table.add_row(escape("p_CF off by [mm]"), f"{radius * 1e3:.2f}", f"{off * 1e3:.2f}", "at most, with 90 %")
    friction = msg.contact_friction
    table.add_row("mu_c, 90 % / 100 %", f"{friction.p90:.2f} / {friction.max:.2f}", f"{known.mu_c:.2f}", "lower bounds")
    table.add_row(escape("fit error [mm]"), f"{msg.objective * 1e3:.3f}", "", f"certified to {msg.gap * 1e3:.1e} mm")
    console.print(table)
