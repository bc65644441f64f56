"""The board as a PDF to be printed."""

import pathlib

import numpy as np
import shapely
import shapely.affinity
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from pushfric_core.errors import InvalidInput
from pushfric_core.vision.board import MARKER, Board, charuco

_MARKER_MODULES = 6
_PAPER_MM = (297.0, 210.0)  # A4, landscape
_MARGIN_MM = 12.0
_RULER_MM = 100


def save_board(board: Board, path: pathlib.Path) -> None:
    """Write the board to scale as a PDF, on A4 or larger paper, with a ruler to check the print.

    Raises:
        InvalidInput: the file cannot be written.
    """
    width, height = (1e3 * side for side in board.size)
    ruler_room = 16.0
    page = np.maximum(_PAPER_MM, (width + 2 * _MARGIN_MM, height + 2 * _MARGIN_MM + ruler_room))
    figure = Figure(figsize=tuple(page / 25.4), frameon=False)
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, page[0]), ylim=(0, page[1]))
    axes.set_axis_off()
    left, bottom = (page[0] - width) / 2, (page[1] - height + ruler_room) / 2
    black = shapely.affinity.translate(_black(board, 1e3 * board.square), left, bottom)
    axes.add_patch(PathPatch(_path(black), facecolor="black", linewidth=0))
    for mm in range(0, _RULER_MM + 1, 5):
        axes.plot((left + mm,) * 2, (bottom - 10, bottom - (6 if mm % 10 == 0 else 8)), color="black", linewidth=0.3)
    text = f"This ruler is {_RULER_MM} mm long, each square {1e3 * board.square:g} mm wide. If not, print again at 100 %."
    axes.text(left + _RULER_MM + 5, bottom - 10, f"{text} {board.columns} x {board.rows} squares.", fontsize=7)
    try:
        figure.savefig(path, format="pdf")
    except OSError as error:
        raise InvalidInput(f"{path}: cannot be written: {error}") from error


def _black(board: Board, square: float) -> shapely.Geometry:
    """The black area of a board with squares of side `square`, its lower left corner at the origin."""
    model = charuco(board)
    boxes = [
        shapely.box(column, row, column + 1, row + 1)
        for column in range(board.columns)
        for row in range(board.rows)
        if (column + board.rows - 1 - row) % 2 == 0  # the upper left square is black
    ]
    module = MARKER / _MARKER_MODULES
    for number, corners in zip(model.getIds().ravel(), model.getObjPoints(), strict=True):
        code = model.getDictionary().generateImageMarker(int(number), _MARKER_MODULES)
        left, top = corners[0][:2] / board.square
        for row, column in np.argwhere(code == 0):
            x, y = left + column * module, board.rows - top - row * module
            boxes.append(shapely.box(x, y - module, x + module, y))
    # Neighbours are joined, because a printer may leave hairlines between them; on a fine grid, so that they do join.
    black = shapely.union_all(shapely.set_precision(boxes, 1e-6))
    return shapely.affinity.scale(black, square, square, origin=(0, 0))


def _path(area: shapely.Geometry) -> Path:
    rings = [ring for part in shapely.get_parts(shapely.orient_polygons(area)) for ring in (part.exterior, *part.interiors)]
    return Path.make_compound_path(*(Path(np.array(ring.coords), closed=True) for ring in rings))
