"""The links and joints of the object, as SDF and URDF share them."""

from typing import NamedTuple

from pushfric_core.formats.body import CLEARANCE, FOOT_RADIUS, SHELL_MASS, Body
from pushfric_core.geometry.planar import Array

Triple = tuple[float, float, float]


class Shape(NamedTuple):
    """What the tip or the table meets: a box, else a mesh in a file of its own, else the sphere of a foot."""

    place: Triple = (0.0, 0.0, 0.0)  # in the link [m]
    box: Triple | None = None  # sides [m]
    mesh: str | None = None  # name of the file


class Link(NamedTuple):
    """A link and the joint by which it hangs on its parent: along or about an axis through its own origin."""

    name: str
    parent: str
    joint: str
    turns: bool  # about the axis; else it slides along it
    axis: Triple
    place: Triple  # of its origin, object frame [m]
    mass: float  # [kg]
    shapes: list[Shape]
    friction: float  # coefficient of the shapes


def chain(body: Body) -> list[Link]:
    """x, y and theta carry the shell over the table; each foot presses on it from a slide of its own."""
    light, feet, origin = SHELL_MASS * body.load.mass, body.feet.support, (0.0, 0.0, 0.0)
    return [
        Link("slide_x", "world", "x", False, (1, 0, 0), origin, light, [], 0.0),
        Link("slide_y", "slide_x", "y", False, (0, 1, 0), origin, light, [], 0.0),
        Link("shell", "slide_y", "theta", True, (0, 0, 1), origin, light, _shell(body), body.mu_c),
        *(
            Link(
                f"foot_{k}",
                "shell",
                f"slide_{k}",
                False,
                (0, 0, 1),
                (x, y, FOOT_RADIUS),
                share * body.load.mass,
                [Shape()],
                body.load.table_friction,
            )
            for k, ((x, y), share) in enumerate(zip(feet.points.tolist(), feet.weights.tolist(), strict=True))
        ),
    ]


def meshes(body: Body) -> dict[str, str]:
    """Convex prisms as OBJ files, by name; none if the shell is a box."""
    pieces = body.pieces if body.box is None else []
    return {_mesh_name(body, k): _prism(piece, body.height) for k, piece in enumerate(pieces)}


def _shell(body: Body) -> list[Shape]:
    if body.box is None:
        return [Shape(mesh=_mesh_name(body, k)) for k in range(len(body.pieces))]
    (x, y), (length, width) = (pair.tolist() for pair in body.box)
    return [Shape((x, y, (body.height + CLEARANCE) / 2), (length, width, body.height - CLEARANCE))]


def _mesh_name(body: Body, k: int) -> str:
    return f"{body.file_name}_{k}.obj"


def _prism(corners: Array, height: float) -> str:
    """An OBJ file, whose indices begin at 1; all faces are counter-clockwise, seen from outside."""
    n = len(corners)
    vertices = [f"v {x:.9g} {y:.9g} {z:.9g}" for z in (CLEARANCE, height) for x, y in corners.tolist()]
    sides = [(k + 1, (k + 1) % n + 1, (k + 1) % n + n + 1, k + n + 1) for k in range(n)]
    faces = [tuple(range(n, 0, -1)), tuple(range(n + 1, 2 * n + 1)), *sides]
    return "\n".join((*vertices, *(f"f {' '.join(map(str, face))}" for face in faces), ""))
