"""MJCF: a scene for MuJoCo with the object, a table and a round tip on two position servos."""

from xml.etree.ElementTree import Element

from pushfric_core.formats.body import CLEARANCE, FOOT_RADIUS, GYRATION, SHELL_MASS, ExportedBody
from pushfric_core.formats.xml_text import document, element, numbers

TIME_STEP = 1e-3
"""[s]"""

FRICTION_STIFFNESS = 100
"""Ratio of the stiffness of friction to that of the normal force: a sliding foot bears its full friction above 0.1 mm/s."""

FEET = {"solref": "0.01 1", "solimp": "0.7 0.7 0.001"}
"""Soft enough that MuJoCo's friction, which lifts what slides, does not lift the feet off the table below 60 mm/s."""

SHELL = {"solref": "0.003 1", "solimp": "0.5 0.5 0.001"}
"""The same for the tip: it enters the object by about 0.03 mm, and stays in touch if it slides along it by up to 15 mm/s."""

TIP_MASS = 10
"""Mass of the tip, as a multiple of the object's."""

SERVO = 1e5
"""Stiffness of the tip's servos for each kilogram of the object [1/s^2]: the tip lags by about 0.03 mm."""

GAP = 0.02
"""Between the tip and the outline's box at the start [m]."""

NOTES = (
    "Joints x, y [m] and theta [rad] are the pose of the object frame.",
    "Feet and shell have priority, so that they meet any table and any tip with these coefficients.",
)


def mjcf(body: ExportedBody) -> dict[str, str]:
    """The files: name and text."""
    root = Element("mujoco", model=body.name)
    gravity = numbers(0, 0, -body.load.gravity)
    element(
        root,
        "option",
        timestep=TIME_STEP,
        gravity=gravity,
        cone="elliptic",
        impratio=FRICTION_STIFFNESS,
        integrator="implicitfast",
    )
    assets = element(root, "asset")
    world = element(root, "worldbody")
    element(world, "geom", name="table", type="plane", size="1 1 0.1")
    _object(body, assets, world)
    x, y = (body.outline.lower + body.outline.size * (0.5, 0.0) - (0.0, GAP + body.pusher_radius)).tolist()
    tip = element(world, "body", name="pusher", pos=numbers(x, y, (CLEARANCE + body.height) / 2))
    _slides(tip, "pusher_x", "pusher_y")
    radius, mass = body.pusher_radius, TIP_MASS * body.load.mass
    element(tip, "geom", name="pusher", type="sphere", size=radius, mass=mass, contype=2, conaffinity=2)
    actuators = element(root, "actuator")
    for joint in ("pusher_x", "pusher_y"):
        element(actuators, "position", name=joint, joint=joint, kp=SERVO * body.load.mass, dampratio=1)
    place = f"Actuators pusher_x and pusher_y move the tip from ({x:.9g}, {y:.9g}) m; push with at most 10 mm/s."
    return {f"{body.file_name}.xml": document(root, body.comments(*NOTES, place))}


def _object(body: ExportedBody, assets: Element, world: Element) -> None:
    frame = element(world, "body", name="object")
    _slides(frame, "x", "y")
    element(frame, "joint", name="theta", type="hinge", axis="0 0 1")
    _inertia(frame, SHELL_MASS * body.load.mass)
    tip = numbers(body.mu_c, 0, 0)
    shell: dict[str, str | float] = {"friction": tip, "priority": 1, "contype": 3, "conaffinity": 3, **SHELL}
    if body.box is not None:
        (x, y), (length, width) = body.box
        size = numbers(length / 2, width / 2, (body.height - CLEARANCE) / 2)
        place = numbers(x, y, (body.height + CLEARANCE) / 2)
        element(frame, "geom", name="shell", type="box", pos=place, size=size, **shell)
    else:
        for k, piece in enumerate(body.pieces):
            corners = (numbers(x, y, z) for z in (CLEARANCE, body.height) for x, y in piece)
            element(assets, "mesh", name=f"shell_{k}", vertex=" ".join(corners))
            element(frame, "geom", name=f"shell_{k}", type="mesh", mesh=f"shell_{k}", **shell)
    table = numbers(body.load.table_friction, 0, 0)
    sliding: dict[str, str | float] = {"friction": table, "priority": 1, "contype": 1, "conaffinity": 0, **FEET}
    feet = body.feet.support
    for k, ((x, y), share) in enumerate(zip(feet.points.tolist(), feet.weights.tolist(), strict=True)):
        foot = element(frame, "body", name=f"foot_{k}", pos=numbers(x, y, FOOT_RADIUS))
        element(foot, "joint", name=f"foot_{k}", type="slide", axis="0 0 1")
        _inertia(foot, share * body.load.mass)
        element(foot, "geom", name=f"foot_{k}", type="sphere", size=FOOT_RADIUS, **sliding)


def _slides(body: Element, x: str, y: str) -> None:
    element(body, "joint", name=x, type="slide", axis="1 0 0")
    element(body, "joint", name=y, type="slide", axis="0 1 0")


def _inertia(body: Element, mass: float) -> None:
    element(body, "inertial", pos="0 0 0", mass=mass, diaginertia=numbers(*3 * [mass * GYRATION**2]))
