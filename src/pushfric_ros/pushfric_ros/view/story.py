"""What a run has shown so far, for the page: everything that a visitor who comes late must know.

The story is one flat dict; a change is a part of it. A value of None removes a key. Units are SI, frames as in the messages.

    cell, object     names, and the object's outline
    estimate         the last friction_estimate as the command line's JSON names it, with mu_c's histogram; None: no data yet
    push/ID          a push: its data points, the estimate after it, and whether it was left out or aborted
    plan             the last plan_progress
    report           file of the page that the run leaves behind; empty: none
    fault            why the pusher has stopped
    node/NAME        the last diagnostics of a node
    pose, pusher     where the object and the pusher are; told only while somebody looks
"""

from collections import OrderedDict
from collections.abc import Iterable
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped

from pushfric_core.bags.samples import pose_from_msg, pose_sample_from_msg, stamp_from_msg
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.object_file import ObjectModel
from pushfric_msgs.msg import FrictionEstimate, Observation, PlanProgress, PusherState
from pushfric_ros.messages.conversions import MODE_NAMES, report_from_msg

Change = dict[str, Any]

REMEMBERED = 1000
"""Data points and estimates come on two topics. One waits for its counterpart until this many more of its kind have come."""

AFTER_PUSH = (
    "center_of_friction", "center_of_friction_covariance", "confidence", "data_points", "gap", "mu_c", "object", "objective",
    "pushes", "status", "support_points", "verdict", "w",
)  # fmt: skip
"""The parts of an estimate that the row of a push keeps, to be looked at later."""

PHASES = {
    PlanProgress.PHASE_WAITING: "waiting",
    PlanProgress.PHASE_PLACING: "placing",
    PlanProgress.PHASE_PUSHING: "pushing",
    PlanProgress.PHASE_FINISHED: "finished",
    PlanProgress.PHASE_ALARM: "alarm",
    PlanProgress.PHASE_CHOOSING: "choosing",
}
LEVELS = {
    DiagnosticStatus.OK: "ok",
    DiagnosticStatus.WARN: "warning",
    DiagnosticStatus.ERROR: "error",
    DiagnosticStatus.STALE: "stale",
}


