"""The commands of `pushfric calibrate`: print a board, then calibrate the lens, then the table, then find the tip."""

import pathlib
import sys
import tempfile
from typing import Annotated

import numpy as np
import typer
import yaml

from pushfric_core.bags.recorded import is_csv
from pushfric_core.cell.cell_file import CellFile, load_cell
from pushfric_core.cell.node_settings import NAMESPACE
from pushfric_core.commands.application import Application, in_range
from pushfric_core.commands.cell_options import NamespaceOption
from pushfric_core.commands.console import say, warn
from pushfric_core.commands.frames import borrowed, frames_from
from pushfric_core.commands.options import ForceFlag, JsonOption, permit
from pushfric_core.commands.program import telling_what_is_left
from pushfric_core.commands.result import answer
from pushfric_core.errors import InvalidInput, blaming
from pushfric_core.files.disk import make_folder, write_whole, writing
from pushfric_core.files.object_file import load_object
from pushfric_core.files.yaml_files import edited_yaml
from pushfric_core.files.yaml_text import Value
from pushfric_core.plausible import check_within
from pushfric_core.pushers.pusher import PusherConfig
from pushfric_core.records import plain
from pushfric_core.vision.board import Board
from pushfric_core.vision.calibration import (
    calibrate_table,
    lens_from_frames,
    read_table_points,
    table_from_frames,
)
from pushfric_core.vision.camera import Camera, Image, check_size, load_camera, load_lens, save_camera, table_fields
from pushfric_core.vision.fiducial_tracker import load_fiducials
from pushfric_core.vision.frame_source import ACCEPTED, Frames
from pushfric_core.vision.tip_measurement import measure_tip, tip_findings, tip_picture
from pushfric_core.wording import counted

app = Application(no_args_is_help=True)

PUSHER_FILE = "pusher.yaml"
"""Name of the file for the pusher's entries if they do not go into the cell's file."""
STROKES = 13
"""Positions along the stroke, from one end to the other."""
SHORT_OF_THE_END = 1e-4
"""The stroke is not quite used up, because controllers round positions [m]."""

CAMERA = ACCEPTED[0].upper() + ACCEPTED[1:]

PRINT_IT = "print it at 100 %, and compare its ruler with a real one"

PdfFile = Annotated[pathlib.Path, typer.Argument(help="File to write: a PDF.")]
Source = Annotated[str, typer.Argument(help=f"{CAMERA}.")]
Columns = Annotated[int, typer.Option(help="Squares of the board along its long side.")]
Rows = Annotated[int, typer.Option(help="Squares of the board along its short side.")]
Square = Annotated[float, typer.Option(help="Side of a square, as printed [m].")]
CameraFile = Annotated[pathlib.Path, typer.Option(help="Calibration YAML of calibrate lens, to add to.")]


@app.command()
def board(
    out: PdfFile,
    columns: Columns = Board.columns,
    rows: Rows = Board.rows,
    square: Square = Board.square,
) -> None:
    """Write a ChArUco board as a PDF to scale. Print it at 100 % and check its ruler."""
    from pushfric_core.vision.printed_pdf import save_board  # imported late: the other commands need no matplotlib

    save_board(_board(columns, rows, square), out)
    say(f"{out}: {PRINT_IT}")


@app.command()
def markers(
    file: Annotated[pathlib.Path, typer.Argument(help="YAML of the markers, as for camera.fiducials.")],
    object_name: Annotated[str, typer.Argument(metavar="OBJECT", help="Object YAML.")],
    out: PdfFile,
) -> None:
    """Write an object's markers as a PDF to scale, each in its place: cut along the outline, paste it onto the object."""
    from pushfric_core.vision.printed_pdf import save_markers

    save_markers(load_fiducials(file), load_object(object_name).outline, out)
    say(f"{out}: {PRINT_IT}")


