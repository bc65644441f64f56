"""Runs a graph and shows the operator the last estimate of every push, and how far the plan has come."""

import contextlib
import math
import os
import pathlib
import select
import sys
import termios
import time
import tty
from collections.abc import Callable, Sequence
from functools import partial

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from pushfric_core.bags.samples import stamp_from_msg
from pushfric_core.commands.console import warn
from pushfric_core.commands.program import end_at_once
from pushfric_core.errors import PushfricError
from pushfric_core.estimation.push_plan import index_of
from pushfric_core.geometry.table_1 import TableObject
from pushfric_core.trajectories.observation import Observation
from pushfric_msgs.msg import FrictionEstimate, PlanProgress
from pushfric_ros.commands.recorded_run import disagreements, pushes_of, result_of, write_result
from pushfric_ros.graph.graph import VIEW, NodeSpec
from pushfric_ros.graph.supervisor import Ended, Supervisor
from pushfric_ros.messages.markers import center_of_friction_from
from pushfric_ros.node_kit.stop_button import press
from pushfric_ros.node_kit.visit import COMMAND_LINE, Visit, enclave
from pushfric_ros.nodes.monitor import MonitorNode

PROGRESS_TIMEOUT = 10.0
"""After the end of a run, its last estimate is awaited; the wait ends if the estimator makes no progress for this long [s]."""

LINGER = 0.2
"""Messages sent just before the end of a run may still be on their way for this long [s]."""

PATIENCE = 15.0
"""Time after which a run without prompts prints what it does or awaits [s]: it may wait for ever."""

PROMPTING = (
    PlanProgress.PHASE_WAITING,
    PlanProgress.PHASE_PLACING,
    PlanProgress.PHASE_ALARM,
    PlanProgress.PHASE_CHOOSING,
)

STOP = " "
KEYS = {"r": "actuator/reset", "p": "experiment/repeat", "s": "experiment/skip", "e": "experiment/end"}
"""The keys of a terminal, and the services that they call; STOP needs none."""

KEYS_OF = {
    PlanProgress.PHASE_WAITING: "[space] stop  [r] reset  [e] end the run",
    PlanProgress.PHASE_PLACING: "[space] stop  [s] skip this push  [e] end the run",
    PlanProgress.PHASE_PUSHING: "[space] stop  [s] skip this push  [e] end the run",
    PlanProgress.PHASE_ALARM: "[r] reset  [e] end the run",
    PlanProgress.PHASE_CHOOSING: "[p] repeat the push  [s] skip it  [e] end the run",
}
"""Actions of the keys in each phase of the plan."""


