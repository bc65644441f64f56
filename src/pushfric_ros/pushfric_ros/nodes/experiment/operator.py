"""The operator of a run: what he is told of what is awaited, and what he decides."""

import enum
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.task import Future
from std_srvs.srv import Trigger

from pushfric_core.estimation.push_plan import number_of
from pushfric_msgs.msg import PlanProgress
from pushfric_ros.nodes.experiment.reports import IN_ALARM, ReportedPusher

ALARM_PATIENCE = 5.0
"""An alarm of the pusher that lasts this long ends a run that nobody attends; while it homes, one may come and go [s of wall
time]."""


class Choice(enum.Enum):
    """A person's decision on a push: the names of the services, and why the push was given up."""

    REPEAT = "a person wants it repeated"
    SKIP = "a person skipped it"
    END = "a person ended the run"


class RunEnded(Exception):
    """A person has ended the run while something was awaited."""


class Operator:
    """Waits for what the plan needs, tells the operator about it, and serves his choices.

    Args:
        node: the experiment's.
        out: of plan_progress.
        progress: the first to tell.
        pusher: told of in the prompts.
        attended: whether there is an operator.
    Attributes:
        progress: the last that was told, and the counts to tell next.
        choice: on the present push; None before he makes it.
    """

    def __init__(self, node: Node, out: Publisher, progress: PlanProgress, pusher: ReportedPusher, attended: bool) -> None:
        self._node, self._out, self._pusher = node, out, pusher
        self._conditions: tuple[Callable[[], Any], ...] = ()  # that are awaited
        self.progress, self.attended = progress, attended
        self.choice: Choice | None = None
        self._asked = False  # a push was aborted, and he chooses what becomes of it
        node.create_service(Trigger, "~/withdraw", self._on_withdraw)
        for choice in Choice:
            node.create_service(Trigger, f"~/{choice.name.lower()}", partial(self._on_choice, choice))

    @property
    def acknowledged(self) -> bool:
        """Whether all listeners have acknowledged what was last said."""
        # a wait would hold up the node's heartbeat, and end as a hang
        return self._out.wait_for_all_acked(Duration(seconds=0))

    def report(self, phase: int, message: str) -> None:
        progress = self.progress
        progress.phase, progress.message, progress.details = phase, message, self._details(phase)
        progress.header.stamp = self._node.get_clock().now().to_msg()
        self._out.publish(progress)
        self._node.get_logger().info(message)

    def until(self, *conditions: Callable[[], Any]) -> Future:
        """The values of the conditions, a future that is done once a look finds one of them true."""
        self._conditions, self._met = conditions, Future()
        return self._met

    def check_conditions(self) -> None:
        if any(values := [condition() for condition in self._conditions]):
            self._conditions = ()
            self._met.set_result(values)

    async def until_well(self, problem: Callable[[], str | None], prompt: str, phase: int = PlanProgress.PHASE_WAITING) -> None:
        """Tell the operator about a problem, whenever it changes, until there is none.

        Raises:
            RunEnded: he ends the run meanwhile.
        """

        def changed() -> bool:
            return problem() != said

        def given_up() -> bool:
            return said == IN_ALARM and not self.attended and time.monotonic() - since > ALARM_PATIENCE

        since = 0.0
        while self.choice is not Choice.END and (said := problem()) is not None:
            self.report(PlanProgress.PHASE_ALARM if said == IN_ALARM else phase, f"{prompt}: {said}" if said else prompt)
            since = time.monotonic()
            await self.until(changed, given_up, lambda: self.choice is Choice.END)
            if self.choice is not Choice.END and given_up() and not changed():
                raise SystemExit(f"{self.progress.message}; nobody is here to do that")
        if self.choice is Choice.END:
            raise RunEnded

    async def until_chosen(self, push: str) -> None:
        """Let a person choose what becomes of an aborted push, once the pusher can move again."""
        self._asked = True
        while self.choice is None:
            await self.until_well(lambda: self._pusher.hindrance() if self.choice is None else None, "waiting for the pusher")
            if self.choice is None:
                self.report(PlanProgress.PHASE_CHOOSING, f"{push}. Repeat it, skip it, or end the run?")
                await self.until(lambda: self.choice is not None, self._pusher.hindrance)  # a stop may be reported late
        self._asked = False

    def _details(self, phase: int) -> str:
        """The services that answer a prompt of this phase, and the pusher's fault."""
        pusher = self._pusher
        services = {
            PlanProgress.PHASE_PLACING: "experiment/skip, experiment/end",
            PlanProgress.PHASE_CHOOSING: "experiment/repeat, experiment/skip, experiment/end",
            PlanProgress.PHASE_ALARM: "actuator/reset",
        }.get(phase, "experiment/withdraw" if pusher.blind else "actuator/reset" if pusher.was_stopped else "")
        fault = pusher.fault and f"fault: {pusher.fault}"
        return "; ".join(filter(None, (services and f"services: {services}", fault)))

    def _on_withdraw(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """A person says that the pusher may be brought back though the object is not seen."""
        response.success, self._pusher.blind = self._pusher.blind, False
        response.message = "bringing the pusher back" if response.success else "the pusher is not waiting to be brought back"
        return response

    def _on_choice(self, choice: Choice, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """A person wants the push repeated or skipped, or the run ended."""
        progress = self.progress
        if choice is Choice.SKIP and self._pusher.blind and not self._asked:
            return self._on_withdraw(_, response)
        push = f"push {number_of(progress.push_id, progress.count)}"
        under_way = progress.phase in (PlanProgress.PHASE_PLACING, PlanProgress.PHASE_PUSHING)
        response.success, response.message = {
            Choice.REPEAT: (self._asked, f"{push} is repeated"),
            Choice.SKIP: (self._asked or under_way, f"{push} is skipped"),
            Choice.END: (progress.phase != PlanProgress.PHASE_FINISHED, "the run ends"),
        }[choice]
        if response.success:
            self.choice = choice
        else:
            response.message = f"no push to {choice.name.lower()}: {progress.message or 'starting'}"
        return response
