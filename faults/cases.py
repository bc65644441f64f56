"""The table of faults: each case says what is done, what must follow, and how that is recognised."""

import contextlib
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from faults.camera import FAULTS, NAMESPACE
from faults.cell_run import CellRun
from faults.quota import cpu_quota
from pushfric_core.bags.bag import Bag
from pushfric_core.commands.bag import recover

NODES = ("tracker", "estimator", "recorder", "actuator", "experiment", "simulated_cell")

SECTOR = 4096
"""Size of the piece that a disk loses at once [bytes]."""

LEAST_SAVED = 0.97
"""Least share of the messages that `bag recover` must save, on average."""

MOMENTS = 20
"""Number of moments at which Ctrl-C is tried."""

LONGEST = 20.0
"""Ctrl-C comes within this time after the start [s]."""


@dataclass(frozen=True)
class Case:
    """One fault.

    Attributes:
        fault: what is done.
        asked: what must follow.
        strike: does it to a run whose first push is over, or which has just begun if `at_once`.
        codes: the exit codes with which the run may end; 130 if it is interrupted.
        says: a regular expression that must match in the run's output.
        aborts: a regular expression; a push that was aborted for another reason is a problem. A run that fails ends its push.
        camera: the fault of the camera, one of `camera.FAULTS`, instead of a strike.
        interrupt: the run waits for a person; once it has said why, Ctrl-C ends it.
        through: a module of this folder that runs the demo, as `python -m faults.NAME DEMO...`.
        at_once: strike right after the start.
        short: the plan has four pushes only, because the run takes long.
        quick: part of the quick campaign.
    """

    fault: str
    asked: str
    codes: tuple[int, ...]
    says: str = ""
    strike: Callable[[CellRun], None] = lambda run: None
    camera: str = ""
    interrupt: bool = False
    through: str = ""
    at_once: bool = False
    short: bool = False
    quick: bool = False
    aborts: str = "(?!)"


def _signal(node: str, number: signal.Signals, run: CellRun) -> None:
    run.signal(node, number)


def _stall(node: str, run: CellRun) -> None:
    pid = run.pid_of(node)
    os.kill(pid, signal.SIGSTOP)
    time.sleep(5.0)
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGCONT)


def _limit_the_recorder(more: int, run: CellRun) -> None:
    """Let the recorder's files grow by this many more bytes; the next write fails, as on a full disk."""
    limit = sum(file.stat().st_size for file in run.bag.glob("*.mcap")) + more
    resource.prlimit(run.pid_of("recorder"), resource.RLIMIT_FSIZE, (limit, limit))


def _second_recorder(run: CellRun) -> None:
    """A second recorder must refuse the folder, and the run must not notice."""
    topic = "/cell/observation pushfric_msgs/msg/Observation reliable"
    program = "import sys; sys.argv[0] = 'recorder_node'; from pushfric_ros.node_kit.executable import main; main()"
    parameters = ["--ros-args", "-p", f"bag:={run.bag}", "-p", f"topics:=['{topic}']"]
    _refused([sys.executable, "-c", program, *parameters], "already holds files")


def _second_cell(run: CellRun) -> None:
    _refused(
        [sys.executable, "-m", "pushfric_core", "demo", "--headless", "--bag", str(run.folder / "second")], "is already running"
    )


def _refused(command: list[str], says: str) -> None:
    second = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert second.returncode == 2, second
    assert says in second.stderr, second


def _every_sector(run: CellRun) -> None:
    """Zero one sector after the other of the run's bag: each loss must be noticed, and nearly all messages saved."""
    run.wait_for_end()
    (file,) = run.bag.glob("*.mcap")
    content, whole, saved = file.read_bytes(), Bag(run.bag).summary.message_count, []
    for begin in range(0, len(content), SECTOR):
        size = len(content[begin : begin + SECTOR])
        file.write_bytes(content[:begin] + bytes(size) + content[begin + size :])
        bag = Bag(run.bag)
        assert bag.damage is not None, f"the loss of the sector at byte {begin} is not noticed"
        read = sum(1 for _ in bag.messages())
        missing = sum(bag.damage.missing.values())
        assert read + missing == whole, f"of {whole} messages, {read} are read and {missing} missing"
        recover(run.bag, run.folder / f"saved {begin}")
        left = Bag(run.folder / f"saved {begin}")
        assert left.damage is None, f"what was saved without the sector at byte {begin} is damaged"
        saved.append(left.summary.message_count / whole)
    file.write_bytes(content)
    share = sum(saved) / len(saved)
    assert share >= LEAST_SAVED, f"{100 * share:.1f} % of the messages were saved"
    run.note(f"{len(saved)} sectors, {100 * share:.1f} % of the messages saved on average, {100 * min(saved):.1f} % at worst")


def _starve(percent: float, run: CellRun) -> None:
    """Leave the run this share of a processor until its end; note how many pushes were carried out."""
    with cpu_quota(percent, run.process.pid) as how:
        run.wait_for_end()
    bag = Bag(run.bag)
    last = bag.deserialize(list(bag.messages([f"{NAMESPACE}/plan_progress"]))[-1])
    run.note(f"{last.completed} of {last.count} pushes carried out, with {how}")


def _kill_the_owner(percent: float, run: CellRun) -> None:
    """Leave the run this share of a processor, and kill who owns the second push; note when the pusher rested.

    The actuator waits for that before it ends.
    """
    with cpu_quota(percent, run.process.pid) as how:
        run.wait_for_push()
        begin = time.monotonic()
        run.signal("experiment", signal.SIGKILL)
        run.wait_for(lambda: "actuator" not in run.nodes_alive().values(), "the end of the actuator")
        run.note(f"the pusher rested within {time.monotonic() - begin:.1f} s, when the actuator ended, with {how}")
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
    "simulated_cell": f"the controller at|no report of|lost .*pusher|{UNSEEN}",
    "recorder": "(?!)",
}
"""By the node that is struck: why a push may be aborted."""