def watch(
    console: Console,
    specs: Sequence[NodeSpec],
    namespace: str,
    what: str,
    live: bool,
    replayed: Sequence[Observation] | None = None,
    unfinished: Callable[[int], None] | None = None,
    prompts: bool = False,
    recorded: pathlib.Path | None = None,
    stay: Callable[[FrictionEstimate | None], None] | None = None,
    known: TableObject | None = None,
) -> tuple[Ended, FrictionEstimate | None]:
    """Run a graph with a monitor until it has ended and its last estimate has come; afterwards Ctrl-C ends the process.

    Args:
        specs: the nodes.
        namespace: namespace of all nodes.
        what: what is going on, in words.
        live: with a table that is redrawn in place; otherwise a line for each push.
        replayed: the observations in the bag, if one is played.
        unfinished: called with the push of the plan to go on with, if the run ends before the plan does.
        prompts: without the table, print at once what the run waits for, not only once it takes long.
        recorded: folder of the bag that the run records. Its result is written there however the run ends, while only the
            view is left, which shows it. Even a run that ends well has failed if its bag, its live estimate and its plan
            disagree.
        stay: called with the last estimate when the run has ended well; the other nodes then run on until Ctrl-C.
        known: the simulated object.
    """
    steps = None if replayed is None else len({observation.push_id for observation in replayed})

    def say(name: str, line: str) -> None:
        # a node's information is for its log; its warnings, and the line of a failed start, are for the operator
        if "[INFO]" not in line and "[DEBUG]" not in line:
            console.print(f"{name}: {line}", highlight=False, markup=False)

    def watched(supervisor: Supervisor) -> tuple[Ended, "Monitor"]:
        def all_replayed() -> bool:
            return replayed is not None and monitor.complete >= len(replayed)

        # made here, where the supervisor holds signals back, so that no signal interrupts its start or its end
        with contextlib.closing(Monitor(console, namespace, what, steps, live, prompts)) as monitor, Keys() as keys:
            monitor.keys = keys if replayed is None else None
            try:
                ended = monitor.watch(supervisor, monitor.settled if replayed is None else all_replayed)
                if stay is not None and ended.code == 0:
                    stay(monitor.estimate)
                    ended = monitor.stay(supervisor)
                return ended, monitor
            finally:
                if unfinished is not None and (push := monitor.next_push or monitor.ended_at) is not None:
                    unfinished(push)

    try:
        with Supervisor(specs, namespace, say) as supervisor:
            ended, monitor = watched(supervisor)
            supervisor.end(but=VIEW)
            ended = ended if ended.code else supervisor.failed_at_the_end or ended
            if recorded is not None:
                result, doubts = result_of(recorded), [ended.reason]
                if ended.code == 0:
                    doubts = disagreements(result, monitor.estimate, monitor.planned, monitor.aborted)
                    ended = Ended(1, "; ".join(doubts)) if doubts else ended
                try:
                    write_result(recorded, result, doubts, known)
                except PushfricError as error:
                    warn(f"no result: {error}")
        return ended if ended.code else supervisor.failed_at_the_end or ended, monitor.estimate
    finally:
        end_at_once()


