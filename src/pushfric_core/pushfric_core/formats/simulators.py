"""Files for simulators: MJCF, a scene for MuJoCo with the object, a table and a round tip on two position servos; and SDF, the
object for Gazebo and Drake."""

import itertools
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import numpy.typing as npt

from pushfric_core.formats.body import CLEARANCE, FOOT_RADIUS, GYRATION, SHELL_MASS, ExportedBody
from pushfric_core.geometry.planar import Array

TIME_STEP = 1e-3
"""Time step of MuJoCo [s]."""

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

MJCF_NOTES = (
    "Joints x, y [m] and theta [rad] are the pose of the object frame.",
    "Feet and shell have priority, so that they meet any table and any tip with these coefficients.",
)

SDF_NOTES = (
    "Joints x, y [m] and theta [rad] are the pose of the object frame on the table z = 0.",
    "Gazebo takes the lesser of two coefficients: give the table at least that of the feet, the tip at least that of the shell."
    " Drake takes 2ab / (a + b): give them the same.",
)

Triple = tuple[float, float, float]

ORIGIN = (0, 0, 0)


def mjcf(body: ExportedBody) -> dict[str, str]:
    """The files: name and text."""
    load, height = body.load, body.height
    x, y = (body.outline.lower + body.outline.size * (0.5, 0.0) - (0.0, GAP + body.pusher_radius)).tolist()
    tip = _element(
        "geom", name="pusher", type="sphere", size=body.pusher_radius, mass=TIP_MASS * load.mass, contype=2, conaffinity=2
    )
    meshes, shell = _shell(body)
    hinge, inertia = _element("joint", name="theta", type="hinge", axis="0 0 1"), _inertia(SHELL_MASS * load.mass)
    root = _element(
        "mujoco",
        _element("option", timestep=TIME_STEP, gravity=(0, 0, -load.gravity), cone="elliptic", **SOLVER),
        _element("asset", *meshes),
        _element(
            "worldbody",
            _element("geom", name="table", type="plane", size="1 1 0.1"),
            _element("body", *_slides("x", "y"), hinge, inertia, *shell, *_feet(body), name="object"),
            _element("body", *_slides(*TIP), tip, name="pusher", pos=(x, y, (CLEARANCE + height) / 2)),
        ),
        _element("actuator", *(_element("position", name=one, joint=one, kp=SERVO * load.mass, dampratio=1) for one in TIP)),
        model=body.name,
    )
    place = f"Actuators pusher_x and pusher_y move the tip from ({x:.9g}, {y:.9g}) m; push with at most 10 mm/s."
    return {f"{body.file_name}.xml": _document(root, body.comments(*MJCF_NOTES, place))}


def _shell(body: ExportedBody) -> tuple[list[Element], list[Element]]:
    """The meshes of the object's shell, and what touches the tip: one box, or these meshes."""
    friction = (body.mu_c, 0, 0)
    if body.box is not None:
        middle, sides = body.box
        return [], [_element("geom", name="shell", type="box", pos=middle, size=sides / 2, friction=friction, **SHELL)]
    named = [(f"shell_{k}", prism) for k, prism in enumerate(body.prisms)]
    meshes = [_element("mesh", name=name, vertex=prism) for name, prism in named]
    return meshes, [_element("geom", name=name, type="mesh", mesh=name, friction=friction, **SHELL) for name, _ in named]


def _feet(body: ExportedBody) -> Iterator[Element]:
    friction = (body.load.table_friction, 0, 0)
    for k, (x, y, mass) in enumerate(body.footing):
        name, slide = f"foot_{k}", _element("joint", name=f"foot_{k}", type="slide", axis="0 0 1")
        sphere = _element("geom", name=name, type="sphere", size=FOOT_RADIUS, friction=friction, **FEET)
        yield _element("body", slide, _inertia(mass), sphere, name=name, pos=(x, y, FOOT_RADIUS))


def _slides(x: str, y: str) -> tuple[Element, Element]:
    return _element("joint", name=x, type="slide", axis="1 0 0"), _element("joint", name=y, type="slide", axis="0 1 0")


def _inertia(mass: float) -> Element:
    return _element("inertial", pos="0 0 0", mass=mass, diaginertia=3 * [mass * GYRATION**2])


