"""SDF: the object for Gazebo and Drake."""

import itertools
from collections.abc import Iterable
from xml.etree.ElementTree import Element

from pushfric_core.formats.body import FOOT_RADIUS, GYRATION, SHELL_MASS, ExportedBody
from pushfric_core.formats.xml_text import document, element
from pushfric_core.geometry.planar import Array

NOTES = (
    "Joints x, y [m] and theta [rad] are the pose of the object frame on the table z = 0.",
    "Gazebo takes the lesser of two coefficients: give the table at least that of the feet, the tip at least that of the shell."
    " Drake takes 2ab / (a + b): give them the same.",
)

Triple = tuple[float, float, float]

ORIGIN = (0, 0, 0)


def sdf(body: ExportedBody) -> dict[str, str]:
    """The files: name and text. x, y and theta carry the shell over the table; each foot presses on it from its own slide.

    The shell is one box, or convex prisms in files of their own.
    """
    light = SHELL_MASS * body.load.mass
    meshes: dict[str, str] = {}
    if body.box is None:
        meshes = {f"{body.file_name}_{k}.obj": _prism(prism) for k, prism in enumerate(body.prisms)}
        shell = [_shape(k, ORIGIN, element("mesh", element("uri", name)), body.mu_c) for k, name in enumerate(meshes)]
    else:
        middle, sides = body.box
        shell = [_shape(0, middle, element("box", element("size", sides)), body.mu_c)]
    parts = [*_hung("slide_x", "world", "x", "1 0 0", light), *_hung("slide_y", "slide_x", "y", "0 1 0", light)]
    parts += _hung("shell", "slide_y", "theta", "0 0 1", light, ORIGIN, *itertools.chain(*shell))
    foot = _shape(0, ORIGIN, element("sphere", element("radius", FOOT_RADIUS)), body.load.table_friction)
    for k, (x, y, mass) in enumerate(body.footing):
        parts += _hung(f"foot_{k}", "shell", f"slide_{k}", "0 0 1", mass, (x, y, FOOT_RADIUS), *foot)
    root = element("sdf", element("model", *parts, name=body.name), version="1.7")
    return {f"{body.file_name}.sdf": document(root, body.comments(*NOTES)), **meshes}


def _hung(
    name: str, parent: str, joint: str, axis: str, mass: float, place: Triple = ORIGIN, *shapes: Element
) -> tuple[Element, Element]:
    """A link at a place in the object frame [m], and the joint through its origin: theta turns about the axis, others slide."""
    inertia = element("inertia", *(element(axes, mass * GYRATION**2) for axes in ("ixx", "iyy", "izz")))
    inertial = element("inertial", element("mass", mass), inertia)
    ends = element("parent", parent), element("child", name), element("axis", element("xyz", axis))
    link = element("link", element("pose", (*place, 0, 0, 0)), inertial, *shapes, name=name)
    return link, element("joint", *ends, name=joint, type="revolute" if joint == "theta" else "prismatic")


def _shape(k: int, place: Iterable[float], geometry: Element, friction: float) -> tuple[Element, Element]:
    """The visual and the collision element of a link, with this coefficient."""
    pose = element("pose", (*place, 0, 0, 0))
    engine = element("ode", element("mu", friction), element("mu2", friction))  # Drake and Gazebo's other engines read it, too
    surface = element("surface", element("friction", engine))
    visual = element("visual", pose, element("geometry", geometry), name=f"visual_{k}")
    return visual, element("collision", pose, element("geometry", geometry), surface, name=f"collision_{k}")


def _prism(corners: Array) -> str:
    """An OBJ file, whose indices begin at 1; all faces are counter-clockwise, seen from outside."""
    n = len(corners) // 2
    vertices = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in corners.tolist()]
    sides = [(k + 1, (k + 1) % n + 1, (k + 1) % n + n + 1, k + n + 1) for k in range(n)]
    faces = [tuple(range(n, 0, -1)), tuple(range(n + 1, 2 * n + 1)), *sides]
    return "\n".join((*vertices, *(f"f {' '.join(map(str, face))}" for face in faces), ""))
