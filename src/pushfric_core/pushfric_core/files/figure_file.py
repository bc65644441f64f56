"""The file of a figure: its suffix selects the format."""

import io
import pathlib

from matplotlib.backend_bases import FigureCanvasBase
from matplotlib.figure import Figure

from pushfric_core.errors import InvalidInput
from pushfric_core.files.disk import write_whole


def check_image_name(path: pathlib.Path) -> None:
    """Check a figure's name, before the work of which it shall show the result.

    Raises:
        InvalidInput: no image is known by the end of this name.
    """
    known = [name for name in FigureCanvasBase.get_supported_filetypes() if name != "pgf"]  # which needs LaTeX
    if path.suffix[1:] not in known:
        raise InvalidInput(
            f"{path}: not the name of an image; expected one that ends with {', '.join(f'.{name}' for name in known)}"
        )


def save_figure(figure: Figure, path: pathlib.Path, dpi: int = 130) -> None:
    """Write a figure; the suffix of the path selects the format.

    Raises:
        InvalidInput: the image cannot be written, or has no such format.
    """
    check_image_name(path)
    figure.savefig(content := io.BytesIO(), dpi=dpi, format=path.suffix[1:])
    write_whole(path, content.getvalue())
