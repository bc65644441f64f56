"""SDF: the object for Gazebo and Drake, and a model directive with which Drake adds it."""

from xml.etree.ElementTree import Element

import yaml

from pushfric_core.formats.body import FOOT_RADIUS, GYRATION, Body
from pushfric_core.formats.links import Link, chain, meshes
from pushfric_core.formats.xml_text import document, element, numbers

PACKAGE = "pushfric_models"
"""The name under which Drake finds the folder."""

NOTES = (
    "Joints x, y [m] and theta [rad] are the pose of the object frame on the table z = 0.",
    "Gazebo takes the lesser of two coefficients: give the table at least that of the feet, the tip at least that of the shell."
    " Drake takes 2ab / (a + b): give them the same.",
)


def sdf(body: Body) -> dict[str, str]:
    """The files: name and text."""
    root = Element("sdf", version="1.7")
    model = element(root, "model", name=body.name)
    for link in chain(body):
        _link(model, link)
        joint = element(model, "joint", name=link.joint, type="revolute" if link.turns else "prismatic")
        element(joint, "parent", link.parent)
        element(joint, "child", link.name)
        element(element(joint, "axis"), "xyz", numbers(*link.axis))
    return {f"{body.file_name}.sdf": document(root, body.comments(*NOTES)), **meshes(body)}


def drake(body: Body) -> dict[str, str]:
    """The directive, and the files of `sdf` that it names."""
    files = sdf(body)
    content = {"directives": [{"add_model": {"name": body.file_name, "file": f"package://{PACKAGE}/{next(iter(files))}"}}]}
    note = f"parser.package_map().Add({PACKAGE!r}, the folder of this file) before the directives are processed."
    comments = "".join(f"# {line}\n" for line in body.comments(*NOTES, note))
    return {f"{body.file_name}.dmd.yaml": comments + yaml.safe_dump(content, sort_keys=False), **files}


def _link(model: Element, link: Link) -> None:
    into = element(model, "link", name=link.name)
    element(into, "pose", numbers(*link.place, 0, 0, 0))
    inertial = element(into, "inertial")
    element(inertial, "mass", link.mass)
    inertia = element(inertial, "inertia")
    for axes in ("ixx", "iyy", "izz"):
        element(inertia, axes, link.mass * GYRATION**2)
    for k, shape in enumerate(link.shapes):
        for kind in ("visual", "collision"):
            part = element(into, kind, name=f"{kind}_{k}")
            element(part, "pose", numbers(*shape.place, 0, 0, 0))
            geometry = element(part, "geometry")
            if shape.box is not None:
                element(element(geometry, "box"), "size", numbers(*shape.box))
            elif shape.mesh is not None:
                element(element(geometry, "mesh"), "uri", shape.mesh)
            else:
                element(element(geometry, "sphere"), "radius", FOOT_RADIUS)
        engine = element(element(element(part, "surface"), "friction"), "ode")  # Drake and Gazebo's other engines read it, too
        for name in ("mu", "mu2"):
            element(engine, name, link.friction)
