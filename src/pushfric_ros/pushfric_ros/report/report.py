"""An estimate as one JSON object, the same whether it is live, replayed or offline."""

import json
import math
from typing import Any

import numpy as np

from pushfric_core.contact_friction import Slip
from pushfric_core.estimate import Estimate
from pushfric_core.table_1 import TABLE_1
from pushfric_msgs.msg import FrictionEstimate, Recognition

STATUS_NAMES = {
    FrictionEstimate.STATUS_NO_DATA: "no data",
    FrictionEstimate.STATUS_OPTIMAL: "optimal",
    FrictionEstimate.STATUS_UNCERTIFIED: "uncertified",
    FrictionEstimate.STATUS_INFEASIBLE: "infeasible",
}


SLIP_NAMES = [state.value for state in Slip]
"""The words for a slip, in the order of the values of ContactFriction.slips."""


def report(msg: FrictionEstimate) -> dict[str, Any]:
    """All numbers of an estimate as the command line's JSON names them; SI units, object frame."""
    friction = msg.support_friction
    figures = {
        "object": msg.object,
        "objective": msg.objective,
        "lower_bound": msg.lower_bound,
        "gap": msg.gap,
        "w": list(friction.weights),
        "support_points": [[point.x, point.y] for point in friction.support_points],
        "center_of_friction": [msg.center_of_friction.x, msg.center_of_friction.y],
        "mu_c": {"p90": msg.contact_friction.p90, "max": msg.contact_friction.max},
        "data_points": msg.data_points,
        "pushes": msg.pushes,
        "status": STATUS_NAMES[msg.status],
    }
    if msg.contact_friction.slipping:
        figures["mu_c"]["slipping"] = list(msg.contact_friction.slipping)
    if friction.total_friction:
        figures["total_friction"] = friction.total_friction[0]
    if msg.confidence:
        figures["confidence"] = msg.confidence[0]
    for spread in msg.spread:
        figures["center_of_friction_covariance"] = spread.covariance.reshape(2, 2).tolist()
        figures["w_intervals"] = np.column_stack((spread.low, spread.high)).tolist()
        center = (spread.middle @ np.asarray(figures["support_points"])).tolist()
        figures["middle"] = {"w": list(spread.middle), "center_of_friction": center}
    for mu_c in msg.mu_c:
        value = None if math.isnan(mu_c.value) else mu_c.value
        figures["mu_c"] |= {"value": value, "interval": [mu_c.low, mu_c.high], "kind": mu_c.kind}
    if msg.contact_friction.slips:
        figures["mu_c"]["slips"] = dict(zip(SLIP_NAMES, msg.contact_friction.slips, strict=True))
    figures["verdict"] = {"use": not msg.reasons, "reasons": list(msg.reasons), "notes": list(msg.notes)}
    figures["rejected"] = [{"push": one.push_id, "reason": one.reason} for one in msg.rejected]
    for change in msg.change:
        figures["change"] = {"since_push": change.since_push, "shift": [change.shift.x, change.shift.y]}
    return figures


def ensemble(estimate: Estimate) -> list[dict[str, Any]]:
    """Weighted samples of w and mu_c for planners; none if the spread is unknown. mu_c is None if it is only bounded."""
    if estimate.spread is None:
        return []
    weights = estimate.spread.samples
    return [
        {"w": w, "mu_c": mu_c, "weight": 1 / len(weights)} for w, mu_c in zip(weights, estimate.mu_c_of(weights), strict=True)
    ]


def recognition_report(msg: Recognition) -> dict[str, Any]:
    """A ranking as the command line's JSON names it, best hypothesis first; `best` is None if none is feasible."""
    names = ("name", "fit_error", "ratio", "feasible")
    return {
        "best": msg.best or None,
        "hypotheses": [{name: getattr(hypothesis, name) for name in names} for hypothesis in msg.hypotheses],
    }


def truth(name: str) -> dict[str, Any]:
    """The true values of a simulated object of Table 1, under the same names; SI units, object frame."""
    known = TABLE_1[name]
    return {
        "center_of_friction": known.support.center_of_friction.tolist(),
        "support_points": known.support.points.tolist(),
        "w": known.support.weights.tolist(),
        "mu_c": known.mu_c,
    }


def to_json(figures: Any) -> str:
    """JSON on one line; infinite numbers and NaN become the strings "inf", "-inf" and "nan"."""
    return json.dumps(_finite(figures), allow_nan=False)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_finite(item) for item in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else str(float(value))
    return value.item() if isinstance(value, np.generic) else value
