"""The command `edit`."""

import pathlib
from typing import Annotated

import typer

from pushfric_core.cell.node_settings import NAMESPACE, ViewConfig
from pushfric_core.commands.application import Application, in_range
from pushfric_core.commands.cell_options import NamespaceOption
from pushfric_core.commands.console import say
from pushfric_core.commands.frames import frames_from
from pushfric_core.commands.program import telling_what_is_left
from pushfric_core.commands.settings_options import option
from pushfric_core.errors import InvalidInput
from pushfric_core.plausible import LARGEST
from pushfric_core.vision.camera import load_camera
from pushfric_core.vision.frame_source import ACCEPTED
from pushfric_core.wording import counted

app = Application()


@app.command()
def edit(
    file: Annotated[pathlib.Path, typer.Argument(help="Object YAML, to write or to change.")],
    picture: Annotated[str, typer.Option(help=f"Draw over a picture: {ACCEPTED}.", show_default="an empty sheet")] = "",
    camera: Annotated[
        pathlib.Path | None,
        typer.Option(
            help="Calibration YAML of the picture's camera. It gives the scale, and the object's place in the picture."
        ),
    ] = None,
    width: Annotated[
        float | None,
        typer.Option(
            help="Width of the sheet, or of a picture without a calibration, such as a scan of the object's underside [m].",
            **in_range(0.001, LARGEST, "m"),
        ),
    ] = None,
    height: Annotated[
        float | None,
        typer.Option(
            help="Height of the object's face over the table, measured with a caliper [m]: a higher face looks larger.",
            **in_range(0.0, 1.0, "m"),
            show_default="as in FILE",
        ),
    ] = None,
    port: Annotated[int, option(ViewConfig, "port")] = ViewConfig.port,
    namespace: NamespaceOption = NAMESPACE,
) -> None:
    """A picture of the object alone gives the outline of a new file; correct it, and save. The page shows millimetres; the file
    keeps metres, and everything in it but outline, support and height stays as it is. Ctrl-C leaves the file alone."""
    if picture and (camera is None) == (width is None):
        raise InvalidInput("--picture needs its scale: give either --camera or --width")
    if camera is not None and not picture:
        raise InvalidInput("--camera says where a picture was taken: give --picture as well")
    if file.suffix not in (".yaml", ".yml") or not file.parent.is_dir():
        raise InvalidInput(f"{file}: expected a YAML file in a folder that exists")
    # imported late: only this needs OpenCV and tornado
    from pushfric_core.page.drawn_object import DrawnObject, draw_in_a_browser

    known = None if camera is None else load_camera(camera)
    drawn = DrawnObject(file, known, width, height)
    source = frames_from(picture, namespace, None if known is None else (known.width, known.height)) if picture else None

    with telling_what_is_left(lambda: f"nothing was written to {file}"):
        draw_in_a_browser(drawn, source, ViewConfig(port=port), say)
    assert drawn.model is not None
    length, wide = 1e3 * drawn.model.outline.size
    corners = counted(len(drawn.model.outline.vertices), "corner")
    supports = counted(len(drawn.model.support_points), "support point")
    say(f"wrote {file}: {length:.1f} x {wide:.1f} mm, {corners}, {supports}")
