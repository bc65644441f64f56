"""The drawings of graph, derivation, safety, cell and files: `python docs/drawings.py` rewrites them beside this file."""

from collections.abc import Sequence

import numpy as np
from cell_parts import FOLDER, box, drawing, line, text

from pushfric_core import Outline, Support, Twist
from pushfric_core.geometry.support import friction_directions

NODE = (130.0, 50.0)
"""Width and height of a node's box [px]."""


def node(x: float, y: float, name: str) -> tuple[str, str]:
    """A node of the graph."""
    return box(x, y, *NODE), text(x + NODE[0] / 2, y + NODE[1] / 2 + 5, name)


def outside(x: float, y: float, name: str) -> tuple[str, str]:
    """What is no node."""
    return box(x, y, 100, NODE[1], "seen"), text(x + 50, y + NODE[1] / 2 + 5, name, "pale")


def graph() -> str:
    """The nodes of a cell, and the main topics between them."""
    parts = [
        *outside(15, 40, "camera"),
        *outside(15, 150, "controller"),
        *outside(15, 260, "operator"),
        *node(185, 40, "tracker"),
        *node(185, 150, "actuator"),
        *node(185, 260, "experiment"),
        *node(470, 40, "estimator"),
        *node(470, 150, "view"),
        *node(470, 260, "recorder"),
        *node(690, 40, "planner"),
        *outside(705, 150, "browser"),
        *outside(705, 260, "bag"),
    ]
    topics = 425.0
    return drawing(
        "The nodes of a cell and the topics between them",
        835,
        360,
        line(f"{topics:g} 65V285", "accent"),
        line("115 65H185", arrow=True),
        text(150, 56, "images", "pale"),
        line("115 175H185", arrow=True),
        line("185 175H115", arrow=True),
        text(150, 166, "serial", "pale"),
        line("185 285H115", arrow=True),
        text(150, 276, "placement", "pale"),
        line("250 260V200", arrow=True),
        text(258, 234, "push", "pale left"),
        line("315 65H470", "accent", arrow=True),
        text(322, 56, "object_pose", "pale left"),
        line(f"315 175H{topics:g}", "accent"),
        text(322, 166, "pusher_state", "pale left"),
        line(f"{topics:g} 285H315", "accent", arrow=True),
        line(f"{topics:g} 175H470", "accent", arrow=True),
        line(f"{topics:g} 285H470", "accent", arrow=True),
        line("535 90V150", arrow=True),
        text(543, 126, "friction_estimate", "pale left"),
        line("600 65H690", arrow=True),
        text(645, 56, "friction_model", "pale"),
        line("600 175H705", arrow=True),
        line("600 285H705", arrow=True),
        text(417, 340, "blue: poses and pusher states, received by every node at the end of an arrow", "pale"),
        *parts,
    )


def push() -> str:
    """An object in motion, its friction by the library: eqs 1, 2 and 4 in one picture. 1 px is 0.31 mm."""
    outline = Outline.rectangle(0.12, 0.08)
    support = Support(np.array(((-0.05, -0.03), (0.05, -0.03), (0.05, 0.03), (-0.05, 0.03))), np.array((0.15, 0.4, 0.3, 0.15)))
    twist = Twist(0.004, 0.02, 0.3)
    velocities = np.array((twist.vx, twist.vy)) + twist.omega * support.points[:, ::-1] * (-1, 1)
    frictions = support.weights[:, None] * friction_directions(support.points, twist)
    wrench = support.friction_wrench(twist)
    force = np.array((wrench.fx, wrench.fy))
    # the line of the friction force, where it meets the lower edge: there the tip pushes
    along = force / np.hypot(*force)
    foot = wrench.m / np.hypot(*force) * np.array((along[1], -along[0]))
    edge = outline.lower[1]
    contact = foot + (edge - foot[1]) / along[1] * along
    scale = 3200.0

    def at(point: np.ndarray) -> str:
        return f"{370 + scale * point[0]:.1f} {215 - scale * point[1]:.1f}"

    def arrow(start: np.ndarray, way: np.ndarray, kind: str) -> str:
        return line(f"{at(start)}L{at(start + way)}", kind, arrow=True)

    def named(point: np.ndarray, x: float, y: float, said: str, kind: str = "left") -> str:
        u, v = map(float, at(point).split())
        return text(u + x, v + y, said, kind)

    corner, size = outline.lower + (0, outline.size[1]), scale * outline.size
    u, v = map(float, at(corner).split())
    center = support.center_of_friction
    rotation_center = np.array((-twist.vy, twist.vx)) / twist.omega
    points = [
        f'<circle class="tip" cx="{at(p).split()[0]}" cy="{at(p).split()[1]}" r="{30 * w**0.5:.1f}" fill-opacity="0.45"/>'
        for p, w in zip(support.points, support.weights, strict=True)
    ]
    return drawing(
        "A push from above: each support's friction opposes its velocity, and their sum passes through the contact",
        700,
        430,
        box(u, v, *size),
        line(f"{at(contact - 0.012 * along)}L{at(contact - 0.105 * along)}", "seen"),
        *points,
        *(arrow(p, 0.6 * v_j, "") for p, v_j in zip(support.points, velocities, strict=True)),
        *(arrow(p, 0.06 * f_j, "power") for p, f_j in zip(support.points, frictions, strict=True)),
        arrow(contact, -0.03 * force, "accent"),
        f'<circle cx="{at(contact).split()[0]}" cy="{at(contact).split()[1]}" r="4" fill="var(--ink)"/>',
        line(f"{at(center + (-0.002, 0))}L{at(center + (0.002, 0))}M{at(center + (0, -0.002))}L{at(center + (0, 0.002))}"),
        line(f"{at(rotation_center + (-0.001, 0.001))}l8 8m0 -8l-8 8"),
        named(rotation_center, -10, 5, "centre of rotation", "pale end"),
        named(center, 10, -6, "p_CF"),
        named(contact, -14, 18, "p_c", ""),
        named(contact - 0.03 * force, -10, 0, "force of the tip, &#8722;f", "end"),
        named(support.points[1] + 0.6 * velocities[1], 8, 4, "v_j"),
        named(support.points[1] + 0.06 * frictions[1], 10, 10, "f_j"),
        named(contact - 0.105 * along, -8, 4, "f lies on a line through p_c: no moment about it", "pale end"),
    )


