"""The table of faults of a running cell: each says what is done, what must follow, and how that is recognised."""

import contextlib
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from faults import camera
from faults.camera import NAMESPACE
from faults.cell_run import CellRun
from faults.quota import cpu_quota
from pushfric_core.bags.bag import Bag
from pushfric_core.bags.recovery import recover
from pushfric_ros.faults.fault import EndedEarly, Fault, demand
from pushfric_ros.faults.processes import NODES, PROGRAM, pid_of

NODES_END = 60.0
"""The nodes of a command line that was killed end within this time [s]."""

TOLD = "the actuator was told to end"
"""Why the push of a run that ends otherwise is aborted."""

SECTOR = 4096
"""Size of the piece that a disk loses at once [bytes]."""

LEAST_SAVED = 0.97
"""Least share of the messages that `bag recover` must save, on average."""

MOMENTS = [number + 0.5 for number in range(20)]
"""When Ctrl-C comes after the start [s]."""

FAILING = "faults.failing_sync"


@dataclass(frozen=True)
class Ends:
    """How a run must end, and what it must say and leave behind.

    Attributes:
        asked: this in words.
        codes: the exit codes with which the run may end; 130 if it is interrupted.
        says: a regular expression that must match in the run's output.
        aborts: a regular expression; a push that was aborted for another reason is a problem. A run that fails ends its push.
        interrupt: the run waits for a person; once it has said why, Ctrl-C ends it.
    """

    asked: str
    codes: tuple[int, ...]
    says: str = ""
    aborts: str = "(?!)"
    interrupt: bool = False

    def __call__(self, run: CellRun, begin: float | None, found: dict[str, Any]) -> None:
        """Wait until a run ends, and judge it. `found` gets its exit code and time, and the line that says what happened."""
        if self.interrupt:
            run.wait_for_output(rf"{self.says}|push \d+ aborted")
            # on a busy machine, the push of a run that goes on may be stopped for another of the reasons that are allowed
            others = [line for line in aborted(run.output) if re.search(self.aborts, line)]
            if others and not re.search(self.says, run.output):
                raise EndedEarly(others[0])
            if not run.ended:
                run.process.send_signal(signal.SIGINT)
        code = run.wait_for_end()
        found["seen"] = f"exit code {code} after {time.monotonic() - (begin or 0.0):.0f} s"
        found["message"] = self._message(run.output)
        problems = "; ".join(self._problems(run, code))
        demand(not problems, problems)

    def _problems(self, run: CellRun, code: int) -> Iterable[str]:
        if code not in self.codes:
            yield f"exit code {code}, expected one of {', '.join(map(str, self.codes))}"
        if not re.search(self.says, run.output):
            yield f"nothing said matches {self.says!r}"
        allowed = f"{self.aborts}|{TOLD}" if code else self.aborts
        yield from (f"for another reason, {line}" for line in aborted(run.output) if not re.search(allowed, line))
        if "Traceback" in run.output:
            yield "a traceback"
        deadline = time.monotonic() + NODES_END
        while (alive := run.nodes_alive()) and time.monotonic() < deadline:
            time.sleep(0.1)
        if alive:
            yield f"left running: {', '.join(alive.values())}"
        if code == 1 and "error: " not in run.output:
            yield "exit code 1 without a line that says why"
        if not any(run.bag.glob("*.mcap")):
            return
        read = subprocess.run([*PROGRAM, "estimate", str(run.bag), "--json"], capture_output=True, text=True)
        if "Traceback" in read.stderr:
            yield "the bag gives a traceback"
        if code == 0 and read.returncode:
            yield f"the bag of a run that ended well cannot be read: {read.stderr.strip()}"
        elif code == 0 and (live := re.findall(r"^push +\d+ +(\d+) observations", run.output, re.M)):
            count = json.loads(read.stdout)["data_points"]
            if int(live[-1]) != count:
                yield f"the live estimate had {live[-1]} observations, the bag {count}, and the run ended with 0"

    def _message(self, output: str) -> str:
        """The line that was to be said, or the last error or warning; why the first push was aborted; the first last error."""
        said = [line for line in output.splitlines() if self.says and re.search(self.says, line)][:1]
        said = said or re.findall(r".*(?:error|WARN|ERROR|warning).*", output)[-1:]
        lines = *said, *aborted(output)[:1], *re.findall(r"^error: .*", output, re.M)[:1]
        return " ... ".join(dict.fromkeys(map(shortened, lines)))