class Monitor:
    """Watches friction_estimate and plan_progress while a supervisor runs the graph, and shows them.

    Args:
        namespace: namespace of the cell.
        what: what is going on, for the progress bar.
        steps: number of pushes expected; None: the plan's progress gives it.
        live: show a table that is redrawn in place; otherwise print a line for each push.
        prompts: without the table, print at once what the run waits for, not only once it takes long.
    """

    def __init__(
        self,
        console: Console,
        namespace: str,
        what: str,
        steps: int | None,
        live: bool,
        prompts: bool = False,
    ) -> None:
        self.estimate: FrictionEstimate | None = None
        self.next_push: int | None = None  # number of the current push in the plan; None: no plan is under way
        self.ended_at: int | None = None  # number of the push at which the plan was finished before its end
        self.planned = 0  # number of pushes that the run is to carry out, from the first that it was heard of
        self.aborted = 0  # number of these that did not reach their end
        self._prompts = prompts
        self._unsaid: tuple[float, str] | None = None  # what is to be printed, and when
        self.keys: Keys | None = None  # of the operator's terminal
        self._namespace, self._phase = namespace, -1
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
        self._finished: int | None = None  # when the plan was finished [ns]
        self._plan_leads = steps is None
        make = partial(
            MonitorNode,
            self._on_estimate,
            self._on_progress,
            starts_player=steps is not None,
            services=KEYS.values() if self._plan_leads else (),
            namespace=namespace,
        )
        self._visit = Visit(make, enclave(namespace, COMMAND_LINE))

    def close(self) -> None:
        """Leave the graph."""
        self._visit.close()

    def watch(self, supervisor: Supervisor, done: Callable[[], bool]) -> Ended:
        """Show what happens until the run ends; if it ends well, go on until `done`, but not for ever."""
        ended, lingers, deadline, progress = None, 0.0, 0.0, (-1, -1)
        shown = Live(self._view(), console=self._console, refresh_per_second=8) if self._live else contextlib.nullcontext()
        with shown as view:
            while ended is None or (
                ended.code == 0 and time.monotonic() < deadline and (time.monotonic() < lingers or not done())
            ):
                self._visit.spin_once(0.05)
                self._take_keys()
                self._tell()
                if view is not None:
                    view.update(self._view())
                now = supervisor.poll()  # to the very end, for Ctrl-C, and for an estimator that dies before its last estimate
                if now is not None and (ended is None or now.code):
                    ended, lingers, deadline = now, time.monotonic() + LINGER, time.monotonic() + PROGRESS_TIMEOUT
                seen = (self._visit.node.settled if self._catches_up() else progress[0]), self.complete
                if seen != progress:
                    progress, deadline = seen, time.monotonic() + PROGRESS_TIMEOUT
        if not self._live and self.estimate is not None:
            self._console.print(line_of(self.estimate))
        if ended.code == 0 and self.next_push is not None:
            return Ended(1, f"{ended.reason}, but the plan has not: it stood at push {self.next_push}")
        return ended

    def _catches_up(self) -> bool:
        """Whether the plan is finished but the estimator has not yet processed everything that was seen of it."""
        return self._finished is not None and self._visit.node.settled < self._finished

    def stay(self, supervisor: Supervisor) -> Ended:
        """Go on when the run has ended, until Ctrl-C, or until a node fails."""
        try:
            while (now := supervisor.poll()) is None or now.code == 0:
                self._visit.spin_once(0.05)
        except KeyboardInterrupt:
            return Ended(0, "ended by Ctrl-C")
        return now

    @property
    def complete(self) -> int:
        """Number of observations that the whole estimate rests on; -1 if there is no estimate, or a part rests on fewer."""
        estimate = self.estimate
        if estimate is None:
            return -1
        whole = sum(estimate.contact_friction.histogram) == estimate.spread.data_points == estimate.data_points
        return estimate.data_points if whole else -1

    def settled(self) -> bool:
        """Whether the estimator has processed everything that was seen until the plan was finished."""
        if self._finished is None or self._catches_up() or (self.estimate is not None and self.complete < 0):
            return False
        node = self._visit.node
        # by its stamp alone, an estimate cannot be told from one in which other pushes are left out
        last = (0, 0) if self.estimate is None else (stamp_from_msg(self.estimate.header.stamp), self.estimate.data_points)
        return node.judged and last == (node.newest, node.data_points)

    def _on_estimate(self, msg: FrictionEstimate) -> None:
        if msg.status == FrictionEstimate.STATUS_NO_DATA:
            self.estimate = None  # all that it rested on is left out
            self._rows.clear()
            return
        push = msg.pushes
        # where a push is left out for a while, the number falls and rises again
        if not self._live and self.estimate is not None and push not in self._rows:
            self._console.print(line_of(self.estimate))
        self.estimate = self._rows[push] = msg
        if not self._plan_leads:
            self._progress.update(self._task, completed=push)

    def _on_progress(self, msg: PlanProgress) -> None:
        message, details = _printable(msg.message), _printable(msg.details)
        if message != self._message and not self._live:
            answers = " or ".join(filter(None, (self._hint(msg.phase), details)))
            text = f"{message}  ({answers})" if msg.phase == PlanProgress.PHASE_CHOOSING else message
            at_once = self._prompts and msg.phase in PROMPTING
            self._unsaid = time.monotonic() + PATIENCE * (not at_once), text
            self._tell()
        self._message, self._phase = message, msg.phase
        finished = msg.phase == PlanProgress.PHASE_FINISHED
        self.aborted = msg.aborted
        self.planned = self.planned or pushes_of(msg)
        if finished:
            self._finished = stamp_from_msg(msg.header.stamp)
        index = index_of(msg.push_id, msg.count)
        self.next_push = None if finished else index + 1
        early = finished and msg.completed + msg.aborted + msg.skipped < self.planned
        self.ended_at = index + 1 if early else None
        if self._plan_leads:
            self._progress.update(self._task, total=max(msg.count, 1), completed=msg.count if finished else index)

    def _tell(self) -> None:
        """Print what the run does or awaits, once it is due."""
        if self._unsaid is not None and time.monotonic() >= self._unsaid[0]:
            self._say(self._unsaid[1])
            self._unsaid = None

    def _view(self) -> RenderableType:
        table = Table(box=None, header_style="bold", pad_edge=False)
        for name in ("push", "observations", "p_CF x [mm]", "p_CF y [mm]", "within [mm]", "mu_c", "fit [mm]"):
            table.add_column(escape(name), justify="right")
        for push, msg in self._rows.items():
            table.add_row(str(push), *[cell or "-" for cell in _cells(msg)])
        silent = self._finished is None and self._plan_leads and self._visit.node.silent("experiment")
        hint = self._hint(-1 if silent else self._phase)
        # the commands' console leaves it to the terminal to wrap lines; the redrawn ones would be cut
        message = Text("the experiment does not report" if silent else self._message, no_wrap=False, overflow="fold")
        return Group(table, self._progress, message, *[Text(hint, style="dim")] * bool(hint))

    def _hint(self, phase: int) -> str:
        """The present actions of the keys; empty without a terminal to press them in."""
        return KEYS_OF.get(phase, "") if self.keys is not None and self.keys.work else ""

    def _take_keys(self) -> None:
        """Do what the operator's keys ask for, as far as the phase of the plan gives them a meaning."""
        for key in self.keys.pressed() if self.keys is not None else "":
            if key == STOP:
                self._say(press(self._namespace) or "nobody answers; use the switch at the pusher")
            elif key in KEYS and f"[{key}]" in KEYS_OF.get(self._phase, ""):
                self._visit.node.ask(KEYS[key], self._say)

    def _say(self, answer: str) -> None:
        self._console.print(answer, highlight=False, markup=False)


