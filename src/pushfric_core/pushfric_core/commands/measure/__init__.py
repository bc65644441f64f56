"""The command `measure`."""

import enum
import pathlib
import sys
from typing import Annotated, Any

import numpy as np
import typer
import yaml
from rich.console import Console

from pushfric_core.cell.cell_file import CellFile, load_cell
from pushfric_core.commands.application import Application
from pushfric_core.commands.console import say, warn
from pushfric_core.commands.frames import frames_from
from pushfric_core.commands.interrupt import telling_what_is_left
from pushfric_core.commands.json_option import STDOUT, JsonOption, write_json
from pushfric_core.commands.measure.targets import PUSHER_FILE, cell_text, draw, object_target, permit
from pushfric_core.commands.node_graph import borrowed
from pushfric_core.commands.options import in_range
from pushfric_core.errors import InvalidInput
from pushfric_core.files.object_file import ObjectModel, edited_object, load_object
from pushfric_core.files.whole_file import write_whole
from pushfric_core.files.yaml_edit import Value
from pushfric_core.pushers.pusher import PusherConfig
from pushfric_core.report.measurement import (
    object_figures,
    object_findings,
    object_picture,
    size_of,
    tip_figures,
    tip_findings,
    tip_picture,
)
from pushfric_core.report.report import to_json
from pushfric_core.vision.camera import Camera, Image, check_size, load_camera
from pushfric_core.vision.frame_source import Frames
from pushfric_core.vision.outline_measurement import height_of, measured_object, places_from
from pushfric_core.vision.tip_measurement import measure_tip
from pushfric_core.vision.tracker_settings import ContourConfig

app = Application()

STROKES = 13
"""Positions along the stroke, from one end to the other."""
SHORT_OF_THE_END = 1e-4
"""The stroke is not quite used up, because controllers round positions [m]."""


class Part(enum.StrEnum):
    """The parts of a cell that can be measured."""

    OBJECT = "object"
    TIP = "tip"


@app.command()
def measure(
    cell: Annotated[pathlib.Path, typer.Argument(help="Cell YAML.", show_default=False)],
    only: Annotated[Part | None, typer.Option(help="Measure only this.", show_default="first the object, then the tip")] = None,
    source: Annotated[
        str,
        typer.Option(help="Source of the pictures, as for camera.source.", show_default="camera.source of CELL"),
    ] = "",
    height: Annotated[
        float | None,
        typer.Option(
            help="Height of the object's bright face over the table, measured with a caliper [m].",
            **in_range(0.0, 1.0, "m"),
            show_default=False,
        ),
    ] = None,
    moved: Annotated[
        float | None,
        typer.Option(
            help="Measure the height instead: the pictures show the object in two places, between which it was slid along a"
            " ruler by this distance [m].",
            **in_range(0.01, 10.0, "m"),
            show_default=False,
        ),
    ] = None,
    tip_height: Annotated[
        float | None,
        typer.Option(
            help="Height over the table of the part of the tip that the camera sees [m].",
            **in_range(0.0, 1.0, "m"),
            show_default="from the length that the stroke seems to have",
        ),
    ] = None,
    positions: Annotated[
        str,
        typer.Option(
            help="Nothing moves: the pictures of the source show the tip at these stroke positions, in this order [m].",
            metavar="NUMBER,...",
            show_default=False,
        ),
    ] = "",
    speed: Annotated[
        float, typer.Option(help="Speed of the pusher between two pictures [m/s].", **in_range(0.0001, 1.0, "m/s"))
    ] = 0.01,
    out: Annotated[pathlib.Path | None, typer.Option(help="Folder to write to.", show_default="the folder of CELL")] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite existing files without asking.")] = False,
    json: JsonOption = None,
) -> None:
    """Lay the object anywhere in the picture, alone. Its outline, and its height if --moved is given, go into object.yaml; the
    rest of that file stays as it is. Then take the object away. The pusher goes slowly along its stroke and back, and rests for
    each picture; the places of its tip give line_origin, line_direction and tip_radius in the cell's file.

    A sentence names each disagreement with the files. measured_object.png and measured_tip.png show what was found.
    """
    file, folder = load_cell(cell), out or cell.parent
    if file.camera is None:
        raise InvalidInput(f"{cell}: a camera is measured with, expected the section camera")
    parts = [only] if only is not None else [Part.OBJECT, *[Part.TIP] * (file.pusher is not None)]
    if height is not None and moved is not None:
        raise InvalidInput("give --height or --moved, not both")
    if len(parts) > 1 and not sys.stdin.isatty():
        raise InvalidInput("give --only object or --only tip: without a terminal, nobody can be asked to take the object away")
    camera = load_camera(file.camera.calibration)
    source = source or file.camera.source
    figures: dict[str, Any] = {"findings": [], "files": []}
    output = Console(stderr=json == STDOUT, highlight=False, markup=False, soft_wrap=True)

    def frames() -> Frames:
        return frames_from(source, file.namespace, (camera.width, camera.height), file.discovery)

    with telling_what_is_left(lambda: f"{', '.join(figures['files']) or 'nothing'} was written"):
        for part in parts:
            if part is Part.OBJECT:
                target = object_target(file, cell, folder)
                permit(target, force)
                figures["object"] = _measure_object(file, camera, frames(), height, moved, target, figures, output)
            else:
                target = folder / PUSHER_FILE if out is not None else cell
                permit(target, force)
                at = _numbers(positions)
                figures["pusher"] = _measure_tip(file, cell, camera, frames(), at, speed, tip_height, target, figures, output)
    for finding in figures["findings"]:
        warn(finding)
    write_json(to_json(figures), json)


