"""Messages of bags up to version 0.1.0, in the definitions of today.

What was an array of at most one is now a single value, NaN if the array was empty. The first of these bags lack some fields.
"""

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from pushfric_core.bags.constants import constants
from pushfric_core.bags.samples import unknown_pose

FRICTION, CHANGE, REASON = constants("ContactFriction"), constants("ObjectChange"), constants("Reason")


def present(type_name: str, msg: Any) -> Any:
    """A decoded message in the definition of today, if it was recorded with a former one.

    Raises:
        AttributeError: it was recorded with another one.
    """
    return FORMER[type_name](msg) if type_name in FORMER else msg


def _observation(msg: Any) -> Any:
    if not isinstance(msg.pose, list):
        return msg
    tip_velocity = getattr(msg, "tip_velocity", [])
    return _changed(
        msg,
        duration=msg.duration or math.nan,
        pose=msg.pose[0] if msg.pose else unknown_pose(_record),
        force=msg.force[0] if msg.force else _nowhere(),
        tip_velocity=tip_velocity[0] if tip_velocity else _nowhere(),
        depth=getattr(msg, "depth", 0.0) or math.nan,
    )


def _total_friction(msg: Any) -> Any:
    return msg if isinstance(msg.total_friction, float) else _changed(msg, total_friction=_only(msg.total_friction))


def _contact_friction(msg: Any, mu_c: Any = None) -> Any:
    """The bounds, and the value that stood beside them in FrictionEstimate."""
    if hasattr(msg, "kind"):
        return msg
    known = {"kind": FRICTION["KIND_UNKNOWN"], "value": math.nan, "low": math.nan, "high": math.nan}
    if mu_c is not None:
        known = {**vars(mu_c), "kind": FRICTION[f"KIND_{mu_c.kind.upper()}"]}
    return _changed(msg, **known, slip=int(msg.slip[0]) if len(msg.slip) else FRICTION["SLIP_UNKNOWN"])


def _friction_estimate(msg: Any) -> Any:
    none = np.zeros(0)
    if not hasattr(msg, "posterior"):
        numbers = {"covariance": np.full(4, math.nan), "feet": math.nan, "area": math.nan, "data_points": 0}
        msg = _changed(msg, posterior=SimpleNamespace(w=none, center_of_friction=_nowhere(), **numbers))
    if not hasattr(msg, "mu_c"):
        return msg
    unknown = SimpleNamespace(covariance=np.full(4, math.nan), middle=none, low=none, high=none, data_points=0)
    spread = msg.spread[0] if msg.spread else unknown
    unchanged = SimpleNamespace(since_push=CHANGE["NO_PUSH"], shift=_nowhere())
    return _changed(
        msg,
        support_friction=_total_friction(msg.support_friction),
        contact_friction=_contact_friction(msg.contact_friction, msg.mu_c[0] if msg.mu_c else None),
        confidence=_only(msg.confidence),
        spread=_changed(spread, data_points=getattr(spread, "data_points", msg.data_points)),
        reasons=[_reason(text) for text in msg.reasons],
        notes=[_reason(text) for text in getattr(msg, "notes", [])],
        rejected=[_changed(one, reason=_reason(one.reason)) for one in msg.rejected],
        change=msg.change[0] if msg.change else unchanged,
    )


def _plan_progress(msg: Any) -> Any:
    return msg if hasattr(msg, "skipped") else _changed(msg, skipped=0, in_place=False, purpose="", details="")


FORMER: dict[str, Callable[[Any], Any]] = {
    "pushfric_msgs/msg/Observation": _observation,
    "pushfric_msgs/msg/SupportFriction": _total_friction,
    "pushfric_msgs/msg/ContactFriction": _contact_friction,
    "pushfric_msgs/msg/FrictionEstimate": _friction_estimate,
    "pushfric_msgs/msg/LimitSurface": _total_friction,
    "pushfric_msgs/msg/PlanProgress": _plan_progress,
}
"""The types whose definitions have changed since version 0.1.0."""


def _changed(msg: Any, **fields: Any) -> SimpleNamespace:
    return SimpleNamespace(**{**vars(msg), **fields})


def _only(values: Any) -> float:
    """The number in an array of at most one; NaN if it is empty."""
    return float(values[0]) if len(values) else math.nan


def _record(_: str, **fields: Any) -> SimpleNamespace:
    """A message whose fields are all given: to look its type up would mean to load all types."""
    return SimpleNamespace(**fields)


def _nowhere() -> SimpleNamespace:
    return SimpleNamespace(**dict.fromkeys("xyz", math.nan))


def _reason(text: str) -> SimpleNamespace:
    return SimpleNamespace(code=REASON["UNKNOWN"], text=text)
