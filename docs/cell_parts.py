"""The drawings of hardware.md, and the parts to print: `python docs/cell_parts.py FOLDER` writes the parts as STL, in mm.

It needs trimesh and mapbox_earcut. `--drawings` rewrites the drawings beside this file.
"""

import math
import pathlib
import sys

FOLDER = pathlib.Path(__file__).parent

# Sizes [mm]. Whoever needs others changes them here: parts and drawings follow, and a test compares text and example cell.
TIP_RADIUS, TIP_LENGTH, TIP_BORE = 5.0, 30.0, 4.3  # the bore takes an M4 screw
PLATE, PLATE_HEIGHT, HOLE, PITCH = (120.0, 80.0), 6.0, 6.4, 20.0  # the holes take M6 screws, the loads, and the feet
FOOT_RADIUS, FOOT_HEIGHT, PEG = 5.0, 3.0, 6.5  # the peg is pressed into its hole
STROKE, CAMERA_HEIGHT, VIEW = 60.0, 800.0, (400.0, 300.0)
HOLES = [(PITCH * column, PITCH * row) for column in (-2, -1, 0, 1, 2) for row in (-1, 0, 1)]
CORNERS = 48  # of a circle

STYLE = """
    svg { --paper: #fff; --ink: #222; --fill: #eef2f6; --pale: #555; --accent: #0072b2; --warn: #b3261e; }
    @media (prefers-color-scheme: dark) {
      svg { --paper: #16191d; --ink: #e6e6e6; --fill: #262c33; --pale: #aab; --accent: #56b4e9; --warn: #ff8a80; }
    }
    text { font: 14px sans-serif; fill: var(--ink); text-anchor: middle; }
    .pale { fill: var(--pale); font-size: 13px; } .left { text-anchor: start; } .end { text-anchor: end; }
    .box { fill: var(--fill); stroke: var(--ink); } .seen { fill: none; stroke: var(--accent); stroke-dasharray: 7 5; }
    path { fill: none; stroke: var(--ink); stroke-width: 1.5; } .power { stroke: var(--warn); stroke-width: 2.5; }
    .accent { stroke: var(--accent); stroke-width: 2; } .tip { fill: var(--accent); }
    marker path { fill: var(--ink); stroke: none; }"""

HEAD = (
    '<marker id="head" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="11" markerHeight="11" markerUnits="userSpaceOnUse"'
    ' orient="auto"><path d="M0 1L10 5L0 9Z"/></marker>'
)


def box(x: float, y: float, width: float, height: float, kind: str = "box") -> str:
    """A rectangle."""
    return f'<rect class="{kind}" x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="4"/>'


def text(x: float, y: float, said: str, kind: str = "") -> str:
    """A line of text."""
    return f'<text class="{kind}" x="{x:g}" y="{y:g}">{said}</text>'


def line(points: str, kind: str = "", arrow: bool = False) -> str:
    """A line through points, perhaps with an arrow at its end."""
    return f'<path class="{kind}" d="M{points}"{" marker-end=" + chr(34) + "url(#head)" + chr(34) if arrow else ""}/>'


def drawing(title: str, width: int, height: int, *parts: str) -> str:
    """An SVG, legible on a light and on a dark page."""
    size = f'viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
    paper = f'<rect width="{width}" height="{height}" rx="8" fill="var(--paper)"/>'
    inner = "\n  ".join((f"<defs>{HEAD}</defs>", paper, *parts))
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img" aria-labelledby="title">'
    head += f'\n  <title id="title">{title}</title>'
    return f"{head}\n  <style>{STYLE}\n  </style>\n  {inner}\n</svg>\n"


def plan() -> str:
    """The cell from above, 1 px for 1 mm."""
    x, y = 330.0, 330.0  # the tip at stroke position 0
    wide, deep = PLATE
    top = y - 5 - TIP_RADIUS - deep
    holes = [f'<circle class="box" cx="{x + u:g}" cy="{top + deep / 2 + v:g}" r="{HOLE / 2:g}"/>' for u, v in HOLES]
    return drawing(
        "The cell from above",
        660,
        470,
        box(30, 30, 600, 350),
        text(40, 50, "table: flat, dark, matt", "pale left"),
        box(x - VIEW[0] / 2, 60, *VIEW, "seen"),
        text(x - VIEW[0] / 2 + 8, 78, f"seen by the camera, {VIEW[0]:g} x {VIEW[1]:g} mm", "pale left"),
        box(x - wide / 2, top, wide, deep),
        *holes,
        text(x, top - 10, f"object: test plate, {wide:g} x {deep:g} mm"),
        box(x - 22, 350, 44, 100),
        text(x + 34, 425, "rail and carriage", "left"),
        line(f"{x:g} 350V{y:g}", "accent"),
        f'<circle class="tip" cx="{x:g}" cy="{y:g}" r="{TIP_RADIUS:g}"/>',
        text(x + 14, y + 5, "tip", "left"),
        line(f"{x + 90:g} {y:g}v{-STROKE:g}", "accent", arrow=True),
        text(x + 100, y - STROKE / 2, f"stroke {STROKE:g} mm", "left"),
        line(f"60 {y:g}h45", arrow=True),
        line(f"60 {y:g}v-45", arrow=True),
        text(112, y + 5, "x", "left"),
        text(60, y - 52, "y"),
        text(46, y + 22, "table frame", "pale left"),
    )


