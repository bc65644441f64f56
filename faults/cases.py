"""The table of faults of a running cell: each says what is done, what must follow, and how that is recognised."""

import contextlib
import itertools
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

MOMENTS = 20
"""Number of moments at which Ctrl-C is tried."""

LONGEST = 20.0
"""Ctrl-C comes within this time after the start [s]."""


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
            self._demand_the_fault(run.output)
            if not run.ended:
                run.process.send_signal(signal.SIGINT)
        code = run.wait_for_end()
        found["seen"] = f"exit code {code} after {time.monotonic() - (begin or 0.0):.0f} s"
        found["message"] = self._message(run.output)
        problems = "; ".join(self._problems(run, code))
        demand(not problems, problems)

    def _demand_the_fault(self, output: str) -> None:
        """On a busy machine, the push of a run that goes on may be stopped for another of the reasons that are allowed."""
        stopped = re.search(rf"push \d+ aborted: .*({self.aborts}).*", output)
        if stopped and not re.search(self.says, output):
            raise EndedEarly(stopped[0])

    def _problems(self, run: CellRun, code: int) -> Iterable[str]:
        if code not in self.codes:
            yield f"exit code {code}, expected one of {', '.join(map(str, self.codes))}"
        if not re.search(self.says, run.output):
            yield f"nothing said matches {self.says!r}"
        allowed = f"{self.aborts}|{TOLD}" if code else self.aborts
        for push, reason in re.findall(r"push (\d+) aborted: (.*)", run.output):
            if not re.search(allowed, reason):
                yield f"push {push} was aborted for another reason: {reason}"
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
        if code == 0:
            if read.returncode:
                yield f"the bag of a run that ended well cannot be read: {read.stderr.strip()}"
            elif (live := re.findall(r"^push +\d+ +(\d+) observations", run.output, re.M)) and int(live[-1]) != (
                found := json.loads(read.stdout)["data_points"]
            ):
                yield f"the live estimate had {live[-1]} observations, the bag {found}, and the run ended with 0"

    def _message(self, output: str) -> str:
        """The line that was to be said, or the last error or warning; why the first push was aborted; the first last error."""
        said = [line for line in output.splitlines() if self.says and re.search(self.says, line)][:1]
        said = said or re.findall(r".*(?:error|WARN|ERROR|warning).*", output)[-1:]
        others = (re.findall(pattern, output, re.M)[:1] for pattern in (r"push \d+ aborted: .*", r"^error: .*"))
        found: list[str] = []
        for line in map(shortened, (*said, *itertools.chain(*others))):
            if line not in " ".join(found):
                found.append(line)
        return " ... ".join(found)


def shortened(line: str) -> str:
    """A line without its stamp and temporary folders, and of at most 200 characters."""
    line = re.sub(r"\[(WARN|ERROR|INFO)\] \[[\d.]+\] ", "", line)
    line = re.sub(r"/\S*pushfric-(faults-)?\w+", "...", line)
    return line if len(line) <= 200 else line[:197] + "..."


Cause = Callable[[CellRun], float]


def nothing(run: CellRun) -> None:
    """The fault is in what was started."""


def in_push(strike: Callable[[CellRun], object]) -> Cause:
    """Start a demo, and strike once its first push is over."""

    def cause(run: CellRun) -> float:
        run.demo()
        run.wait_for_push()
        begin = time.monotonic()
        strike(run)
        return begin

    return cause


def at_once(strike: Callable[[CellRun], object], start: Callable[[CellRun], None] = CellRun.demo) -> Cause:
    """Start a cell, and strike right after the start."""

    def cause(run: CellRun) -> float:
        begin = time.monotonic()
        start(run)
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
        size = len(content[begin : begin + SECTOR])
        file.write_bytes(content[:begin] + bytes(size) + content[begin + size :])
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


def of_nodes(
    fault: str, strike: Callable[[str, CellRun], None], asked: str, codes: tuple[int, ...], says: str = "", again: str = ""
) -> Iterator[Fault[CellRun]]:
    """A fault of each node in turn; `again` must follow, with exit code 0 or 1, for a node that is started again."""
    for node in NODES:
        follows = (again, ANY) if again and node in STARTED_AGAIN else (asked, codes)
        yield Fault(fault.format(node), in_push(partial(strike, node)), Ends(*follows, says.format(node), REASONS[node]))


WHICH = "the run ends and says which node"
ENDED = "it is ended after 10 s, as if it had died"
NODE_CASES = (
    *of_nodes(
        "kill -9 of {}", partial(_signal, signal.SIGKILL), WHICH, (1,), "{} was killed by SIGKILL", f"started again, or {WHICH}"
    ),
    *of_nodes(
        "SIGTERM to {}",
        partial(_signal, signal.SIGTERM),
        "the run has failed and says which node",
        (1,),
        "error: {} (has finished, but the plan has not|ended with exit code [01])",
    ),
    *of_nodes("{} stopped for 5 s", _stall, "nothing is lost, or the run says what and ends with 1; no hang", ANY),
    *of_nodes(
        "{} stopped for good",
        partial(_signal, signal.SIGSTOP),
        ENDED,
        (1,),
        r"{} was stopped \(SIGSTOP\) for 10 s and is ended",
        ENDED,
    ),
)