def stops() -> str:
    """From the client of a push to the motor, and how soon the pusher rests without each."""
    chain = (
        ("client", ("goal,", "heartbeats"), ("dies, hangs:", "0.3 s and braking")),
        ("actuator", ("the next", "0.25 s"), ("dies, is late:", "0.25 s and braking")),
        ("controller", ("steps", ""), ("does not answer:", "0.3 s")),
        ("motor", (), ()),
    )
    parts = []
    for number, (name, sends, without) in enumerate(chain):
        x = 20.0 + 210 * number
        parts += [*node(x, 150, name), *(text(x + 65, 228 + 18 * row, said, "pale") for row, said in enumerate(without))]
        if sends:
            parts.append(line(f"{x + 130:g} 175h80", "accent", arrow=True))
            parts += [text(x + 168, 166 + 26 * row, said, "pale") for row, said in enumerate(sends)]
    for x, name, what in (
        (20, "camera, tracker", "1.1 s"),
        (230, "a person", "stop: 0.14 s"),
        (440, "enable, force", "as for a stop"),
        (650, "emergency stop", "cuts the supply"),
    ):
        parts += [box(x, 30, *NODE, "seen"), text(x + 65, 51, name, "pale"), text(x + 65, 69, what, "pale")]
    ways = (("85 80V115H270V150", ""), ("300 80V150", ""), ("505 80V115H330V150", ""), ("715 80V150", "power"))
    return drawing(
        "What a push needs to go on, and how soon the pusher rests without it",
        800,
        270,
        *(line(way, kind, arrow=True) for way, kind in ways),
        *parts,
    )


def columns(title: str, width: int, rows: Sequence[Sequence[str]], heads: Sequence[str] = ()) -> str:
    """Rows of boxes from left to right, with an arrow from each to the next; an empty text is no box."""
    step, parts = width / len(rows[0]), []
    for place, head in enumerate(heads):
        parts.append(text(step * (place + 0.5), 26, head, "pale"))
    for number, row in enumerate(rows):
        y = 40.0 + 58 * number
        for place, said in enumerate(row):
            x = step * place + 15
            if said:
                parts += [box(x, y, step - 45, 44, "box" if place else "seen"), text(x + (step - 45) / 2, y + 27, said)]
            if place and said and row[place - 1]:
                parts.append(line(f"{x - 30:g} {y + 22:g}h30", "accent", arrow=True))
    return drawing(title, width, 50 + 58 * len(rows), *parts)


def cell_file() -> str:
    """The sections of a cell's file, the files they name, and the nodes that read them."""
    rows = (
        ("object.yaml", "object", "all of the nodes below"),
        ("camera.yaml, markers.yaml", "camera  (or poses)", "tracker  (or pose_source)"),
        ("a serial port or an arm", "pusher  (or tip)", "actuator  (or tip_source)"),
        ("plan.yaml", "plan", "experiment"),
        ("model.yaml", "estimator", "estimator"),
    )
    return columns("A cell's file, the files that it names, and the nodes", 780, rows, ("file or device", "section", "node"))


def files() -> str:
    """Which command reads and writes which file."""
    rows = (
        ("cell.yaml, object.yaml", "run", "bag, report.html"),
        ("bag or CSV, object.yaml", "estimate", "JSON, model.yaml"),
        ("object.yaml with hypotheses", "recognize", "ranking"),
        ("bag or CSV", "region", "plan.yaml"),
        ("model.yaml, pushes.csv", "predict, stable", "motions"),
        ("model.yaml", "export", "MJCF, SDF, JSON"),
        ("damaged bag", "bag recover", "bag"),
    )
    return columns("Commands, and the files that they read and write", 780, rows, ("reads", "command", "writes"))


DRAWINGS = {"graph.svg": graph, "push.svg": push, "stops.svg": stops, "cell_file.svg": cell_file, "files.svg": files}

if __name__ == "__main__":
    for name, draw in DRAWINGS.items():
        (FOLDER / name).write_text(draw(), encoding="utf-8")