def _measure_object(
    cell: CellFile,
    camera: Camera,
    source: Frames,
    height: float | None,
    moved: float | None,
    target: pathlib.Path,
    figures: dict[str, Any],
    output: Console,
) -> dict[str, Any]:
    known = _known(cell)
    assert cell.camera is not None
    height_in_file = cell.camera.object_height or (known.height if known is not None else None)
    if height is None and moved is None and height_in_file is None:
        raise InvalidInput(
            f"{cell.object}: no such object yet: give the height of its face, --height, or the distance by which you slide it"
            " along a ruler, --moved"
        )
    if source.live:
        slide = (
            f"; then slide it by {1e3 * moved:g} mm along a ruler, and take your hand away again" if moved is not None else ""
        )
        say(f"lay the object on the table, alone, and take your hand away{slide}")
    threshold = cell.tracker.threshold or None if isinstance(cell.tracker, ContourConfig) else None
    places = places_from(source, camera, 1 if moved is None else 2, say, threshold)
    if moved is not None:
        if len(places) > 2:
            raise InvalidInput(f"{source.name}: {len(places)} places of the object, expected two, {1e3 * moved:g} mm apart")
        height = height_of(camera, places, moved)
    at = height if height is not None else height_in_file
    assert at is not None
    measured = measured_object(camera, places, at)
    found = object_findings(camera, places, measured, at, known, height is not None)
    figures["findings"] += [f"{cell.object}: {finding}" for finding in found.findings]
    corners = [[round(value, 5) for value in corner] for corner in found.outline.vertices.tolist()]
    values: dict[str, Value] = {"outline": corners, "height": round(max(at, 0.0), 5)}
    picture = target.parent / "measured_object.png"
    write_whole(target, edited_object(target, known, values)[0])
    draw(picture, object_picture(camera, places[-1], found))
    figures["files"] += [str(target), str(picture)]
    spread = f", the same in {len(places)} places to {1e3 * measured.spread:.2f} mm (rms)" if len(places) > 1 else ""
    how = "measured" if moved is not None else "given" if height is not None else "as in the file"
    output.print(f"object: {size_of(found.outline)} mm, {len(corners)} corners{spread}; height {1e3 * at:.1f} mm, {how}")
    output.print(f"wrote {target}, {picture}")
    return object_figures(found, measured)