@app.command()
def lens(
    source: Source,
    out: Annotated[pathlib.Path, typer.Option(help="File to write: the camera's calibration YAML.")],
    columns: Columns = Board.columns,
    rows: Rows = Board.rows,
    square: Square = Board.square,
    namespace: NamespaceOption = NAMESPACE,
    force: ForceFlag = False,
) -> None:
    """Calibrate the lens from views of the board: near and far, tilted, in all parts of the image."""
    permit(out, force, "Overwrite it, with the calibration of the table in it?", "another --out FILE")
    make_folder(out.parent)
    with writing(out):
        tempfile.TemporaryFile(dir=out.parent).close()  # the work is long
    with telling_what_is_left(lambda: f"nothing was written to {out}"):
        found = lens_from_frames(frames_from(source, namespace), _board(columns, rows, square), say)
    save_camera(found.lens, out)
    say(
        f"{out}: reprojection error {found.rms_px:.3f} px, worst view {found.view_rms_px.max():.3f} px of"
        f" {counted(len(found.view_rms_px), 'view')}; focal length to {100 * found.focal_error:.2g} %",
    )


@app.command()
def table(
    source: Annotated[
        str,
        typer.Argument(
            help=f"{CAMERA}, with the board on the table in view; or a CSV u,v,x,y of measured points: pixels, and their places"
            " on the table [m]."
        ),
    ],
    camera: CameraFile,
    columns: Columns = Board.columns,
    rows: Rows = Board.rows,
    square: Square = Board.square,
    namespace: NamespaceOption = NAMESPACE,
) -> None:
    """Calibrate the table from the board lying on it, or from at least four measured points; adds it to the camera's YAML.

    The lower left corner of the board becomes the origin of the table frame, with x to the right and y up as printed. If the
    board is small in the image, lay it in several places, one after the other: the first place gives the table frame.
    """
    known = load_lens(camera)
    with telling_what_is_left(lambda: f"no calibration of the table was written to {camera}"):
        if is_csv(path := pathlib.Path(source)):
            found = calibrate_table(known, [read_table_points(path)])
        else:
            frames = frames_from(source, namespace, (known.width, known.height))
            found = table_from_frames(frames, _board(columns, rows, square), known, say)
        write_whole(camera, edited_yaml(camera, None, table_fields(found.camera)))
    say(
        f"{camera}: reprojection error {found.rms_px:.3f} px, {1e3 * found.rms:.3f} mm on the table;"
        f" worst {1e3 * found.errors.max():.3f} mm",
    )
    say(
        f"a place anywhere in the image is off by {1e3 * np.median(found.map.errors):.3f} mm (1 sigma, median),"
        f" {1e3 * found.map.errors.max():.3f} mm at worst",
    )


def _board(columns: int, rows: int, square: float) -> Board:
    with blaming():
        return Board(columns, rows, square)