def line_of(msg: FrictionEstimate) -> str:
    """An estimate as a line of text."""
    points, x, y, within, mu_c, error = _cells(msg)
    noun = "observation " if msg.data_points == 1 else "observations"
    spread, friction = within and f", within {within} mm", mu_c and f"  mu_c {mu_c}"
    return f"push {msg.pushes:3d}  {points} {noun}  p_CF ({x}, {y}) mm{spread}{friction}  fit error {error} mm"


def _cells(msg: FrictionEstimate) -> tuple[str, ...]:
    """The belief, each figure with a probability of 90 %, and the program's fit error; empty where nothing is known yet."""
    (x, y), friction = center_of_friction_from(msg), msg.contact_friction
    # no wider, or a terminal of 80 columns would break the cells
    mu_c = f"over {friction.low:.2f}" if math.isinf(friction.high) else f"{friction.low:.2f}..{friction.high:.2f}"
    return (
        f"{msg.data_points:3d}",
        f"{x * 1e3:z7.2f}",
        f"{y * 1e3:z7.2f}",
        "" if math.isnan(msg.confidence) else f"{msg.confidence * 1e3:.2f}",
        "" if math.isnan(friction.low) else mu_c,
        f"{msg.objective * 1e3:.3f}",
    )


class Keys(contextlib.AbstractContextManager["Keys"]):
    """Reads keys as they are pressed, if the process is in the foreground of a terminal; the terminal then shows none of them.

    Attributes:
        work: whether there is a terminal to press keys in.
    """

    def __init__(self) -> None:
        self.work = sys.stdin is not None and sys.stdin.isatty() and _in_foreground()

    def __enter__(self) -> "Keys":
        if self.work:
            self._before = termios.tcgetattr(sys.stdin)
            tty.setcbreak(sys.stdin)
        return self

    def __exit__(self, *_: object) -> None:
        if self.work and _in_foreground():
            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._before)

    def pressed(self) -> str:
        """The keys pressed since the last call; Ctrl-C is not among them."""
        if not self.work or not _in_foreground():
            return ""
        with contextlib.suppress(termios.error):  # the terminal has gone
            if termios.tcgetattr(sys.stdin)[3] & termios.ICANON:  # a shell that stopped the process has set it back
                tty.setcbreak(sys.stdin, termios.TCSANOW)
        if not select.select([sys.stdin], [], [], 0)[0]:
            return ""
        keys = os.read(sys.stdin.fileno(), 64).decode(errors="replace")
        self.work = bool(keys)
        return keys


def _in_foreground() -> bool:
    try:
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except OSError:  # this terminal does not control the process, and so has no background
        return True


def _printable(text: str) -> str:
    """A text of a topic, to which any program may publish, with nothing in it that steers a terminal."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)