def _measure_tip(
    cell: CellFile,
    path: pathlib.Path,
    camera: Camera,
    source: Frames,
    positions: list[float],
    speed: float,
    tip_height: float | None,
    target: pathlib.Path,
    figures: dict[str, Any],
    output: Console,
) -> dict[str, Any]:
    if cell.pusher is None:
        raise InvalidInput(f"{path}: others move this cell's robot, expected the section pusher")
    if positions:
        images = _pictures(source, camera)
        if len(images) != len(positions):
            raise InvalidInput(f"{source.name}: {len(images)} pictures, but --positions names {len(positions)}")
    elif not source.live:
        raise InvalidInput(
            f"{source.name} shows no live camera: give --positions, the stroke positions that it shows the tip at"
        )
    else:
        wanted = np.linspace(0.0, cell.pusher.stroke - SHORT_OF_THE_END, STROKES).tolist()
        _consent(cell.pusher, speed)
        along_the_stroke = borrowed("stroke", "a motion of the pusher")
        positions, images = along_the_stroke(cell, source, wanted, min(speed, cell.pusher.max_speed), say)
    tip = measure_tip(camera, positions, images, cell.pusher.tip_radius, tip_height)
    figures["findings"] += [f"{path}: {finding}" for finding in tip_findings(tip, cell.pusher, tip_height is not None)]
    values: dict[str, Value] = {
        "line_origin": [round(value, 5) for value in tip.origin.tolist()],
        "line_direction": [round(value, 6) for value in tip.direction.tolist()],
        "tip_radius": round(tip.radius, 5),
    }
    picture = target.parent / "measured_tip.png"
    write_whole(
        target, cell_text(path, values) if target == path else yaml.safe_dump({"pusher": values}, default_flow_style=None)
    )
    draw(picture, tip_picture(camera, images[-1], tip, cell.pusher.stroke))
    figures["files"] += [str(target), str(picture)]
    x, y = 1e3 * tip.origin
    u, v = tip.direction
    output.print(f"pushing line: from ({x:.2f}, {y:.2f}) mm along ({u:.5f}, {v:.5f}), seen to {1e3 * tip.rms:.2f} mm (rms)")
    length = "" if tip_height is None else f"; the stroke is {tip.scale:.4f} times as long as the controller says"
    output.print(f"tip: radius {1e3 * tip.radius:.2f} mm, {1e3 * tip.height:.1f} mm over the table{length}")
    output.print(f"wrote {target}, {picture}")
    return tip_figures(tip)


def _known(cell: CellFile) -> ObjectModel | None:
    """The object as its file describes it; None if there is no file yet. A wrong file is refused."""
    if cell.object.endswith((".yaml", ".yml")) and not pathlib.Path(cell.object).exists():
        return None
    return load_object(cell.object)


def _consent(pusher: PusherConfig, speed: float) -> None:
    """Ask before the pusher moves; without a terminal, --only tip has asked for it."""
    way = f"from 0 to {1e3 * pusher.stroke:g} mm and back, at {1e3 * speed:g} mm/s"
    if not sys.stdin.isatty():
        say(f"the pusher goes {way}")
        return
    home = " It homes first." if pusher.home else ""
    typer.confirm(
        f"The pusher will go {way}.{home} Take the object away, keep a hand on the emergency stop. Go on?", abort=True, err=True
    )


def _numbers(text: str) -> list[float]:
    try:
        return [float(one) for one in text.split(",")] if text else []
    except ValueError as error:
        raise InvalidInput(f"--positions must be numbers with commas between them, got {text!r}") from error


def _pictures(source: Frames, camera: Camera) -> list[Image]:
    """All pictures of a source that ends.

    Raises:
        InvalidInput: a picture does not have the camera's size.
    """
    with source:
        images = list(source)
    for image in images:
        check_size(image, camera, source.name)
    return images