def side() -> str:
    """The cell from the side: the camera's height at a quarter, the heights at the tip at eight times their size."""
    table, lens = 290.0, 290.0 - CAMERA_HEIGHT / 4
    reach, thick, foot = VIEW[1] / 4, 8 * PLATE_HEIGHT, 8 * FOOT_HEIGHT
    return drawing(
        "The cell from the side",
        660,
        340,
        line(f"20 {table:g}H640"),
        text(24, table + 22, "table, level", "pale left"),
        box(100, lens - 34, 60, 34),
        text(130, lens - 42, "camera, fixed focus"),
        f'<path class="seen" d="M130 {lens:g}L{130 - reach:g} {table:g}M130 {lens:g}L{130 + reach:g} {table:g}"/>',
        line(f"225 {lens:g}V{table:g}", arrow=True),
        text(233, (lens + table) / 2 + 26, f"{CAMERA_HEIGHT:g} mm: 0.6 mm of table", "pale left"),
        text(233, (lens + table) / 2 + 44, "per pixel at 640 pixels", "pale left"),
        box(430, table - foot - thick, 110, thick),
        box(440, table - foot, 24, foot),
        box(506, table - foot, 24, foot),
        text(470, table - foot - thick - 44, f"plate {PLATE_HEIGHT:g} mm on feet of {FOOT_HEIGHT:g} mm"),
        box(548, table - foot - thick - 34, 40, thick + 34 + foot - 8),
        text(600, table - 46, "tip", "left"),
        text(600, table - 28, "1 mm", "pale left"),
        text(600, table - 12, "clear", "pale left"),
        text(485, table + 22, "(eight times as large)", "pale"),
    )


def wiring() -> str:
    """Signals, and the power that the emergency stop interrupts."""
    parts = []
    for x, y, name, kind in (
        (20, 40, "computer", "Linux"),
        (20, 160, "camera", "USB or Ethernet"),
        (20, 270, "lamp", "its own supply"),
        (250, 40, "controller", "GRBL 1.1, grblHAL"),
        (250, 160, "home switch", "opens at the end"),
        (480, 40, "driver, motor", "D2, D5 or 2, 3"),
        (480, 160, "emergency stop", "two contacts that open"),
        (480, 270, "supply 24 V", "for motors alone"),
    ):
        parts += [box(x, y, 160, 54), text(x + 80, y + 23, name), text(x + 80, y + 42, kind, "pale")]
    return drawing(
        "Wiring of cell A",
        660,
        340,
        line("180 67H250", arrow=True),
        text(215, 60, "USB", "pale"),
        line("410 67H480", arrow=True),
        line("100 160V94", arrow=True),
        line("330 160V94", arrow=True),
        text(338, 132, "D9 or 20", "pale left"),
        line("560 270V214", "power", arrow=True),
        box(545, 230, 30, 24),
        text(536, 247, "fuse 1 A", "pale end"),
        line("480 297H250V310"),
        line("235 310H265"),
        line("240 316H260"),
        line("245 322H255"),
        text(278, 290, "earth, at one point", "pale left"),
        text(278, 318, "with rail and table frame", "pale left"),
        line("560 160V94", "power", arrow=True),
        text(568, 132, "power", "pale left"),
        line("480 187H440V80H410", "", arrow=True),
        text(448, 132, "A0 or 14", "pale left"),
        *parts,
    )


DRAWINGS = {"cell_plan.svg": plan, "cell_side.svg": side, "cell_wiring.svg": wiring}


def parts() -> dict:
    """The parts to print, as meshes by file name."""
    from shapely.geometry import Point
    from shapely.geometry import box as rectangle
    from trimesh.creation import extrude_polygon, revolve

    bore, quarter = TIP_BORE / 2, CORNERS // 4
    tip = [(bore, 0), (TIP_RADIUS - 0.5, 0), (TIP_RADIUS, 0.5), (TIP_RADIUS, TIP_LENGTH), (bore, TIP_LENGTH), (bore, 0)]
    dome = [
        (FOOT_RADIUS * math.sin(turn), FOOT_HEIGHT * (1 - math.cos(turn)))
        for turn in (math.pi / 2 * step / quarter for step in range(quarter + 1))
    ]
    foot = [*dome, (PEG / 2, FOOT_HEIGHT), (PEG / 2, FOOT_HEIGHT + PLATE_HEIGHT - 1), (0, FOOT_HEIGHT + PLATE_HEIGHT - 1)]
    wide, deep = PLATE
    plate = rectangle(-wide / 2, -deep / 2, wide / 2, deep / 2)
    for hole in HOLES:
        plate = plate.difference(Point(hole).buffer(HOLE / 2, quad_segs=quarter))
    return {
        "tip.stl": revolve(tip, sections=CORNERS),
        "foot.stl": revolve(foot, sections=CORNERS),
        "plate.stl": extrude_polygon(plate, PLATE_HEIGHT),
    }


def main(arguments: list[str]) -> None:
    """Write the drawings, or the parts."""
    if arguments == ["--drawings"]:
        for name, draw in DRAWINGS.items():
            (FOLDER / name).write_text(draw(), encoding="utf-8")
        return
    if len(arguments) != 1:
        sys.exit("expected a folder for the parts, or --drawings")
    folder = pathlib.Path(arguments[0])
    folder.mkdir(parents=True, exist_ok=True)
    for name, mesh in parts().items():
        mesh.export(folder / name)
        x, y, z = mesh.extents
        print(f"{folder / name}: {x:.1f} x {y:.1f} x {z:.1f} mm, watertight: {mesh.is_watertight}")


if __name__ == "__main__":
    main(sys.argv[1:])