def aborted(output: str) -> list[str]:
    """Which pushes were aborted, and why."""
    return re.findall(r"push \d+ aborted: .*", output)


def shortened(line: str) -> str:
    """A line without its stamp and temporary folders, and of at most 200 characters."""
    line = re.sub(r"\[(WARN|ERROR|INFO)\] \[[\d.]+\] ", "", line)
    line = re.sub(r"/\S*pushfric-(faults-)?\w+", "...", line)
    return line if len(line) <= 200 else line[:197] + "..."


Step = Callable[[CellRun], object]


def caused(strike: Step, in_push: bool = True, start: Step = CellRun.demo) -> Callable[[CellRun], float]:
    """Start a cell, and strike once its first push is over, or at once."""

    def cause(run: CellRun) -> float:
        begin = time.monotonic()
        start(run)
        if in_push:
            run.wait_for_push()
            begin = time.monotonic()
        strike(run)
        return begin

    return cause


def _signal(number: signal.Signals, node: str, run: CellRun) -> None:
    os.kill(pid_of(node, run.folder), number)


def _stall(node: str, run: CellRun) -> None:
    pid = pid_of(node, run.folder)
    os.kill(pid, signal.SIGSTOP)
    time.sleep(5.0)
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGCONT)


def _limit_the_recorder(more: int, run: CellRun) -> None:
    """Let the recorder's files grow by this many more bytes; the next write fails, as on a full disk."""
    limit = sum(file.stat().st_size for file in run.bag.glob("*.mcap")) + more
    resource.prlimit(pid_of("recorder", run.folder), resource.RLIMIT_FSIZE, (limit, limit))


def _second_recorder(run: CellRun) -> None:
    """A second recorder must refuse the folder, and the run must not notice."""
    topic = "/cell/observation pushfric_msgs/msg/Observation reliable"
    program = "import sys; sys.argv[0] = 'recorder_node'; from pushfric_ros.node_kit.executable import main; main()"
    parameters = ["--ros-args", "-p", f"bag:={run.bag}", "-p", f"topics:=['{topic}']"]
    _refused([sys.executable, "-c", program, *parameters], "already holds files")


def _second_cell(run: CellRun) -> None:
    _refused([*PROGRAM, "demo", "--headless", "--bag", str(run.folder / "second")], "is already running")


def _refused(command: list[str], says: str) -> None:
    second = subprocess.run(command, capture_output=True, text=True, timeout=300)
    demand(second.returncode == 2 and says in second.stderr, str(second))


def _every_sector(run: CellRun) -> None:
    """Zero one sector after the other of the run's bag: each loss must be noticed, and nearly all messages saved."""
    run.wait_for_end()
    (file,) = run.bag.glob("*.mcap")
    content, whole, saved = file.read_bytes(), Bag(run.bag).summary.message_count, []
    for begin in range(0, len(content), SECTOR):
        file.write_bytes(content[:begin] + bytes(len(content[begin : begin + SECTOR])) + content[begin + SECTOR :])
        bag = Bag(run.bag)
        demand(bag.damage is not None, f"the loss of the sector at byte {begin} is not noticed")
        read = sum(1 for _ in bag.messages())
        missing = sum(bag.damage.missing.values())
        demand(read + missing == whole, f"of {whole} messages, {read} are read and {missing} missing")
        recover(run.bag, run.folder / f"saved {begin}")
        left = Bag(run.folder / f"saved {begin}")
        demand(left.damage is None, f"what was saved without the sector at byte {begin} is damaged")
        saved.append(left.summary.message_count / whole)
    file.write_bytes(content)
    share = sum(saved) / len(saved)
    demand(share >= LEAST_SAVED, f"{100 * share:.1f} % of the messages were saved")
    run.note(f"{len(saved)} sectors, {100 * share:.1f} % of the messages saved on average, {100 * min(saved):.1f} % at worst")


