"""SDF: the object for Gazebo and Drake."""

from collections.abc import Iterator
from xml.etree.ElementTree import Element

from pushfric_core.formats.body import CLEARANCE, FOOT_RADIUS, GYRATION, SHELL_MASS, ExportedBody
from pushfric_core.formats.xml_text import document, element, numbers
from pushfric_core.geometry.planar import Array

NOTES = (
    "Joints x, y [m] and theta [rad] are the pose of the object frame on the table z = 0.",
    "Gazebo takes the lesser of two coefficients: give the table at least that of the feet, the tip at least that of the shell."
    " Drake takes 2ab / (a + b): give them the same.",
)

Triple = tuple[float, float, float]

X, Y, Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)


def sdf(body: ExportedBody) -> dict[str, str]:
    """The files: name and text. x, y and theta carry the shell over the table; each foot presses on it from its own slide."""
    root = Element("sdf", version="1.7")
    model = element(root, "model", name=body.name)
    light = SHELL_MASS * body.load.mass
    _hang(model, "slide_x", "world", "x", X, light)
    _hang(model, "slide_y", "slide_x", "y", Y, light)
    shell = _hang(model, "shell", "slide_y", "theta", Z, light)
    for k, (place, geometry) in enumerate(_shell(body)):
        _shape(shell, k, place, geometry, body.mu_c)
    sphere = Element("sphere")
    element(sphere, "radius", FOOT_RADIUS)
    feet = body.feet.support
    for k, ((x, y), share) in enumerate(zip(feet.points.tolist(), feet.weights.tolist(), strict=True)):
        foot = _hang(model, f"foot_{k}", "shell", f"slide_{k}", Z, share * body.load.mass, (x, y, FOOT_RADIUS))
        _shape(foot, 0, (0, 0, 0), sphere, body.load.table_friction)
    return {f"{body.file_name}.sdf": document(root, body.comments(*NOTES)), **_meshes(body)}


def _hang(model: Element, name: str, parent: str, joint: str, axis: Triple, mass: float, place: Triple = (0, 0, 0)) -> Element:
    """A link at a place in the object frame [m], and the joint through its origin: theta turns about the axis, others slide."""
    link = element(model, "link", name=name)
    element(link, "pose", numbers(*place, 0, 0, 0))
    inertial = element(link, "inertial")
    element(inertial, "mass", mass)
    inertia = element(inertial, "inertia")
    for axes in ("ixx", "iyy", "izz"):
        element(inertia, axes, mass * GYRATION**2)
    hinge = element(model, "joint", name=joint, type="revolute" if joint == "theta" else "prismatic")
    element(hinge, "parent", parent)
    element(hinge, "child", name)
    element(element(hinge, "axis"), "xyz", numbers(*axis))
    return link


def _shape(link: Element, k: int, place: Triple, geometry: Element, friction: float) -> None:
    """The visual and the collision element of a link, with this coefficient."""
    for kind in ("visual", "collision"):
        part = element(link, kind, name=f"{kind}_{k}")
        element(part, "pose", numbers(*place, 0, 0, 0))
        element(part, "geometry").append(geometry)
    engine = element(element(element(part, "surface"), "friction"), "ode")  # Drake and Gazebo's other engines read it, too
    for name in ("mu", "mu2"):
        element(engine, name, friction)


def _shell(body: ExportedBody) -> Iterator[tuple[Triple, Element]]:
    """Place and geometry of each piece: one box, or meshes in files of their own."""
    if body.box is None:
        for k in range(len(body.pieces)):
            mesh = Element("mesh")
            element(mesh, "uri", _mesh_name(body, k))
            yield (0, 0, 0), mesh
    else:
        (x, y), (length, width) = (pair.tolist() for pair in body.box)
        box = Element("box")
        element(box, "size", numbers(length, width, body.height - CLEARANCE))
        yield (x, y, (body.height + CLEARANCE) / 2), box


def _meshes(body: ExportedBody) -> dict[str, str]:
    """Convex prisms as OBJ files, by name; none if the shell is a box."""
    pieces = body.pieces if body.box is None else []
    return {_mesh_name(body, k): _prism(piece, body.height) for k, piece in enumerate(pieces)}


def _mesh_name(body: ExportedBody, k: int) -> str:
    return f"{body.file_name}_{k}.obj"


def _prism(corners: Array, height: float) -> str:
    """An OBJ file, whose indices begin at 1; all faces are counter-clockwise, seen from outside."""
    n = len(corners)
    vertices = [f"v {x:.9g} {y:.9g} {z:.9g}" for z in (CLEARANCE, height) for x, y in corners.tolist()]
    sides = [(k + 1, (k + 1) % n + 1, (k + 1) % n + n + 1, k + n + 1) for k in range(n)]
    faces = [tuple(range(n, 0, -1)), tuple(range(n + 1, 2 * n + 1)), *sides]
    return "\n".join((*vertices, *(f"f {' '.join(map(str, face))}" for face in faces), ""))