def sdf(body: ExportedBody) -> dict[str, str]:
    """The files: name and text. x, y and theta carry the shell over the table; each foot presses on it from its own slide.

    The shell is one box, or convex prisms in files of their own.
    """
    light = SHELL_MASS * body.load.mass
    meshes: dict[str, str] = {}
    if body.box is None:
        meshes = {f"{body.file_name}_{k}.obj": _prism(prism) for k, prism in enumerate(body.prisms)}
        shell = [_shape(k, ORIGIN, _element("mesh", _element("uri", name)), body.mu_c) for k, name in enumerate(meshes)]
    else:
        middle, sides = body.box
        shell = [_shape(0, middle, _element("box", _element("size", sides)), body.mu_c)]
    parts = [*_hung("slide_x", "world", "x", "1 0 0", light), *_hung("slide_y", "slide_x", "y", "0 1 0", light)]
    parts += _hung("shell", "slide_y", "theta", "0 0 1", light, ORIGIN, *itertools.chain(*shell))
    foot = _shape(0, ORIGIN, _element("sphere", _element("radius", FOOT_RADIUS)), body.load.table_friction)
    for k, (x, y, mass) in enumerate(body.footing):
        parts += _hung(f"foot_{k}", "shell", f"slide_{k}", "0 0 1", mass, (x, y, FOOT_RADIUS), *foot)
    root = _element("sdf", _element("model", *parts, name=body.name), version="1.7")
    return {f"{body.file_name}.sdf": _document(root, body.comments(*SDF_NOTES)), **meshes}


def _hung(
    name: str, parent: str, joint: str, axis: str, mass: float, place: Triple = ORIGIN, *shapes: Element
) -> tuple[Element, Element]:
    """A link at a place in the object frame [m], and the joint through its origin: theta turns about the axis, others slide."""
    inertia = _element("inertia", *(_element(axes, mass * GYRATION**2) for axes in ("ixx", "iyy", "izz")))
    inertial = _element("inertial", _element("mass", mass), inertia)
    ends = _element("parent", parent), _element("child", name), _element("axis", _element("xyz", axis))
    link = _element("link", _element("pose", (*place, 0, 0, 0)), inertial, *shapes, name=name)
    return link, _element("joint", *ends, name=joint, type="revolute" if joint == "theta" else "prismatic")


def _shape(k: int, place: Iterable[float], geometry: Element, friction: float) -> tuple[Element, Element]:
    """The visual and the collision element of a link, with this coefficient."""
    pose = _element("pose", (*place, 0, 0, 0))
    # Drake and Gazebo's other engines read it, too
    engine = _element("ode", _element("mu", friction), _element("mu2", friction))
    surface = _element("surface", _element("friction", engine))
    visual = _element("visual", pose, _element("geometry", geometry), name=f"visual_{k}")
    return visual, _element("collision", pose, _element("geometry", geometry), surface, name=f"collision_{k}")


def _prism(corners: Array) -> str:
    """An OBJ file, whose indices begin at 1; all faces are counter-clockwise, seen from outside."""
    n = len(corners) // 2
    vertices = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in corners.tolist()]
    sides = [(k + 1, (k + 1) % n + 1, (k + 1) % n + n + 1, k + n + 1) for k in range(n)]
    faces = [tuple(range(n, 0, -1)), tuple(range(n + 1, 2 * n + 1)), *sides]
    return "\n".join((*vertices, *(f"f {' '.join(map(str, face))}" for face in faces), ""))


def _element(tag: str, /, *content: Element | npt.ArrayLike, **attributes: npt.ArrayLike) -> Element:
    """An element with its children, or with a text; numbers are written with nine digits, and spaces between them."""
    made = Element(tag, {name: _text(value) for name, value in attributes.items()})
    for one in content:
        if isinstance(one, Element):
            made.append(one)
        else:
            made.text = _text(one)
    return made


def _document(root: Element, comments: Iterable[str]) -> str:
    """The file: the comments, in which XML allows no double hyphen, and the element; without control characters."""
    ElementTree.indent(root)
    lines = re.sub("-(?=-)", "- ", "\n".join(comments))
    document = f'<?xml version="1.0"?>\n<!--\n{lines}\n-->\n{ElementTree.tostring(root, encoding="unicode")}\n'
    return re.sub(r"[\x00-\x08\x0b\x0c\x0e-\x1f]", "", document)


def _text(value: npt.ArrayLike) -> str:
    return value if isinstance(value, str) else " ".join(f"{one:.9g}" for one in np.ravel(value))
