"""The present state, for the page of a run: the nodes' health, where the pusher is, and where the object is."""

from collections.abc import Iterable

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped

from pushfric_core.bags.samples import pose_sample_from_msg
from pushfric_core.report.story import Change
from pushfric_msgs.msg import PusherState
from pushfric_ros.messages.conversions import MODE_NAMES

LEVELS = {
    DiagnosticStatus.OK: "ok",
    DiagnosticStatus.WARN: "warning",
    DiagnosticStatus.ERROR: "error",
    DiagnosticStatus.STALE: "stale",
}


def nodes(statuses: Iterable[DiagnosticStatus], namespace: str) -> Change:
    """The health of a cell's nodes, and of no others."""
    prefix = f"{namespace.rstrip('/')}/"
    return {
        f"node/{status.name.removeprefix(prefix)}": {
            "level": LEVELS.get(status.level, "error"),
            "message": status.message,
            "values": {value.key: value.value for value in status.values},
        }
        for status in statuses
        if status.name.startswith(prefix)
    }


def pusher(msg: PusherState) -> Change:
    """Where the pusher is."""
    return {
        "pusher": {
            "mode": MODE_NAMES.get(msg.mode, str(msg.mode)),
            "position": msg.position,
            "speed": msg.speed,
            "tip": [msg.tip.x, msg.tip.y],
            "direction": [msg.direction.x, msg.direction.y],
            "radius": msg.tip_radius,
            "in_doubt": msg.in_doubt,
            "age": msg.age,
            "push": None if msg.push_id == PusherState.NO_PUSH else msg.push_id,
        }
    }


def pose(msg: PoseWithCovarianceStamped) -> Change:
    """Where the object is.

    Raises:
        ValueError: the message holds no pose on the table.
    """
    return {"pose": list(pose_sample_from_msg(msg).pose)}
