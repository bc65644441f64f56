"""The operator's view of a running graph: a node of the command line that keeps the last estimate of every push."""

import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from std_srvs.srv import SetBool

from pushfric_msgs.msg import EstimatorProgress, FrictionEstimate, PlanProgress
from pushfric_ros.graph.supervisor import Ended, Supervisor
from pushfric_ros.messages.conversions import stamp_from_msg
from pushfric_ros.node_kit.qos import LATCHED

PATIENCE = 10.0
"""How long, after the end of a run, its last estimate is waited for [s]."""


class Monitor:
    """Watches friction_estimate and plan_progress while a supervisor runs the graph, and shows them.

    Args:
        namespace: of the cell.
        what: is going on, for the progress bar.
        steps: pushes awaited; None where the plan's progress tells.
        live: a table that is drawn anew in place; otherwise a line for each push.
        prompts: without the table, tell the operator what is awaited; with it, he sees it anyway.
    """

    def __init__(
        self, console: Console, namespace: str, what: str, steps: int | None, live: bool, prompts: bool = False
    ) -> None:
        self.estimate: FrictionEstimate | None = None
        self.next_push: int | None = None  # number in the plan of the push at hand; None: no plan is under way
        self._prompts = prompts and not live
        self._console, self._live = console, live
        self._rows: dict[int, FrictionEstimate] = {}
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.completed:.0f}/{task.total:.0f}"),
            TimeElapsedColumn(),
            console=console,
        )
        self._task = self._progress.add_task(what, total=steps or 1)
        self._message = ""
        self._finished: int | None = None  # when the plan was [ns]
        self._settled = self._newest = -1  # what the estimator has dealt with, and its newest data point [ns]
        self._plan_leads = steps is None
        self._context = rclpy.Context()
        rclpy.init(context=self._context, args=[])
        self._node = Node("monitor", namespace=namespace, context=self._context)
        self._estimates = self._node.create_subscription(FrictionEstimate, "friction_estimate", self._on_estimate, LATCHED)
        self._node.create_subscription(PlanProgress, "plan_progress", self._on_progress, LATCHED)
        self._node.create_subscription(EstimatorProgress, "estimator_progress", self._on_estimator_progress, LATCHED)
        # a player waits: before the two have found each other, which may take seconds, estimates would go unseen
        self._pause = None if steps is None else self._node.create_client(SetBool, "player/pause")
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def watch(self, supervisor: Supervisor, done: Callable[[], bool]) -> Ended:
        """Show what happens until the run ends; if it ends well, wait on until `done`, but not for ever."""
        ended = None
        deadline = 0.0
        with Live(self._view(), console=self._console, refresh_per_second=8) if self._live else _Quiet() as view:
            while ended is None or (ended.code == 0 and not done() and time.monotonic() < deadline):
                self._executor.spin_once(timeout_sec=0.05)
                if self._pause is not None and self._estimates.get_publisher_count() and self._pause.service_is_ready():
                    self._pause.call_async(SetBool.Request(data=False))
                    self._pause = None
                view.update(self._view())
                now = supervisor.poll()  # to the very end: Ctrl-C, and an estimator that dies before its last word
                if now is not None and (ended is None or now.code):
                    ended, deadline = now, time.monotonic() + PATIENCE
        if not self._live and self.estimate is not None:
            self._console.print(line_of(self.estimate))
        return ended

    def settled(self) -> bool:
        """Whether the estimator has dealt with all that was seen until the plan was finished."""
        if self._finished is None or self._settled < self._finished:
            return False
        return self._newest in (0, None if self.estimate is None else stamp_from_msg(self.estimate.header.stamp))

    def _on_estimate(self, msg: FrictionEstimate) -> None:
        if msg.status == FrictionEstimate.STATUS_NO_DATA:
            return
        push = msg.pushes
        if not self._live and self.estimate is not None and push != self.estimate.pushes:
            self._console.print(line_of(self.estimate))
        self.estimate = self._rows[push] = msg
        if not self._plan_leads:
            self._progress.update(self._task, completed=push)

    def _on_progress(self, msg: PlanProgress) -> None:
        if self._prompts and msg.message != self._message and msg.phase in (msg.PHASE_WAITING, msg.PHASE_PLACING):
            self._console.print(msg.message, highlight=False, markup=False)
        self._message = msg.message
        finished = msg.phase == PlanProgress.PHASE_FINISHED
        if finished:
            self._finished = stamp_from_msg(msg.header.stamp)
        self.next_push = None if finished else msg.push_id + 1
        if self._plan_leads:
            self._progress.update(self._task, total=max(msg.count, 1), completed=msg.count if finished else msg.push_id)

    def _on_estimator_progress(self, msg: EstimatorProgress) -> None:
        self._settled, self._newest = stamp_from_msg(msg.settled_until), stamp_from_msg(msg.header.stamp)

    def _view(self) -> RenderableType:
        table = Table(box=None, header_style="bold", pad_edge=False)
        for name in ("push", "data points", "p_CF x [mm]", "p_CF y [mm]", "mu_c 90 %", "mu_c 100 %", "fit error [mm]"):
            table.add_column(escape(name), justify="right")
        for push, msg in self._rows.items():
            table.add_row(str(push), *_cells(msg))
        return Group(table, self._progress, self._message)


def line_of(msg: FrictionEstimate) -> str:
    """An estimate as a line of text."""
    points, x, y, p90, largest, error = _cells(msg)
    return f"push {msg.pushes:3d}  {points} data points  p_CF ({x}, {y}) mm  mu_c {p90} / {largest}  fit error {error} mm"


def _cells(msg: FrictionEstimate) -> tuple[str, ...]:
    center, friction = msg.center_of_friction, msg.contact_friction
    return (
        f"{msg.data_points:3d}",
        f"{center.x * 1e3:7.2f}",
        f"{center.y * 1e3:7.2f}",
        f"{friction.p90:.2f}",
        f"{friction.max:.2f}",
        f"{msg.objective * 1e3:.3f}",
    )


class _Quiet:
    """Takes the place of the live display where there is none."""

    def __enter__(self) -> "_Quiet":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def update(self, _: Any) -> None:
        pass
