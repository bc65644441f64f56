"""The command `run`."""

import pathlib
import time
from dataclasses import replace
from typing import Annotated

import typer

from pushfric_core.bags.contents import check_free
from pushfric_core.cell.cell_file import load_cell
from pushfric_core.cell.node_settings import ExperimentConfig, SimulatedRunConfig
from pushfric_core.commands.application import Application
from pushfric_core.commands.cell_options import HeadlessFlag, PlannerFlag, ViewOption, view_to_serve
from pushfric_core.commands.console import console, fail
from pushfric_core.commands.options import RUNS
from pushfric_core.commands.program import telling_what_is_left
from pushfric_core.commands.settings_options import option
from pushfric_core.errors import InvalidInput
from pushfric_core.files.object_file import load_object
from pushfric_core.files.plan_file import load_plan
from pushfric_core.vision.camera import load_camera
from pushfric_ros.commands.recorded_run import left_behind, print_result
from pushfric_ros.commands.watch import watch
from pushfric_ros.graph import graph
from pushfric_ros.graph.supervisor import scratch_folder

app = Application()


@app.command()
def run(
    cell: Annotated[pathlib.Path, typer.Argument(help="Cell YAML.")],
    bag: Annotated[
        pathlib.Path | None, typer.Option(help="Folder of the bag to record.", show_default="runs/NAME-DATE")
    ] = None,
    start: Annotated[int, option(ExperimentConfig, "start")] = ExperimentConfig.start,
    headless: HeadlessFlag = False,
    view: ViewOption = "",
    planner: PlannerFlag = False,
    model_file: Annotated[
        pathlib.Path | None,
        typer.Option("--model", help="Model to start from (.yaml).", show_default="estimator.model of the cell"),
    ] = None,
    save: Annotated[
        pathlib.Path | None,
        typer.Option(help="Save the model to this file (.yaml).", show_default="estimator.save of the cell"),
    ] = None,
    simulated_camera: Annotated[
        bool, typer.Option("--simulated-camera", help="The real controller moves, without an object; the camera is simulated.")
    ] = False,
    simulated: Annotated[
        bool, typer.Option("--simulated", help="Controller and camera are simulated, at five times real time; nothing moves.")
    ] = False,
) -> None:
    """With --simulated-camera, the real tip moves in real time, and the object that it pushes exists only in the rendered
    pictures: take the real one away. With --simulated, only the cell's files are needed. A simulated object that is not of
    Table 1 has equal weights on its support points, and simulation.contact_friction of the cell's file is its mu_c."""
    if simulated and simulated_camera:
        raise InvalidInput("give --simulated or --simulated-camera, not both")
    file = load_cell(cell)
    given = {"model": model_file, "save": save}
    file = replace(file, model=replace(file.model, **{name: str(path) for name, path in given.items() if path is not None}))
    model = load_object(file.object)
    load_plan(file.plan.plan, model)  # here, so that no node starts if one of the cell's files is missing or wrong
    if file.camera is not None:
        load_camera(file.camera.calibration)
    bag = bag or RUNS / time.strftime(f"{model.name}-%Y%m%d-%H%M%S")
    check_free(bag)
    if not simulated and file.driver is not None and (absence := file.driver.absence()) is not None:
        raise InvalidInput(f"{cell}: pusher: {absence}")
    shown = view_to_serve(view, file.view)
    how = " --simulated" * simulated + " --simulated-camera" * simulated_camera

    def say_how_to_go_on(push: int) -> None:
        if not file.plan.choose:  # otherwise there is no plan to go on with
            console.print(f"the plan is not finished; go on with: ./pushfric run {cell} --start {push}{how}", markup=False)

    live = console.is_terminal and not headless
    with telling_what_is_left(lambda: left_behind(bag, file.pusher is not None)), scratch_folder() as scratch:
        if simulated or simulated_camera:
            file = graph.rendered(file, str(scratch), lambda sentence: console.print(sentence, markup=False), simulated_camera)
        if simulated:
            specs = graph.simulated_cell(file, str(bag), SimulatedRunConfig.seed, SimulatedRunConfig.speed, start)
        elif simulated_camera:
            specs = graph.simulated_camera(file, str(bag), start)
        else:
            specs = graph.cell(file, str(bag), start)
        specs = graph.with_parts(specs, file.object, shown, file.planner if planner else None)
        if simulated and not live and shown is None:  # who runs a real pusher is near it
            specs = graph.unattended(specs)
        what = f"pushing {model.name}"
        ended, _ = watch(console, specs, file.namespace, what, live, unfinished=say_how_to_go_on, prompts=True, recorded=bag)
    print_result(console, bag)
    if ended.code:
        fail(ended.reason, ended.code)
