"""The command `demo`: the whole graph on a simulated cell, then a summary next to the truth."""

import dataclasses
import pathlib
import time
from typing import Annotated

import numpy as np
import typer
from rich.markup import escape
from rich.table import Table

from pushfric_core.bags.contents import check_free
from pushfric_core.cell.cell_file import CellFile
from pushfric_core.cell.node_settings import CameraConfig, PlanConfig, SimulatedRunConfig, SimulationConfig, ViewConfig
from pushfric_core.commands.application import AUTO_VIEW, Application
from pushfric_core.commands.cell_options import HeadlessFlag, PlannerFlag, ViewOption, view_to_serve
from pushfric_core.commands.console import console, fail
from pushfric_core.commands.options import RUNS, JsonOption
from pushfric_core.commands.program import telling_what_is_left
from pushfric_core.commands.result import answer
from pushfric_core.commands.settings_options import option
from pushfric_core.errors import InvalidInput
from pushfric_core.files.object_file import load_object
from pushfric_core.files.plan_file import load_plan
from pushfric_core.geometry.table_1 import TABLE_1
from pushfric_core.pushers.pusher import PusherConfig
from pushfric_core.pushers.serial_config import GrblConfig
from pushfric_core.vision.camera import Camera, save_camera
from pushfric_core.vision.tracker_settings import ContourConfig
from pushfric_core.wording import data_of
from pushfric_msgs.msg import FrictionEstimate
from pushfric_ros.commands.recorded_run import left_behind, print_result
from pushfric_ros.commands.watch import watch
from pushfric_ros.graph import graph
from pushfric_ros.graph.supervisor import scratch_folder
from pushfric_ros.messages.conversions import report_from_msg
from pushfric_ros.messages.markers import center_of_friction_from

SPEED: float = SimulatedRunConfig.speed
"""Multiple of real time at which the simulated cell runs."""

SHOWN, GUESSED = "rubber_rect4", "delrin_rect_right"
"""Objects: one whose p_CF is in its middle, and one where it is not, so that it is worth a guess."""

PLAYED, ASIDE = 7, 0.03
"""Number of pushes of a game, and how far beside its place the object is laid, for a person to put it right [m]."""

app = Application()


@app.command()
def demo(
    headless: HeadlessFlag = False,
    view: ViewOption = "",
    planner: PlannerFlag = False,
    json: JsonOption = None,
    seed: Annotated[int, option(SimulatedRunConfig, "seed")] = SimulatedRunConfig.seed,
    object_name: Annotated[
        str, typer.Option("--object", help=f"One of {', '.join(TABLE_1)}.", show_default=f"{SHOWN}, or {GUESSED} with --play")
    ] = "",
    bag: Annotated[
        pathlib.Path | None, typer.Option(help="Folder of the bag to record.", show_default="runs/demo-DATE")
    ] = None,
    plan: Annotated[
        pathlib.Path | None, typer.Option(help="Push plan YAML.", show_default="as many as the paper's, four of which slip")
    ] = None,
    choose: Annotated[int, option(PlanConfig, "choose")] = PlanConfig.choose,
    play: Annotated[bool, typer.Option("--play", help="Be the operator, in a browser: a game of five minutes.")] = False,
) -> None:
    object_name = object_name or (GUESSED if play else SHOWN)
    if object_name not in TABLE_1:
        raise InvalidInput(f"no object {object_name!r} in the simulated cell; expected one of {', '.join(TABLE_1)}")
    bag = bag or RUNS / time.strftime("demo-%Y%m%d-%H%M%S")
    check_free(bag)
    if plan is not None and choose:
        raise InvalidInput("give --plan or --choose, not both")
    pushes = PlanConfig(plan=str(plan) if plan is not None else "", choose=choose)
    if play:
        view, pushes = view or AUTO_VIEW, dataclasses.replace(pushes, choose=choose or PLAYED * (plan is None), speed=0.01)
    load_plan(pushes.plan, load_object(object_name))  # report a wrong plan before anything starts
    shown = view_to_serve(view, ViewConfig())
    live = console.is_terminal and not headless
    with telling_what_is_left(lambda: left_behind(bag)), scratch_folder() as scratch:
        cell = dataclasses.replace(demo_cell(object_name, scratch), plan=pushes)
        if play:
            cell = dataclasses.replace(cell, simulation=SimulationConfig(placement_error=ASIDE))
        speed = 1.0 if play else SPEED
        specs = graph.simulated_cell(cell, str(bag), seed, speed)
        specs = graph.with_parts(specs, object_name, shown, cell.planner if planner else None, play)
        specs = specs if live or shown is not None else graph.unattended(specs)
        console.print(f"simulated cell, {object_name}, at {speed:g} times real time; recording {bag}", markup=False)
        what, known, prompts = f"pushing {object_name}", TABLE_1[object_name], shown is not None
        ended, last = watch(console, specs, cell.namespace, what, live, prompts=prompts, recorded=bag, known=known)
    if last is not None:
        print_summary(object_name, last)
        answer({**report_from_msg(last).to_dict(), "truth": known.to_dict(), "bag": str(bag)}, json)
    print_result(console, bag)
    if ended.code or last is None:
        fail(ended.reason if ended.code else "the run ended without an estimate", ended.code or 1)