STARVED = (
    f"{SILENT}|{UNSEEN}|stood still for|no report of|no answer to|is not done after|the pusher (does not answer|forgot it)"
)

ANY = (0, 1)
STARTED_AGAIN = ("tracker", "estimator")

NODE_CASES = [
    *(
        Case(
            f"kill -9 of {node}",
            "started again, or the run ends and says which node"
            if node in STARTED_AGAIN
            else "the run ends and says which node",
            ANY if node in STARTED_AGAIN else (1,),
            f"{node} was killed by SIGKILL",
            partial(_signal, node, signal.SIGKILL),
            quick=node == "recorder",
            aborts=REASONS[node],
        )
        for node in NODES
    ),
    *(
        Case(
            f"SIGTERM to {node}",
            "the run has failed and says which node",
            (1,),
            f"error: {node} (has finished, but the plan has not|ended with exit code [01])",
            partial(_signal, node, signal.SIGTERM),
            quick=node == "experiment",
            aborts=REASONS[node],
        )
        for node in NODES
    ),
    *(
        Case(
            f"{node} stopped for 5 s",
            "nothing is lost, or the run says what and ends with 1; no hang",
            ANY,
            "",
            partial(_stall, node),
            aborts=REASONS[node],
        )
        for node in NODES
    ),
    *(
        Case(
            f"{node} stopped for good",
            "it is ended after 10 s, as if it had died",
            ANY if node in STARTED_AGAIN else (1,),
            rf"{node} was stopped \(SIGSTOP\) for 10 s and is ended",
            partial(_signal, node, signal.SIGSTOP),
            aborts=REASONS[node],
        )
        for node in NODES
    ),
]

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
}
GOES_ON = {
    "frames in the wrong order": "nothing happens, or the run says what and ends with 1",
    "every frame twice": "nothing happens",
    "clock set back for a second": "what was measured meanwhile is not used, and the result says so",
}
CAMERA_CASES = [
    *(Case(f"camera: {name}", SEEN, (130,), says, camera=name, interrupt=True, aborts=UNSEEN,
           quick=name == "frozen except for one pixel")
      for name, says in WAITS.items()),
    *(Case(f"camera: {name}", asked, (0,) if name == "every frame twice" else ANY, camera=name,
           aborts="(?!)" if name == "every frame twice" else UNSEEN)
      for name, asked in GOES_ON.items()),
]  # fmt: skip
assert {case.camera for case in CAMERA_CASES} == set(FAULTS)

SAYS_SO = "the run ends and says so"
FILE_CASES = [
    *(
        Case(
            f"the recorder's disk is full after {more} more bytes",
            f"{SAYS_SO}; what was written can be read",
            (1, 2),
            "File too large",
            partial(_limit_the_recorder, more),
        )
        for more in (0, 1, 100, 5000, 20_000)
    ),
    Case(
        "every fsync fails (EIO)",
        "the run ends with an error though all pushes were made: nobody knows whether the bag is on the disk",
        (1, 2),
        "cannot write the bag: Input/output error",
        through="failing_sync",
    ),
    Case(
        "the bag's folder is removed",
        SAYS_SO,
        (1, 2),
        "was removed or moved while it was recorded",
        lambda run: shutil.rmtree(run.bag),
    ),
    Case(
        "every sector of the bag lost, one after the other",
        "each loss is noticed and counted; 97 % of the messages are saved on average",
        (0,),
        "sectors",
        _every_sector,
    ),
    Case("a second recorder into the same folder", "it is refused; the run goes on", (0,), "", _second_recorder),
    Case("a second cell of the same name", "it is refused; the run goes on", (0,), "", _second_cell),
]

QUOTAS = [
    *(
        Case(
            f"CPU quota of {percent} %",
            "no push is aborted" if percent == 20 else "as many pushes as can be; each aborted one says what was measured",
            (0,) if percent == 20 else ANY,
            "pushes carried out",
            partial(_starve, percent),
            at_once=True,
            short=percent < 20,
            aborts="(?!)" if percent == 20 else STARVED,
        )
        for percent in (20, 10, 5)
    ),
    *(
        Case(
            f"CPU quota of {percent} %, kill -9 of experiment",
            "the pusher rests, the run ends and says which node",
            (1,),
            "the pusher rested within",
            partial(_kill_the_owner, percent),
            at_once=True,
            aborts=REASONS["experiment"] if percent == 20 else STARVED,
        )
        for percent in (20, 10, 5)
    ),
]

ENDINGS = [
    *(
        Case(
            f"Ctrl-C {LONGEST * (number + 0.5) / MOMENTS:.1f} s after the start",
            "exit code 130, or 0 where the run was over; no process is left, and the bag can be read",
            (130, 0),
            "",
            partial(_interrupt, LONGEST * (number + 0.5) / MOMENTS),
            at_once=True,
        )
        for number in range(MOMENTS)
    ),
    Case("the command line is killed", "all nodes end, and the bag can be read", (-9,), "", lambda run: run.process.kill()),
    Case(
        "the terminal closes (SIGHUP)",
        "all nodes end, and the bag can be read",
        (-1, 129),
        "",
        lambda run: run.process.send_signal(signal.SIGHUP),
    ),
]

CASES = (*NODE_CASES, *CAMERA_CASES, *FILE_CASES, *QUOTAS, *ENDINGS)
