"""The parts of hardware.md to print: `python docs/cell_parts.py FOLDER` writes them as STL, in mm.

It needs trimesh and mapbox_earcut.
"""

import math
import pathlib
import sys

from shapely.geometry import MultiPoint
from shapely.geometry import box as rectangle

# Sizes [mm]. Whoever needs others changes them here; a test compares the drawings and the example cell.
TIP_RADIUS, TIP_LENGTH, TIP_BORE = 5.0, 30.0, 4.3  # the bore takes an M4 screw
PLATE, PLATE_HEIGHT, HOLE, PITCH = (120.0, 80.0), 6.0, 6.4, 20.0  # the holes take M6 screws, the loads, and the feet
FOOT_RADIUS, FOOT_HEIGHT, PEG = 5.0, 3.0, 6.5  # the peg is pressed into its hole
HOLES = [(PITCH * column, PITCH * row) for column in (-2, -1, 0, 1, 2) for row in (-1, 0, 1)]
CORNERS = 48  # of a circle


def parts() -> dict:
    """The parts to print, as meshes by file name."""
    from trimesh.creation import extrude_polygon, revolve

    bore, quarter = TIP_BORE / 2, CORNERS // 4
    tip = [(bore, 0), (TIP_RADIUS - 0.5, 0), (TIP_RADIUS, 0.5), (TIP_RADIUS, TIP_LENGTH), (bore, TIP_LENGTH), (bore, 0)]
    turns = [math.pi / 2 * step / quarter for step in range(quarter + 1)]
    dome = [(FOOT_RADIUS * math.sin(turn), FOOT_HEIGHT * (1 - math.cos(turn))) for turn in turns]
    foot = [*dome, (PEG / 2, FOOT_HEIGHT), (PEG / 2, FOOT_HEIGHT + PLATE_HEIGHT - 1), (0, FOOT_HEIGHT + PLATE_HEIGHT - 1)]
    wide, deep = PLATE
    holes = MultiPoint(HOLES).buffer(HOLE / 2, quad_segs=quarter)
    return {
        "tip.stl": revolve(tip, sections=CORNERS),
        "foot.stl": revolve(foot, sections=CORNERS),
        "plate.stl": extrude_polygon(rectangle(-wide / 2, -deep / 2, wide / 2, deep / 2) - holes, PLATE_HEIGHT),
    }


def main(arguments: list[str]) -> None:
    """Write the parts."""
    if len(arguments) != 1:
        sys.exit("expected a folder for the parts")
    folder = pathlib.Path(arguments[0])
    folder.mkdir(parents=True, exist_ok=True)
    for name, mesh in parts().items():
        mesh.export(folder / name)
        x, y, z = mesh.extents
        print(f"{folder / name}: {x:.1f} x {y:.1f} x {z:.1f} mm, watertight: {mesh.is_watertight}")


if __name__ == "__main__":
    main(sys.argv[1:])
