"""The commands of `pushfric calibrate`: print a board, then calibrate the lens, then the table."""

import pathlib
from typing import Annotated

import numpy as np
import typer

from pushfric_core.cell.node_settings import NAMESPACE, VIEW_PORT, ViewConfig
from pushfric_core.commands.application import Application
from pushfric_core.commands.cell_options import ADDRESS_METAVAR, NamespaceOption, WithView, view_at
from pushfric_core.commands.console import say
from pushfric_core.commands.frames import ACCEPTED_WITH_TOPICS, frames_from
from pushfric_core.commands.interrupt import telling_what_is_left
from pushfric_core.errors import InvalidInput
from pushfric_core.files.object_file import load_object
from pushfric_core.vision.board import Board
from pushfric_core.vision.camera import load_lens, save_camera
from pushfric_core.vision.fiducial_tracker import load_fiducials
from pushfric_core.vision.lens_calibration import lens_from_frames
from pushfric_core.vision.table_calibration import (
    calibrate_table,
    read_table_places,
    read_table_points,
    table_from_frames,
)
from pushfric_core.wording import counted

app = Application(no_args_is_help=True)

CAMERA = ACCEPTED_WITH_TOPICS[0].upper() + ACCEPTED_WITH_TOPICS[1:]

PRINT_IT = "print it at 100 %, and compare its ruler with a real one"

Source = Annotated[str, typer.Argument(help=f"{CAMERA}.", show_default=False)]
Columns = Annotated[int, typer.Option(help="Squares of the board along its long side.")]
Rows = Annotated[int, typer.Option(help="Squares of the board along its short side.")]
Square = Annotated[float, typer.Option(help="Side of a square, as printed [m].")]
CameraFile = Annotated[pathlib.Path, typer.Option(help="Calibration YAML of calibrate lens, to add to.", show_default=False)]


@app.command()
def board(
    out: Annotated[pathlib.Path, typer.Argument(help="File to write: a PDF.", show_default=False)],
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
    file: Annotated[pathlib.Path, typer.Argument(help="YAML of the markers, as for camera.fiducials.", show_default=False)],
    object_name: Annotated[str, typer.Argument(metavar="OBJECT", help="Object YAML.", show_default=False)],
    out: Annotated[pathlib.Path, typer.Argument(help="File to write: a PDF.", show_default=False)],
) -> None:
    """Write an object's markers as a PDF to scale, each in its place: cut along the outline, paste it onto the object."""
    from pushfric_core.vision.printed_pdf import save_markers

    save_markers(load_fiducials(file), load_object(object_name).outline, out)
    say(f"{out}: {PRINT_IT}")


@app.command()
def lens(
    source: Source,
    out: Annotated[pathlib.Path, typer.Option(help="File to write: the camera's calibration YAML.", show_default=False)],
    columns: Columns = Board.columns,
    rows: Rows = Board.rows,
    square: Square = Board.square,
    namespace: NamespaceOption = NAMESPACE,
) -> None:
    """Calibrate the lens from views of the board: near and far, tilted, in all parts of the image."""
    with telling_what_is_left(lambda: f"nothing was written to {out}"):
        found = lens_from_frames(frames_from(source, namespace), _board(columns, rows, square), say)
    save_camera(found.lens, out)
    say(
        f"{out}: reprojection error {found.rms_px:.3f} px, worst view {found.view_rms_px.max():.3f} px of"
        f" {counted(len(found.view_rms_px), 'view')}; focal length to {100 * found.focal_error:.2g} %",
    )


@app.command(cls=WithView)
def table(
    source: Annotated[
        str,
        typer.Argument(
            help=f"{CAMERA}, with the board on the table in view; or a CSV u,v,x,y of measured points: pixels, and their places"
            " on the table [m].",
            show_default=False,
        ),
    ],
    camera: CameraFile,
    columns: Columns = Board.columns,
    rows: Rows = Board.rows,
    square: Square = Board.square,
    figure: Annotated[
        pathlib.Path | None,
        typer.Option(help="Draw a map of the expected errors to this file (.png, .svg, .pdf).", show_default=False),
    ] = None,
    view: Annotated[
        str,
        typer.Option(
            "--view",
            help="No board: click points of the table in a browser, on this machine alone unless a HOST is given, at port"
            f" {VIEW_PORT} unless a PORT is.",
            metavar=ADDRESS_METAVAR,
            show_default=False,
        ),
    ] = "",
    marks: Annotated[
        pathlib.Path | None,
        typer.Option(help="CSV x,y of the points to click, in this order [m].", show_default="typed in the browser"),
    ] = None,
    namespace: NamespaceOption = NAMESPACE,
) -> None:
    """Calibrate the table from the board lying on it, or from at least four measured points; adds it to the camera's YAML.

    The lower left corner of the board becomes the origin of the table frame, with x to the right and y up as printed. If the
    board is small in the image, lay it in several places, one after the other: the first place gives the table frame. With
    --view, the points that are clicked give it.
    """
    if figure is not None:
        from pushfric_core.report.figures import check_image_name, table_error_figure  # imported late: it takes a second

        check_image_name(figure)
    known = load_lens(camera)
    shown = view_at(view, ViewConfig())
    if marks is not None and shown is None:
        raise InvalidInput("--marks are clicked in a browser: give --view as well")
    with telling_what_is_left(lambda: f"no calibration of the table was written to {camera}"):
        if shown is not None:
            places = [] if marks is None else read_table_places(marks).tolist()
            from pushfric_core.pages.clicked_points import ClickedPoints  # imported late: only this needs tornado
            from pushfric_core.pages.picture_server import work_in_a_browser

            clicked = ClickedPoints(known, camera, places)
            frames = frames_from(source, namespace, (known.width, known.height))
            work_in_a_browser("points.html", clicked, frames, shown, say)
            assert clicked.found is not None
            found = clicked.found
        elif source.endswith(".csv"):
            found = calibrate_table(known, [read_table_points(pathlib.Path(source))])
            save_camera(found.camera, camera)
        else:
            frames = frames_from(source, namespace, (known.width, known.height))
            found = table_from_frames(frames, _board(columns, rows, square), known, say)
            save_camera(found.camera, camera)
    say(
        f"{camera}: reprojection error {found.rms_px:.3f} px, {1e3 * found.rms:.3f} mm on the table;"
        f" worst {1e3 * found.errors.max():.3f} mm",
    )
    say(
        f"a place anywhere in the image is off by {1e3 * np.median(found.map.errors):.3f} mm (1 sigma, median),"
        f" {1e3 * found.map.errors.max():.3f} mm at worst",
    )
    if figure is not None:
        table_error_figure(figure, found.map.places, found.map.errors)


def _board(columns: int, rows: int, square: float) -> Board:
    try:
        return Board(columns, rows, square)
    except ValueError as error:
        raise InvalidInput(str(error)) from error
