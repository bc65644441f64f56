"""URDF: the object for ROS and PyBullet."""

from xml.etree.ElementTree import Element

from pushfric_core.formats.body import FOOT_RADIUS, GYRATION, Body
from pushfric_core.formats.links import Link, chain, meshes
from pushfric_core.formats.xml_text import document, element, numbers

NOTES = (
    "Joints x, y [m] and theta [rad] are the pose of the object frame on the table z = 0.",
    "PyBullet multiplies two coefficients: give table and tip 1. Gazebo takes the lesser: give them at least 1.",
)

LIMIT = 1e3
"""No joint moves so far [m]; URDF wants a limit."""


def urdf(body: Body) -> dict[str, str]:
    """The files: name and text."""
    root = Element("robot", name=body.file_name)
    element(root, "link", name="world")
    for link in chain(body):
        _link(root, link)
        joint = element(root, "joint", name=link.joint, type="continuous" if link.turns else "prismatic")
        element(joint, "parent", link=link.parent)
        element(joint, "child", link=link.name)
        element(joint, "origin", xyz=numbers(*link.place))
        element(joint, "axis", xyz=numbers(*link.axis))
        if not link.turns:
            element(joint, "limit", lower=-LIMIT, upper=LIMIT, effort=LIMIT, velocity=LIMIT)
    return {f"{body.file_name}.urdf": document(root, body.comments(*NOTES)), **meshes(body)}


def _link(root: Element, link: Link) -> None:
    into = element(root, "link", name=link.name)
    inertial = element(into, "inertial")
    element(inertial, "mass", value=link.mass)
    own, none = link.mass * GYRATION**2, 0.0
    element(inertial, "inertia", ixx=own, ixy=none, ixz=none, iyy=own, iyz=none, izz=own)
    for shape in link.shapes:
        for kind in ("visual", "collision"):
            part = element(into, kind)
            element(part, "origin", xyz=numbers(*shape.place))
            geometry = element(part, "geometry")
            if shape.box is not None:
                element(geometry, "box", size=numbers(*shape.box))
            elif shape.mesh is not None:
                element(geometry, "mesh", filename=shape.mesh)
            else:
                element(geometry, "sphere", radius=FOOT_RADIUS)
    if link.shapes:
        element(element(into, "contact"), "lateral_friction", value=link.friction)  # PyBullet reads it
        gazebo = element(root, "gazebo", reference=link.name)
        for name in ("mu1", "mu2"):
            element(gazebo, name, link.friction)