SEEN = "the push is stopped, with the reason; the run waits for a person"
UNSEEN_AT_ALL = "the object was not seen for"
WAITS = {
    **dict.fromkeys(("unplugged", "frozen"), UNSEEN_AT_ALL),
    "frozen except for one pixel": "the object does not follow the pusher",
    "two images that alternate": "the object does not follow the pusher|the object was not seen",
    "image shifted by 40 px": "the object leaps by 2[0-9] mm|the object was not seen",
    **dict.fromkeys(("black", "white", "object taken away", "two objects", "half an object"), UNSEEN_AT_ALL),
    "torn: the lower half is older": "the object was not seen for|the object does not follow",
    "stamps of a foreign clock": "the clock of the camera is 3600 s ahead of this computer's",
    "clock set back by an hour": "the clock of the camera is 3600 s behind this computer's",
    "clock set forward by an hour": "the clock of the camera is 3600 s ahead of this computer's",
}
GOES_ON = {
    "frames in the wrong order": ("nothing happens, or the run says what and ends with 1", ANY, UNSEEN),
    "every frame twice": ("nothing happens", (0,), "(?!)"),
    "clock set back for a second": ("what was measured meanwhile is not used, and the result says so", ANY, UNSEEN),
}
CAMERA_CASES = [
    *(
        Fault(f"camera: {name}", partial(camera.start, name), Ends(SEEN, (130,), says, f"{UNSEEN}|{says}", interrupt=True))
        for name, says in WAITS.items()
    ),
    *(
        Fault(f"camera: {name}", partial(camera.start, name), Ends(asked, codes, aborts=aborts))
        for name, (asked, codes, aborts) in GOES_ON.items()
    ),
]

SAYS_SO = "the run ends and says so"
REFUSED = Ends("it is refused; the run goes on", (0,))
FILE_CASES = [
    *(
        Fault(
            f"the recorder's disk is full after {more} more bytes",
            in_push(partial(_limit_the_recorder, more)),
            Ends(f"{SAYS_SO}; what was written can be read", (1, 2), "File too large"),
        )
        for more in (0, 1, 100, 5000, 20_000)
    ),
    Fault(
        "every sync of the bag fails (EIO)",
        at_once(nothing, partial(CellRun.demo, through="faults.failing_sync")),
        Ends(
            "the run ends with an error though all pushes were made: nobody knows whether the bag is on the disk",
            (1, 2),
            "cannot write the bag: Input/output error",
        ),
    ),
    Fault(
        "the bag's folder is removed",
        in_push(lambda run: shutil.rmtree(run.bag)),
        Ends(SAYS_SO, (1, 2), "was removed or moved while it was recorded"),
    ),
    Fault(
        "every sector of the bag lost, one after the other",
        in_push(_every_sector),
        Ends("each loss is noticed and counted; 97 % of the messages are saved on average", (0,), "sectors"),
    ),
    Fault("a second recorder into the same folder", in_push(_second_recorder), REFUSED),
    Fault("a second cell of the same name", in_push(_second_cell), REFUSED),
]

POSSIBLE = Ends("as many pushes as can be; each aborted one says what was measured", ANY, "pushes carried out", STARVED)
OWNER_GONE = Ends("the pusher rests, the run ends and says which node", (1,), "the pusher rested within", STARVED)
QUOTAS = [
    Fault("CPU quota of 20 %", at_once(partial(_starve, 20)), Ends("no push is aborted", (0,), "pushes carried out")),
    *(
        Fault(f"CPU quota of {percent} %", at_once(partial(_starve, percent), partial(CellRun.demo, short=True)), POSSIBLE)
        for percent in (10, 5)
    ),
    *(
        Fault(f"CPU quota of {percent} %, kill -9 of experiment", at_once(partial(_kill_the_owner, percent)), must)
        for percent, must in ((20, replace(OWNER_GONE, aborts=REASONS["experiment"])), (10, OWNER_GONE), (5, OWNER_GONE))
    ),
]

INTERRUPTED = Ends("exit code 130, or 0 where the run was over; no process is left, and the bag can be read", (130, 0))
NODES_FOLLOW = "all nodes end, and the bag can be read"
ENDINGS = [
    *(
        Fault(f"Ctrl-C {after:.1f} s after the start", at_once(partial(_interrupt, after)), INTERRUPTED)
        for after in (LONGEST * (number + 0.5) / MOMENTS for number in range(MOMENTS))
    ),
    Fault("the command line is killed", in_push(lambda run: run.process.kill()), Ends(NODES_FOLLOW, (-9,))),
    Fault(
        "the terminal closes (SIGHUP)",
        in_push(lambda run: run.process.send_signal(signal.SIGHUP)),
        Ends(NODES_FOLLOW, (-1, 129)),
    ),
]

CASES = (*NODE_CASES, *CAMERA_CASES, *FILE_CASES, *QUOTAS, *ENDINGS)

QUICK = {
    "kill -9 of recorder",
    "SIGTERM to experiment",
    "camera: frozen except for one pixel",
    "camera: clock set back by an hour",
}
"""A sample, for a minute."""