def _starve(percent: float, run: CellRun) -> None:
    """Leave the run this share of a processor until its end; note how many pushes were carried out."""
    with cpu_quota(percent, run.process.pid):
        run.wait_for_end()
    bag = Bag(run.bag)
    last = bag.deserialize(list(bag.messages([f"{NAMESPACE}/plan_progress"]))[-1])
    run.note(f"{last.completed} of {last.count} pushes carried out")


def _kill_the_owner(percent: float, run: CellRun) -> None:
    """Leave the run this share of a processor, and kill who owns the second push; note when the pusher rested.

    The actuator waits for that before it ends.
    """
    with cpu_quota(percent, run.process.pid):
        run.wait_for_push()
        begin = time.monotonic()
        _signal(signal.SIGKILL, "experiment", run)
        run.wait_for(lambda: "actuator" not in run.nodes_alive().values(), "the end of the actuator")
        run.note(f"the pusher rested within {time.monotonic() - begin:.1f} s, when the actuator ended")
        run.wait_for_end()


def _interrupt(after: float, run: CellRun) -> None:
    time.sleep(after)
    run.process.send_signal(signal.SIGINT)


SILENT = "(shows no sign of life: its last heartbeat|published no heartbeat)"
UNSEEN = "the object was not seen for|the object does not follow|the object leaps by"
REASONS = {
    "tracker": f"tracker {SILENT}|{UNSEEN}",
    "estimator": f"estimator {SILENT}",
    "experiment": f"its client {SILENT}",
    "actuator": f"the pusher (does not answer|forgot it)|stood still for|{SILENT}.*the actuator itself stood still",
    "simulated_cell": f"the controller at|no report of|no answer to|lost .*pusher|{UNSEEN}",
    "recorder": "(?!)",
}
"""By the node that is struck: why a push may be aborted."""

STARVED = (
    f"{SILENT}|{UNSEEN}|stood still for|no report of|no answer to|is not done after|the pusher (does not answer|forgot it)"
)

ANY = (0, 1)
STARTED_AGAIN = ("tracker", "estimator")


Case = Fault[CellRun]


def each(name: str, values: Iterable[Any], strike: Callable[[Any, CellRun], object], must: Ends, **when: Any) -> Iterator[Case]:
    """A fault with each of some values."""
    return (Fault(name.format(value), caused(partial(strike, value), **when), must) for value in values)


def of_nodes(name: str, strike: Callable[[str, CellRun], object], must: Ends, again: str = "") -> Iterator[Case]:
    """A fault of each node; `again` must follow, with exit code 0 or 1, for a node that is started again."""
    for node in NODES:
        one = replace(must, says=must.says.format(node), aborts=REASONS[node])
        if again and node in STARTED_AGAIN:
            one = replace(one, asked=again, codes=ANY)
        yield from each(name, [node], strike, one)


WHICH = "the run ends and says which node"
ENDED = "it is ended after 10 s, as if it had died"
KILLED = Ends(WHICH, (1,), "{} was killed by SIGKILL")
FAILED = Ends(
    "the run has failed and says which node", (1,), "error: {} (has finished, but the plan has not|ended with exit code [01])"
)
STOPPED = Ends(ENDED, (1,), r"{} was stopped \(SIGSTOP\) for 10 s and is ended")
NODE_CASES = (
    *of_nodes("kill -9 of {}", partial(_signal, signal.SIGKILL), KILLED, f"started again, or {WHICH}"),
    *of_nodes("SIGTERM to {}", partial(_signal, signal.SIGTERM), FAILED),
    *of_nodes("{} stopped for 5 s", _stall, Ends("nothing is lost, or the run says what and ends with 1; no hang", ANY)),
    *of_nodes("{} stopped for good", partial(_signal, signal.SIGSTOP), STOPPED, ENDED),
)