class Story:
    """The story of one run. Each method takes a message and returns what it changes.

    Args:
        model: the object.
        namespace: of the cell.
    """

    def __init__(self, model: ObjectModel, namespace: str) -> None:
        self._model, self._namespace = model, namespace
        self._pushes: dict[int, Change] = {}
        self._push_of: OrderedDict[int, int] = OrderedDict()  # stamp of a data point [ns] -> its push
        self._after: OrderedDict[int, Change] = OrderedDict()  # stamp of the newest data point [ns] -> the estimate
        self._excluded: set[int] = set()
        self._plan: PlanProgress | None = None

    def begin(self) -> Change:
        """What is known before the first message."""
        model = {"name": self._model.name, "outline": self._model.outline.vertices.tolist()}
        return {"cell": self._namespace, "object": model, "estimate": None}

    def on_estimate(self, msg: FrictionEstimate) -> Change:
        """The estimate, and the row of the push that its newest data point belongs to."""
        if msg.status == FrictionEstimate.STATUS_NO_DATA:
            return self._without_data()
        told = report_from_msg(msg).to_dict()
        friction = msg.contact_friction
        histogram = {"bin_width": friction.bin_width, "counts": list(friction.histogram)}
        stamp = stamp_from_msg(msg.header.stamp)
        _remember(self._after, stamp, {key: told[key] for key in AFTER_PUSH if key in told} | {"histogram": histogram})
        return {"estimate": told | {"histogram": histogram}, **self._row_after(stamp)}

    def on_observation(self, msg: Observation) -> Change:
        """A data point: the push that it belongs to, and where the object was touched."""
        stamp, push = stamp_from_msg(msg.header.stamp), int(msg.push_id)
        point, normal = msg.contact_point, msg.contact_normal
        self._row(push)["contacts"].append([point.x, point.y, normal.x, normal.y])
        _remember(self._push_of, stamp, push)
        return {**self._told(push), **self._row_after(stamp)}

    def on_settings(self, text: str) -> Change:
        """The pushes that are left out, from the estimator's settings.

        Raises:
            ValueError: the estimator did not write them.
        """
        before, self._excluded = self._excluded, set(EstimatorSettings.from_text(text).excluded)
        changed: Change = {}
        for push in before ^ self._excluded:
            self._row(push)["excluded"] = push in self._excluded
            changed |= self._told(push)
        return changed

    def on_plan(self, msg: PlanProgress) -> Change:
        """The plan's progress, and the push that begins or was given up."""
        before, self._plan = self._plan, msg
        plan = {
            "phase": PHASES.get(msg.phase, "waiting"),
            "push": msg.push_id,
            "count": msg.count,
            "completed": msg.completed,
            "aborted": msg.aborted,
            "skipped": msg.skipped,
            "placement": list(pose_from_msg(msg.placement)),
            "in_place": msg.in_place,
            "purpose": msg.purpose,
            "message": msg.message,
            "details": msg.details,
        }
        changed: Change = {"plan": plan}
        if before is not None and msg.completed == before.completed:
            stopped = before.phase == PlanProgress.PHASE_PUSHING != msg.phase
            if stopped or msg.aborted + msg.skipped > before.aborted + before.skipped:
                self._row(before.push_id)["aborted"] = True
                changed |= self._told(before.push_id)
        if msg.phase == PlanProgress.PHASE_PUSHING:
            self._row(msg.push_id)
            changed |= self._told(msg.push_id)
        return changed

    def on_diagnostics(self, statuses: Iterable[DiagnosticStatus]) -> Change:
        """The health of the cell's nodes, and of no others."""
        prefix = f"{self._namespace.rstrip('/')}/"
        return {
            f"node/{status.name.removeprefix(prefix)}": {
                "level": LEVELS.get(status.level, "error"),
                "message": status.message,
                "values": {value.key: value.value for value in status.values},
            }
            for status in statuses
            if status.name.startswith(prefix)
        }

    def on_pusher(self, msg: PusherState) -> Change:
        """Where the pusher is."""
        pusher = {
            "mode": MODE_NAMES.get(msg.mode, str(msg.mode)),
            "position": msg.position,
            "speed": msg.speed,
            "tip": [msg.tip.x, msg.tip.y],
            "direction": [msg.direction.x, msg.direction.y],
            "radius": msg.tip_radius,
            "push": None if msg.push_id == PusherState.NO_PUSH else msg.push_id,
        }
        return {"pusher": pusher}

    def on_pose(self, msg: PoseWithCovarianceStamped) -> Change:
        """Where the object is.

        Raises:
            ValueError: the message holds no pose on the table.
        """
        _, pose = pose_sample_from_msg(msg)
        return {"pose": [pose.x, pose.y, pose.theta]}

    def _without_data(self) -> Change:
        """The change when estimation starts again; pushes that were left out stay left out."""
        gone = [push for push in self._pushes if push not in self._excluded]
        for push in gone:
            del self._pushes[push]
        self._push_of.clear()
        self._after.clear()
        return {"estimate": None, **{f"push/{push}": None for push in gone}}

    def _row_after(self, stamp: int) -> Change:
        """The row of a push, once both one of its data points and the estimate after that have come."""
        push, after = self._push_of.get(stamp), self._after.get(stamp)
        if push is None or after is None:
            return {}
        self._row(push)["after"] = after
        return self._told(push)

    def _row(self, push: int) -> Change:
        return self._pushes.setdefault(push, {"push": push, "contacts": [], "after": None, "excluded": False, "aborted": False})

    def _told(self, push: int) -> Change:
        row = self._pushes[push]
        return {f"push/{push}": row | {"contacts": list(row["contacts"])}}


def _remember(kept: OrderedDict[int, Any], stamp: int, value: Any) -> None:
    kept[stamp] = value
    while len(kept) > REMEMBERED:
        kept.popitem(last=False)
