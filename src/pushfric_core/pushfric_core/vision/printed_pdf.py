"""PDFs to be printed to scale: the board for the calibration, and the markers on an object."""

import pathlib
from typing import Any

import numpy as np
import shapely
import shapely.affinity
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from pushfric_core.files.figure_file import save_figure
from pushfric_core.geometry.outline import Outline
from pushfric_core.vision.board import MARKER, Board, charuco
from pushfric_core.vision.fiducial_tracker import BORDER_MODULES, Fiducials

_PAPER_MM = (297.0, 210.0)  # A4, landscape
_MARGIN_MM = 12.0
_RULER_MM, _RULER_ROOM_MM = 100, 16.0


def save_board(board: Board, path: pathlib.Path) -> None:
    """Write the board to scale as a PDF, on A4 or larger paper, with a ruler to check the print.

    Raises:
        InvalidInput: the file cannot be written, or has not the name of an image.
    """
    text = f"Each square is {1e3 * board.square:g} mm wide. {board.columns} x {board.rows} squares."
    _save(_black(board), shapely.box(0.0, 0.0, *board.size), text, path)


def save_markers(fiducials: Fiducials, outline: Outline, path: pathlib.Path) -> None:
    """Write the markers where they belong on an object, to scale, with the object's outline to cut or paste along.

    Raises:
        InvalidInput: the file cannot be written, or has not the name of an image.
    """
    codes = [
        shapely.affinity.translate(
            shapely.affinity.rotate(_code(fiducials.dictionary, one.id, one.size), one.angle_deg, origin=(0, 0)), *one.center
        )
        for one in fiducials.markers
    ]
    ids = ", ".join(str(one.id) for one in fiducials.markers)
    _save(shapely.union_all(codes), outline.polygon, f"Markers {ids} of {fiducials.family}. Cut along the thin line.", path)


def _save(black: shapely.Geometry, frame: shapely.Geometry, text: str, path: pathlib.Path) -> None:
    """Write a black area [m] in the middle of a page, with a thin line around its frame [m] and a ruler below."""
    low, high = (1e3 * np.array(corner) for corner in (frame.bounds[:2], frame.bounds[2:]))
    page = np.maximum(_PAPER_MM, high - low + 2 * _MARGIN_MM + (0.0, _RULER_ROOM_MM))
    left, bottom = (page - (high - low) + (0.0, _RULER_ROOM_MM)) / 2
    figure = Figure(figsize=tuple(page / 25.4), frameon=False)
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, page[0]), ylim=(0, page[1]))
    axes.set_axis_off()
    to_page = (1e3, 0.0, 0.0, 1e3, left - low[0], bottom - low[1])
    axes.add_patch(PathPatch(_path(shapely.affinity.affine_transform(black, to_page)), facecolor="black", linewidth=0))
    cut = _path(shapely.affinity.affine_transform(frame, to_page))
    axes.add_patch(PathPatch(cut, facecolor="none", edgecolor="0.6", linewidth=0.2))
    for mm in range(0, _RULER_MM + 1, 5):
        axes.plot((_MARGIN_MM + mm,) * 2, (bottom - 10, bottom - (6 if mm % 10 == 0 else 8)), color="black", linewidth=0.3)
    ruler = f"This ruler is {_RULER_MM} mm long. If not, print again at 100 %. {text}"
    axes.text(_MARGIN_MM + _RULER_MM + 5, bottom - 10, ruler, fontsize=7)
    save_figure(figure, path)


def _black(board: Board) -> shapely.Geometry:
    """The black area of a board [m], its lower left corner at the origin."""
    model = charuco(board)
    squares = [
        shapely.box(column, row, column + 1, row + 1)
        for column in range(board.columns)
        for row in range(board.rows)
        if (column + board.rows - 1 - row) % 2 == 0  # the upper left square is black
    ]
    for number, corners in zip(model.getIds().ravel(), model.getObjPoints(), strict=True):
        u, v = corners.mean(axis=0)[:2] / board.square  # OpenCV counts rows downwards
        code = _code(model.getDictionary(), int(number), MARKER)
        squares.append(shapely.affinity.translate(code, float(u), board.rows - float(v)))
    return shapely.affinity.scale(shapely.union_all(squares), board.square, board.square, origin=(0, 0))


def _code(dictionary: Any, number: int, size: float) -> shapely.Geometry:
    """The black area of a marker with this side, its middle at the origin, upright."""
    modules = dictionary.markerSize + BORDER_MODULES
    cells = np.argwhere(dictionary.generateImageMarker(number, modules) == 0)
    # neighbours are joined, because a printer may leave hairlines between them
    black = shapely.union_all([shapely.box(column, -row - 1, column + 1, -row) for row, column in cells])
    scale = size / modules
    return shapely.affinity.affine_transform(black, (scale, 0.0, 0.0, scale, -size / 2, size / 2))


def _path(area: shapely.Geometry) -> Path:
    rings = [ring for part in shapely.get_parts(shapely.orient_polygons(area)) for ring in (part.exterior, *part.interiors)]
    return Path.make_compound_path(*(Path(np.array(ring.coords), closed=True) for ring in rings))
