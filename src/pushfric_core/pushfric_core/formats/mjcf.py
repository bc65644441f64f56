"""MJCF: a scene for MuJoCo with the object, a table and a round tip on two position servos."""

from collections.abc import Iterator
from typing import Any
from xml.etree.ElementTree import Element

from pushfric_core.formats.body import CLEARANCE, FOOT_RADIUS, GYRATION, SHELL_MASS, ExportedBody
from pushfric_core.formats.xml_text import document, element

TIME_STEP = 1e-3
"""[s]"""

SOLVER: dict[str, Any] = {"impratio": 100, "integrator": "implicitfast"}
"""impratio is the ratio of the stiffness of friction to that of the normal force: a sliding foot bears its full friction
above 0.1 mm/s."""

FEET: dict[str, Any] = {"priority": 1, "contype": 1, "conaffinity": 0, "solref": "0.01 1", "solimp": "0.7 0.7 0.001"}
"""Soft enough that MuJoCo's friction, which lifts what slides, does not lift the feet off the table below 60 mm/s."""

SHELL: dict[str, Any] = {"priority": 1, "contype": 3, "conaffinity": 3, "solref": "0.003 1", "solimp": "0.5 0.5 0.001"}
"""The same for the tip: it enters the object by about 0.03 mm, and stays in touch if it slides along it by up to 15 mm/s."""

TIP_MASS = 10
"""Mass of the tip, as a multiple of the object's."""

SERVO = 1e5
"""Stiffness of the tip's servos for each kilogram of the object [1/s^2]: the tip lags by about 0.03 mm."""

TIP = ("pusher_x", "pusher_y")
"""The joints and actuators of the tip."""

GAP = 0.02
"""Between the tip and the outline's box at the start [m]."""

NOTES = (
    "Joints x, y [m] and theta [rad] are the pose of the object frame.",
    "Feet and shell have priority, so that they meet any table and any tip with these coefficients.",
)


def mjcf(body: ExportedBody) -> dict[str, str]:
    """The files: name and text."""
    load, height = body.load, body.height
    x, y = (body.outline.lower + body.outline.size * (0.5, 0.0) - (0.0, GAP + body.pusher_radius)).tolist()
    tip = element(
        "geom", name="pusher", type="sphere", size=body.pusher_radius, mass=TIP_MASS * load.mass, contype=2, conaffinity=2
    )
    meshes, shell = _shell(body)
    hinge, inertia = element("joint", name="theta", type="hinge", axis="0 0 1"), _inertia(SHELL_MASS * load.mass)
    root = element(
        "mujoco",
        element("option", timestep=TIME_STEP, gravity=(0, 0, -load.gravity), cone="elliptic", **SOLVER),
        element("asset", *meshes),
        element(
            "worldbody",
            element("geom", name="table", type="plane", size="1 1 0.1"),
            element("body", *_slides("x", "y"), hinge, inertia, *shell, *_feet(body), name="object"),
            element("body", *_slides(*TIP), tip, name="pusher", pos=(x, y, (CLEARANCE + height) / 2)),
        ),
        element("actuator", *(element("position", name=one, joint=one, kp=SERVO * load.mass, dampratio=1) for one in TIP)),
        model=body.name,
    )
    place = f"Actuators pusher_x and pusher_y move the tip from ({x:.9g}, {y:.9g}) m; push with at most 10 mm/s."
    return {f"{body.file_name}.xml": document(root, body.comments(*NOTES, place))}


def _shell(body: ExportedBody) -> tuple[list[Element], list[Element]]:
    """The meshes of the object's shell, and what touches the tip: one box, or these meshes."""
    friction = (body.mu_c, 0, 0)
    if body.box is not None:
        middle, sides = body.box
        return [], [element("geom", name="shell", type="box", pos=middle, size=sides / 2, friction=friction, **SHELL)]
    named = [(f"shell_{k}", prism) for k, prism in enumerate(body.prisms)]
    meshes = [element("mesh", name=name, vertex=prism) for name, prism in named]
    return meshes, [element("geom", name=name, type="mesh", mesh=name, friction=friction, **SHELL) for name, _ in named]


def _feet(body: ExportedBody) -> Iterator[Element]:
    friction = (body.load.table_friction, 0, 0)
    for k, (x, y, mass) in enumerate(body.footing):
        name, slide = f"foot_{k}", element("joint", name=f"foot_{k}", type="slide", axis="0 0 1")
        sphere = element("geom", name=name, type="sphere", size=FOOT_RADIUS, friction=friction, **FEET)
        yield element("body", slide, _inertia(mass), sphere, name=name, pos=(x, y, FOOT_RADIUS))


def _slides(x: str, y: str) -> tuple[Element, Element]:
    return element("joint", name=x, type="slide", axis="1 0 0"), element("joint", name=y, type="slide", axis="0 1 0")


def _inertia(mass: float) -> Element:
    return element("inertial", pos="0 0 0", mass=mass, diaginertia=3 * [mass * GYRATION**2])
