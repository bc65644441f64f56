"""JSON for programs of one's own, and the YAML files of planners with a pusher and a slider."""

import json as json_text
import math
from typing import Any

import numpy as np
import yaml

from pushfric_core.formats.body import Body
from pushfric_core.geometry.planar import as_array
from pushfric_core.mechanics.surface_models import convex_quartic

FORMAT = 1
"""Version of the JSON."""


def json(body: Body) -> dict[str, str]:
    """All that is known, object frame, SI units; docs/planning.md has the keys."""
    friction, load, feet = body.friction, body.load, body.feet
    samples = zip(friction.w.tolist(), friction.mu_c.tolist(), friction.share.tolist(), strict=True)
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
        "total_friction": load.total_friction,
        "mu_c": friction.mean_mu_c,
        "support_points": friction.support_points.tolist(),
        "w": friction.support.weights.tolist(),
        "center_of_friction": friction.center_of_friction.tolist(),
        "misfit": friction.misfit,
        "samples": [{"w": w, "mu_c": mu_c, "weight": share} for w, mu_c, share in samples],
        "feet": {
            "points": feet.support.points.tolist(),
            "w": feet.support.weights.tolist(),
            "load_error": feet.error.load,
            "motion_error": feet.error.twist,
        },
        "ellipsoid": {"f_max": body.ellipsoid.f_max, "m_max": body.ellipsoid.m_max},
        "quartic": convex_quartic(friction.support).coefficients.tolist(),
    }
    return {f"{body.file_name}.json": json_text.dumps(content, indent=1) + "\n"}


def planning_through_contact(body: Body) -> dict[str, str]:
    """The fields of `SliderPusherSystemConfig`; its contact radius is that of the farthest corner, about p_CF."""
    corners = _about_center(body)
    farthest = max(math.hypot(x, y) for x, y in corners)
    content = {
        "slider": {"name": body.name, "mass": body.load.mass, "vertices": corners, "com": [0.0, 0.0]},
        "pusher_radius": body.pusher_radius,
        "friction_coeff_table_slider": body.load.table_friction,
        "friction_coeff_slider_pusher": body.mu_c,
        "grav_acc": body.load.gravity,
        "integration_constant": body.ellipsoid.m_max / (body.ellipsoid.f_max * farthest),
    }
    note = f"integration_constant goes with VertexDefinedGeometry(vertices, com): its contact radius is {farthest:.4g} m."
    return _yaml(body, "planning-through-contact", content, note)


def pusher_slider(body: Body) -> dict[str, str]:
    """The parameters of its `dynamics`."""
    length, width = body.outline.size.tolist()
    even = body.outline.grid(40, 40)
    uniform = float(np.linalg.norm(even - even.mean(axis=0), axis=1).mean())
    content = {
        "dynamics": {
            "xLenght": length,
            "yLenght": width,
            "pusherRadious": body.pusher_radius,
            "pusherFricCoef": body.mu_c,
        }
    }
    ratio = body.ellipsoid.m_max / body.ellipsoid.f_max
    note = (
        f"{_rectangle(body)} pusher_slider assumes uniform pressure, whose ratio of moment to force is"
        f" {1e3 * uniform:.3g} mm; that of this object is {1e3 * ratio:.3g} mm."
    )
    return _yaml(body, "pusher-slider", content, note)


def nmpc(body: Body) -> dict[str, str]:
    """The slider of a quasi-static NMPC with an ellipsoidal limit surface."""
    length, width = body.outline.size.tolist()
    content = {
        "mu_sg": body.load.table_friction,
        "mu_sp": body.mu_c,
        "m": body.load.mass,
        "xwidth": length,
        "ywidth": width,
        "area": body.outline.polygon.area,
        "f_max": body.ellipsoid.f_max,
        "tau_max": body.ellipsoid.m_max,
        "c_ellipse": body.ellipsoid.m_max / body.ellipsoid.f_max,
        "outline": _about_center(body),
    }
    note = f"{_rectangle(body)} Take tau_max as it is: uniform pressure would give another one."
    return _yaml(body, "nmpc", content, note)


def _rectangle(body: Body) -> str:
    """What the planner's rectangle leaves out."""
    polygon = body.outline.polygon
    x, y = (as_array(polygon.envelope.centroid.coords[0]) - as_array(body.ellipsoid.center)).tolist()
    what = "outline" if polygon.equals(polygon.envelope) else "outline's bounding box"
    return f"The middle of the {what} lies at ({x:.6g}, {y:.6g}) m; a planner that centres its rectangle on p_CF errs by that."


def _about_center(body: Body) -> list[list[float]]:
    corners: list[list[float]] = (body.outline.vertices - as_array(body.ellipsoid.center)).tolist()
    return corners


def _yaml(body: Body, planner: str, content: dict[str, Any], note: str) -> dict[str, str]:
    x, y = body.ellipsoid.center.tolist()
    frame = f"The planner's origin is p_CF, at ({x:.6g}, {y:.6g}) m in the object frame."
    comments = "".join(f"# {line}\n" for line in body.comments(note, frame))
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
    return {f"{body.file_name}.{planner}.yaml": comments + text}