@app.command()
def tip(
    cell: Annotated[pathlib.Path, typer.Argument(help="Cell YAML.")],
    source: Annotated[
        str, typer.Option(help="Source of the pictures, as for camera.source.", show_default="camera.source of CELL")
    ] = "",
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
        ),
    ] = "",
    speed: Annotated[
        float, typer.Option(help="Speed of the pusher between two pictures [m/s].", **in_range(0.0001, 1.0, "m/s"))
    ] = 0.01,
    out: Annotated[pathlib.Path | None, typer.Option(help=f"Folder to write {PUSHER_FILE} to, in place of CELL.")] = None,
    force: ForceFlag = False,
    json: JsonOption = None,
) -> None:
    """Find the pushing line. Take the object away. The pusher goes slowly along its stroke and back, and rests for each
    picture; the places of its tip give line_origin, line_direction and tip_radius in the cell's file.

    A sentence names each disagreement with the file. measured_tip.png shows what was found.
    """
    file = load_cell(cell)
    if file.camera is None or file.pusher is None:
        lacking = "camera" if file.camera is None else "pusher"
        raise InvalidInput(f"{cell}: a camera measures where the pusher goes, expected the section {lacking}")
    target = cell if out is None else out / PUSHER_FILE
    if not target.parent.is_dir():
        raise InvalidInput(f"{target.parent}: no such folder")
    permit(target, force, "Replace what is measured in it?", "--out FOLDER to write elsewhere")
    camera, source = load_camera(file.camera.calibration), source or file.camera.source
    frames = frames_from(source, file.namespace, (camera.width, camera.height), file.discovery)
    with telling_what_is_left(lambda: "nothing was written"):
        places, images = _tip_pictures(file, file.pusher, camera, frames, _positions(positions, file.pusher.stroke), speed)
        measured = measure_tip(camera, places, images, file.pusher.tip_radius, tip_height)
        values: dict[str, Value] = {
            "line_origin": [round(value, 5) for value in measured.line_origin.tolist()],
            "line_direction": [round(value, 6) for value in measured.line_direction.tolist()],
            "tip_radius": round(float(measured.tip_radius), 5),
        }
        picture = target.parent / "measured_tip.png"
        if out is None:
            text = edited_yaml(cell, "pusher", values, "; with --out FOLDER, the entries go into a file of their own")
        else:
            text = yaml.safe_dump({"pusher": values}, default_flow_style=None)
        write_whole(target, text)
        write_whole(picture, tip_picture(camera, images[-1], measured, file.pusher.stroke))
    findings = [f"{cell}: {finding}" for finding in tip_findings(measured, file.pusher, tip_height is not None)]
    for finding in findings:
        warn(finding)
    (x, y), (u, v) = 1e3 * measured.line_origin, measured.line_direction
    say(f"pushing line: from ({x:z.2f}, {y:z.2f}) mm along ({u:z.5f}, {v:z.5f}), seen to {1e3 * measured.rms:.2f} mm (rms)")
    length = "" if tip_height is None else f"; the stroke is {measured.stroke_scale:.4f} times as long as the controller says"
    say(f"tip: radius {1e3 * measured.tip_radius:.2f} mm, {1e3 * measured.tip_height:.1f} mm over the table{length}")
    say(f"wrote {target}, {picture}")
    answer({"pusher": plain(measured), "findings": findings, "files": [str(target), str(picture)]}, json)


def _tip_pictures(
    cell: CellFile, pusher: PusherConfig, camera: Camera, source: Frames, positions: list[float], speed: float
) -> tuple[list[float], list[Image]]:
    """Where the tip stood [m], and the picture of each place."""
    if positions:
        with source:
            images = list(source)
        for image in images:
            check_size(image, camera, source.name)
        if len(images) != len(positions):
            raise InvalidInput(f"{source.name}: {len(images)} pictures, but --positions names {len(positions)}")
        return positions, images
    if not source.live:
        raise InvalidInput(
            f"{source.name} shows no live camera: give --positions, the stroke positions that it shows the tip at"
        )
    wanted = np.linspace(0.0, pusher.stroke - SHORT_OF_THE_END, STROKES).tolist()
    _consent(pusher, speed)
    along_the_stroke = borrowed("stroke", "a motion of the pusher")
    found: tuple[list[float], list[Image]] = along_the_stroke(cell, source, wanted, min(speed, pusher.max_speed), say)
    return found


def _consent(pusher: PusherConfig, speed: float) -> None:
    """Ask before the pusher moves; without a terminal, the command itself has asked for it."""
    way = f"from 0 to {1e3 * pusher.stroke:g} mm and back, at {1e3 * speed:g} mm/s"
    if not sys.stdin.isatty():
        say(f"the pusher goes {way}")
        return
    home = " It homes first." if pusher.home else ""
    typer.confirm(
        f"The pusher will go {way}.{home} Take the object away, keep a hand on the emergency stop. Go on?", abort=True, err=True
    )


def _positions(text: str, stroke: float) -> list[float]:
    try:
        found = [float(one) for one in text.split(",")] if text else []
    except ValueError as error:
        raise InvalidInput(f"--positions must be numbers with commas between them, got {text!r}") from error
    with blaming():
        check_within("--positions", found, stroke, "m")
    return found