WAITS = Ends("the push is stopped, with the reason; the run waits for a person", (130,), interrupt=True)
GOES_ON = {
    "frames in the wrong order": Ends("nothing happens, or the run says what and ends with 1", ANY, aborts=UNSEEN),
    "every frame twice": Ends("nothing happens", (0,)),
    "clock set back for a second": Ends("what was measured meanwhile is not used, and the result says so", ANY, aborts=UNSEEN),
}
CAMERA_ENDS = {
    name: GOES_ON.get(name) or replace(WAITS, says=says, aborts=f"{UNSEEN}|{says}") for name, (_, says) in camera.FAULTS.items()
}
CAMERA_CASES = [Fault(f"camera: {name}", partial(camera.start, name), must) for name, must in CAMERA_ENDS.items()]

SAYS_SO = "the run ends and says so"
FULL = Ends(f"{SAYS_SO}; what was written can be read", (1, 2), "File too large")
REMOVED = Ends(SAYS_SO, (1, 2), "was removed or moved while it was recorded")
NOT_SYNCED = Ends(
    "the run ends with an error though all pushes were made: nobody knows whether the bag is on the disk",
    (1, 2),
    "cannot write the bag: Input/output error",
)
NOTICED = Ends("each loss is noticed and counted; 97 % of the messages are saved on average", (0,), "sectors")
REFUSED = Ends("it is refused; the run goes on", (0,))
FILE_CASES = [
    *each("the recorder's disk is full after {} more bytes", (0, 1, 100, 5000, 20_000), _limit_the_recorder, FULL),
    Fault(
        "every sync of the bag fails (EIO)", caused(lambda run: None, False, partial(CellRun.demo, through=FAILING)), NOT_SYNCED
    ),
    Fault("the bag's folder is removed", caused(lambda run: shutil.rmtree(run.bag)), REMOVED),
    Fault("every sector of the bag lost, one after the other", caused(_every_sector), NOTICED),
    Fault("a second recorder into the same folder", caused(_second_recorder), REFUSED),
    Fault("a second cell of the same name", caused(_second_cell), REFUSED),
]

ALL = Ends("no push is aborted", (0,), "pushes carried out")
POSSIBLE = Ends("as many pushes as can be; each aborted one says what was measured", ANY, "pushes carried out", STARVED)
OWNER_GONE = Ends("the pusher rests, the run ends and says which node", (1,), "the pusher rested within", STARVED)
TOLD_WHY = replace(OWNER_GONE, aborts=REASONS["experiment"])
QUOTA = "CPU quota of {} %"
QUOTAS = [
    *each(QUOTA, [20], _starve, ALL, in_push=False),
    *each(QUOTA, [10, 5], _starve, POSSIBLE, in_push=False, start=partial(CellRun.demo, short=True)),
    *each(f"{QUOTA}, kill -9 of experiment", [20], _kill_the_owner, TOLD_WHY, in_push=False),
    *each(f"{QUOTA}, kill -9 of experiment", [10, 5], _kill_the_owner, OWNER_GONE, in_push=False),
]

INTERRUPTED = Ends("exit code 130, or 0 where the run was over; no process is left, and the bag can be read", (130, 0))
FOLLOW = Ends("all nodes end, and the bag can be read", (-9,))
FOLLOW_TOO = replace(FOLLOW, codes=(-1, 129))
ENDINGS = [
    *each("Ctrl-C {:.1f} s after the start", MOMENTS, _interrupt, INTERRUPTED, in_push=False),
    Fault("the command line is killed", caused(lambda run: run.process.kill()), FOLLOW),
    Fault("the terminal closes (SIGHUP)", caused(lambda run: run.process.send_signal(signal.SIGHUP)), FOLLOW_TOO),
]

CASES = (*NODE_CASES, *CAMERA_CASES, *FILE_CASES, *QUOTAS, *ENDINGS)

QUICK = {
    "kill -9 of recorder",
    "SIGTERM to tracker",
    "camera: frozen except for one pixel",
    "camera: clock set back by an hour",
}
"""A sample, for a minute."""
