"""The drawings of graph.md and derivation.md: `python docs/drawings.py` rewrites them beside this file."""

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


DRAWINGS = {"graph.svg": graph, "push.svg": push}

if __name__ == "__main__":
    for name, draw in DRAWINGS.items():
        (FOLDER / name).write_text(draw(), encoding="utf-8")
