"""The needs of a push: signs of life of its client and of the required nodes, `enable`, a measured force, and time."""

import math
from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from std_msgs.msg import Bool

from pushfric_core.pushers.clock import clock
from pushfric_core.pushers.pusher import PusherConfig, PusherFault
from pushfric_core.pushers.states import Needs
from pushfric_ros.node_kit.diagnostics import Diagnostics
from pushfric_ros.node_kit.heartbeat import Listener
from pushfric_ros.node_kit.losses import waited
from pushfric_ros.node_kit.qos import RELIABLE, SENSOR_DATA
from pushfric_ros.nodes.actuator.reports import UnderWay

FORCE_SILENCE = 0.5  # [s]
DISK = 3.0  # a push waits this long for the disk [s]


class PushNeeds:
    """Hears what a push needs, and says what of it is missing.

    Args:
        node: the actuator.
        config: what a push needs.
        topics: of the node.
        on_force: called when a measured force is too great, with the reason.
    Attributes:
        gap: the node stood still for this long before it last looked [s].
        met: whether the push had all that it needs, when last asked.
    """

    def __init__(self, node: Node, config: PusherConfig, topics: Diagnostics, on_force: Callable[[str], None]) -> None:
        self._config, self._on_force = config, on_force
        self._enabled = self._forced = -math.inf  # when enable was last true, and a force measured; in wall time [s]
        self.gap, self._looked = 0.0, clock()
        self.met = Needs.MISSING
        self._life = Listener(node)
        if config.enable_timeout:
            node.create_subscription(Bool, "enable", self._on_enable, RELIABLE)
        if config.max_force:
            topics.subscribe(WrenchStamped, "wrench", self._on_wrench, SENSOR_DATA)

    def note_turn(self) -> None:
        """Note that the node runs."""
        before, self._looked = self._looked, clock()
        self.gap = self._looked - before

    @property
    def disabled(self) -> str | None:
        """Why nothing may move, as far as the topic enable says; None if it may."""
        ago, limit = clock() - self._enabled, self._config.enable_timeout
        if not limit or ago <= limit:
            return None
        if math.isinf(ago):
            return "the topic enable does not say true"
        return f"the topic enable said true {ago:.2f} s ago; enable_timeout is {limit:g} s"

    def missing(self, push: UnderWay, waits: bool, kept: bool) -> tuple[PusherFault, str] | None:
        """The first thing that a push needs, does not have, and is not to wait for; None if it has all.

        Args:
            push: the push.
            waits: it has not begun to move.
            kept: the disk has it that the pusher moves.
        """
        missing = self._first_missing(push, waits, kept)
        self.met = Needs.MET if missing is None else missing[0]
        if (disabled := self.disabled) is not None:
            return PusherFault.DISABLED, disabled
        return missing[1:] if missing is not None and self.met is Needs.MISSING else None

    def _first_missing(self, push: UnderWay, waits: bool, kept: bool) -> tuple[Needs, PusherFault, str] | None:
        config, now = self._config, clock()
        lasted = now - push.accepted
        if lasted > config.max_time:
            why = f"the push took {lasted:.1f} s, more than max_time {config.max_time:g} s"
            return Needs.MISSING, PusherFault.TIME, why
        if waits and not kept:
            why = f"the disk took {lasted:.1f} s to keep that the pusher moves"
            return Needs.AWAITED if lasted < DISK else Needs.MISSING, PusherFault.TIME, why
        if config.max_force and (unmeasured := now - self._forced) > FORCE_SILENCE:
            how_long = "yet" if math.isinf(unmeasured) else f"for {unmeasured:.2f} s, the limit is {FORCE_SILENCE:g} s"
            return Needs.MISSING, PusherFault.FORCE, f"no force was measured {how_long}"
        if (lifeless := self._lifeless(bytes(push.goal.goal_id.uuid), lasted)) is not None:
            return Needs.AWAITED if waits and lasted < config.grace else Needs.MISSING, *lifeless
        return None

    def _lifeless(self, goal: bytes, lasted: float) -> tuple[PusherFault, str] | None:
        """Who shows no sign of life, of those that a goal needs: the fault, and what was measured; None if all of them live."""
        config = self._config
        self._life.receive()
        needed = [(PusherFault.OWNER, "its client", self._life.owner(goal), "owner_timeout")] if config.owner_timeout else []
        needed += [(PusherFault.NODES, name, self._life.node(name), "requires_timeout") for name in config.requires]
        for fault, who, sign, setting in needed:
            limit: float = getattr(config, setting)
            if sign is None:
                how = "; docs/graph.md says how, or set owner_timeout to 0" if fault is PusherFault.OWNER else ""
                return fault, f"{who} published no heartbeat in {lasted:.2f} s, expected one within {config.grace:g} s{how}"
            # the client must be able to cancel; a node that is only needed may have much to do
            if (sign.idle if fault is PusherFault.OWNER else sign.age) > limit:
                own = f"; the actuator itself stood still for {self.gap:.2f} s" if self.gap > limit / 2 else ""
                return fault, f"{who} shows no sign of life: its {sign}; {setting} is {limit:g} s{own}"
        return None

    def _on_enable(self, msg: Bool, info: dict[str, Any]) -> None:
        self._enabled = clock() - waited(info) if msg.data else -math.inf

    def _on_wrench(self, msg: WrenchStamped) -> None:
        force = math.hypot(msg.wrench.force.x, msg.wrench.force.y, msg.wrench.force.z)
        if math.isfinite(force):
            self._forced = clock()
        if force > self._config.max_force:
            self._on_force(f"the force was {force:.1f} N, more than max_force {self._config.max_force:g} N")
