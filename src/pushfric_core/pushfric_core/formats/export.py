"""Export of a friction model: to a simulator, or as JSON to a planner or a program of one's own."""

import json as jsons
import math
from collections.abc import Callable

from pushfric_core.formats.body import CLEARANCE, GRAVITY, HEIGHT, PUSHER_RADIUS, ExportedBody, load_of
from pushfric_core.formats.simulators import mjcf, sdf
from pushfric_core.geometry.outline import Outline
from pushfric_core.mechanics.limit_surface import named_ellipsoid
from pushfric_core.mechanics.prediction import FrictionModel
from pushfric_core.plausible import LARGEST, check_within

FORMAT = 1
"""Version of the JSON."""


def json(body: ExportedBody) -> dict[str, str]:
    """All that is known, object frame, SI units; docs/planning.md has the keys."""
    friction, load, feet = body.friction, body.load, body.feet
    ellipsoid, total = named_ellipsoid(friction.support), load.table_friction * load.mass * load.gravity
    content = {
        "format": FORMAT,
        "comments": body.comments(),
        "object": body.name,
        "outline": body.outline.vertices.tolist(),
        "height": body.height,
        "pusher_radius": body.pusher_radius,
        "mass": load.mass,
        "gravity": load.gravity,
        "table_friction": load.table_friction,
        "total_friction": total,
        "mu_c": friction.median_mu_c,
        "support_points": friction.support_points.tolist(),
        "w": friction.support.weights.tolist(),
        "center_of_friction": friction.center_of_friction.tolist(),
        "misfit": friction.misfit,
        "sliding_misfit": friction.sliding_misfit,
        "stroke_misfit": friction.stroke_misfit,
        "samples": friction.samples,
        "feet": {
            "points": feet.support.points.tolist(),
            "w": feet.support.weights.tolist(),
            "load_error": feet.error.load,
            "motion_error": feet.error.twist,
        },
        "ellipsoid": {"f_max": total * ellipsoid.f_max, "m_max": total * ellipsoid.m_max},
    }
    return {f"{body.file_name}.json": jsons.dumps(content, indent=1) + "\n"}


FORMATS: dict[str, Callable[[ExportedBody], dict[str, str]]] = {"mjcf": mjcf, "sdf": sdf, "json": json}


def export(
    model: FrictionModel,
    outline: Outline,
    to: str,
    *,
    name: str = "object",
    mass: float | None = None,
    table_friction: float | None = None,
    total_friction: float | None = None,
    gravity: float = GRAVITY,
    height: float = HEIGHT,
    pusher_radius: float = PUSHER_RADIUS,
    rests_on: str = "made by pushfric_core.export",
) -> dict[str, str]:
    """The files of an object: the text of each by its name. They belong in one folder, the first one names the others.

    The support becomes a few feet, each with its share of the mass on a vertical slide of its own, so that its normal force is
    exact. Of the ensemble, simulators get the mean; export each of `model.drawn(n)` to randomise the object.

    Args:
        model: of the object.
        outline: object frame.
        to: mjcf, sdf or json.
        name: of the object.
        mass: [kg]; None: from the total friction, or 1 kg.
        table_friction: coefficient of the table; None: from mass and total friction, or 0.35.
        total_friction: measured support friction of the translating object [N].
        gravity: [m/s^2].
        height: of the object [m].
        pusher_radius: of the round tip [m].
        rests_on: first line of the comment on top of each file.
    Raises:
        ValueError: an unknown format, or figures that make no sense.

    Example:
        >>> from pushfric_core import TABLE_1, FrictionModel, export
        >>> known = TABLE_1["wood_rect4"]
        >>> files = export(FrictionModel.of(known.support, known.mu_c), known.outline, "mjcf", name="wood", mass=0.3)
        >>> list(files)
        ['wood.xml']
    """
    if to not in FORMATS:
        raise ValueError(f"expected one of the formats {', '.join(FORMATS)}, got {to!r}")
    figures = {"mass": mass, "table_friction": table_friction, "gravity": gravity, "total_friction": total_friction}
    for figure, value in (figures | {"pusher_radius": pusher_radius}).items():
        if value is not None and not 0 < value < math.inf:
            raise ValueError(f"{figure} must be positive and finite, got {value:g}")
    check_within("height", (height,), LARGEST, "m")
    if height <= CLEARANCE:
        raise ValueError(f"height must be more than {CLEARANCE:g} m, got {height:g}")
    load = load_of(mass, table_friction, gravity, total_friction)
    return FORMATS[to](ExportedBody(name, outline, model, load, height, pusher_radius, rests_on))