def demo_cell(object_name: str, folder: pathlib.Path) -> CellFile:
    """The simulated cell: a camera that looks straight down on a pushing line along y; its files go to `folder`."""
    save_camera(Camera.looking_down(640, 480, center=(0.0, 0.06), metres_per_pixel=0.000625), folder / "camera.yaml")
    pusher = PusherConfig(
        line_origin=(0.0, 0.0),
        line_direction=(0.0, 1.0),
        tip_radius=0.003,
        stroke=0.06,
        max_speed=0.1,
        retract_speed=0.1,
    )
    return CellFile(
        object=object_name,
        camera=CameraConfig(source="topic", calibration=str(folder / "camera.yaml")),
        tracker=ContourConfig(),
        pusher=pusher,
        driver=GrblConfig(port=str(folder / "pusher")),
    )


def print_summary(name: str, msg: FrictionEstimate) -> None:
    """The last estimate next to the truth of a simulated object."""
    known = TABLE_1[name]
    size, true = known.outline.size, known.support.center_of_friction
    center = center_of_friction_from(msg)
    table = Table(title=f"{name}: {data_of(msg.data_points, msg.pushes)}", title_justify="left", box=None)
    for column in ("", "estimate", "truth", "error"):
        table.add_column(column, justify="right" if column else "left")
    for axis, label in enumerate("xy"):
        error = abs(center[axis] - true[axis])
        table.add_row(
            escape(f"p_CF {label} [mm]"),
            f"{center[axis] * 1e3:z.2f}",
            f"{true[axis] * 1e3:z.2f}",
            f"{error * 1e3:.2f} ({100 * error / size[axis]:.2f} % of the side)",
        )
    friction = msg.contact_friction
    if np.isnan(friction.value):
        table.add_row("mu_c", f"over {friction.low:.2f}", f"{known.mu_c:.2f}", "lower bound")
        mu_c = f"These pushes bound mu_c only from below: it is at least {friction.low:.2f} with 90 % probability."
    else:
        error = abs(friction.value - known.mu_c)
        table.add_row("mu_c", f"{friction.value:.2f}", f"{known.mu_c:.2f}", f"{error:.2f} ({100 * error / known.mu_c:.0f} %)")
        interval = f"between {friction.low:.2f} and {friction.high:.2f} with 90 % probability"
        mu_c = f"By the pushes that slipped, mu_c lies {interval}."
    console.print(table)
    off = float(np.hypot(*(np.array(center) - true)))
    if not np.isnan(msg.confidence):
        claim = f"the estimate claims to be within {msg.confidence * 1e3:.2f} mm of it with 90 % probability"
        console.print(f"The true p_CF is {off * 1e3:.2f} mm from the estimated one; {claim}.", highlight=False)
    console.print(mu_c, highlight=False)
    certificate = f"no w fits better by more than {msg.gap * 1e3:.1e} mm (certified)"
    console.print(
        f"The fit error is {msg.objective * 1e3:.3f} mm, summed over the observations; {certificate}.", highlight=False
    )
