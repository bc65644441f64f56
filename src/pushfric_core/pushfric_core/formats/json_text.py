"""JSON for programs of one's own, and for planners."""

import json as json_text

from pushfric_core.formats.body import Body
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
