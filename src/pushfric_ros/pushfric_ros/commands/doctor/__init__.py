"""The command `doctor`: checks everything that a cell needs, without moving anything, and says what to do about each fault."""

import contextlib
import os
import pathlib
import sys
from collections.abc import Callable, Iterator
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from pushfric_core.cell.cell_file import CellFile, load_cell
from pushfric_core.cell.node_settings import CameraConfig, CellConfig
from pushfric_core.commands.application import STDOUT, Application
from pushfric_core.commands.console import console
from pushfric_core.commands.options import RUNS, JsonOption
from pushfric_core.commands.result import answer
from pushfric_core.errors import InvalidInput
from pushfric_core.files.object_file import ObjectModel, load_object
from pushfric_core.pushers.pusher import Check, Grade
from pushfric_core.vision.camera import Camera, load_camera
from pushfric_core.vision.frame_source import TOPICS
from pushfric_ros.commands.doctor import camera, machine
from pushfric_ros.node_kit import network
from pushfric_ros.node_kit.lock import lock

app = Application()


def examine(path: pathlib.Path | None, bags: pathlib.Path, progress: Callable[[str], None]) -> Iterator[Check]:
    """All checks, one after another; checks that depend on a failed one are left out.

    Args:
        path: path of the cell's file; None: check only what does not depend on a cell.
        bags: folder in which bags will be recorded.
        progress: called with the name of what is checked next.
    Raises:
        InvalidInput: the cell's file cannot be read, or does not describe a cell; raised before any check.
    """
    cell = load_cell(path) if path is not None else None
    # like the nodes, this process and its children look for others where the cell's file says
    os.environ.update(network.asked_for(CellConfig.discovery if cell is None else cell.discovery))
    progress("environment")
    yield from (check() for check in machine.CHECKS)
    yield machine.check_disk(bags)
    progress("discovery")
    yield machine.check_discovery()
    yield machine.check_multicast()
    if cell is None:
        return
    with contextlib.ExitStack() as claim:
        try:
            claim.enter_context(lock(cell.namespace))
        except InvalidInput as error:
            yield Check("cell", Grade.FAILED, str(error), "end that run before you check its parts")
            return
        yield Check("cell", Grade.OK, f"{path}: {cell.namespace}")
        yield from _examine_cell(cell, progress)


def _examine_cell(cell: CellFile, progress: Callable[[str], None]) -> Iterator[Check]:
    model: ObjectModel | None = None
    try:
        model = load_object(cell.object)
        if cell.pusher is not None:
            yield camera.check_plan(cell.plan, model)
    except InvalidInput as error:
        yield Check("object", Grade.FAILED, str(error), "docs/files.md shows an object's file")
    if cell.camera is not None:
        yield from _examine_camera(cell, cell.camera, model, progress)
    if cell.pusher is not None and cell.driver is not None:
        progress("pusher")
        yield from cell.driver.checks(cell.pusher, cell.plan.distance, cell.plan.speed)


def _examine_camera(
    cell: CellFile, source: CameraConfig, model: ObjectModel | None, progress: Callable[[str], None]
) -> Iterator[Check]:
    known: Camera | None = None
    try:
        known = load_camera(source.calibration)
    except InvalidInput as error:
        again = f"./pushfric calibrate lens {source.source} --out {source.calibration}"
        again += f", then ./pushfric calibrate table {source.source} --camera {source.calibration}"
        yield Check("calibration", Grade.FAILED, str(error), again)
    progress("camera")
    try:
        watched = camera.watch(source, cell.namespace, None if known is None else (known.width, known.height))
    except InvalidInput as error:
        holder = "plug it in; `fuser -v /dev/video*` names who holds it; sudo usermod -aG video $USER, then log in again"
        yield Check("camera", Grade.FAILED, str(error), holder)
        frames = []
    else:
        yield camera.check_camera(watched, source.source)
        frames = watched.frames
    image = frames[-1].image if frames else None
    if image is not None:
        yield camera.check_exposure(image)
        if source.source in TOPICS:  # frames of a device get their stamps here
            yield camera.check_stamps(frames)
    if known is not None:
        if cell.pusher is not None:
            yield camera.check_calibration(known, image, cell.pusher)
        if model is not None:
            yield camera.check_object(cell, known, model, image)


def passed(checks: list[Check]) -> bool:
    """Whether no check failed; a warning is not a failure."""
    return all(check.level is not Grade.FAILED for check in checks)


def table(checks: list[Check]) -> Table:
    """The checks as a table."""
    colors = {Grade.OK: "green", Grade.WARNING: "yellow", Grade.FAILED: "red"}
    made = Table(box=None, header_style="bold", pad_edge=False)
    for title in ("", "check", "finding", "what to do"):
        made.add_column(title, overflow="fold")
    for check in checks:
        made.add_row(Text(check.level.value, colors[check.level]), check.name, Text(check.finding), Text(check.advice))
    return made


def findings(checks: list[Check]) -> dict[str, Any]:
    """The checks as one JSON object."""
    return {"passed": passed(checks), "checks": [check._asdict() | {"level": check.level.value} for check in checks]}


@app.command()
def doctor(
    cell: Annotated[pathlib.Path | None, typer.Argument(help="Cell YAML; without one, only this machine is checked.")] = None,
    json: JsonOption = None,
) -> None:
    """Exit code 0: nothing failed; 1: a check failed; 2: wrong input, such as a cell file that cannot be read or is invalid."""
    with console.status("") as status:
        checks = list(examine(cell, RUNS, lambda what: status.update(f"checking the {what}")))
    answer(findings(checks), json)
    if json != STDOUT:
        Console(width=None if sys.stdout.isatty() else 1000).print(table(checks))  # whole paths can be copied
    if not passed(checks):
        sys.exit(1)
