"""kill -9 of the host's processes at random moments of a push."""

import os
import random
import signal
import time
from collections.abc import Iterator
from functools import partial

from pushfric_ros.rehearsal.cell import cell_has_ended, cell_under_way, pid_of
from pushfric_ros.rehearsal.faults import Outcome, judged, traceback_in, tried, waits_for_a_person
from pushfric_ros.rehearsal.stage import REACTION, Stage

KINDS = ("actuator", "client of a push", "experiment", "command line")
EARLIEST, LATEST = 0.05, 0.9  # of a push


def kill(stage: Stage, times: int, seed: int) -> Iterator[Outcome]:
    """Kill each kind of process in turn. The remaining processes go on; afterwards a new actuator must wait for a person.

    The experiment and the command line are those of a whole cell, with a rendered camera (`run --simulated-camera`).
    """
    randomly = random.Random(seed)
    for k in range(times):
        kind, share = KINDS[k % len(KINDS)], randomly.uniform(EARLIEST, LATEST)
        one = _of_a_push if kind in KINDS[:2] else _of_a_cell
        yield tried(partial(one, stage, kind, share), kind)


def _of_a_push(stage: Stage, kind: str, share: float) -> Outcome:
    stage.ready()
    first = len(stage.heard)
    stage.under_way(share)
    process = stage.actuator if kind == "actuator" else stage.client
    assert process is not None
    begin = time.monotonic()
    process.kill()
    outcome = judged(stage, kind, begin, first, REACTION)
    if outcome.problem is not None or kind != "actuator":
        return outcome._replace(problem=outcome.problem or traceback_in(stage))
    stage.start_actuator()
    return outcome._replace(problem=waits_for_a_person(stage) or traceback_in(stage))


def _of_a_cell(stage: Stage, kind: str, share: float) -> Outcome:
    stage.ready()
    first = len(stage.heard)
    run = cell_under_way(stage, share)
    pid = run.pid if kind == "command line" else pid_of(kind, stage)
    begin = time.monotonic()
    os.kill(pid, signal.SIGKILL)
    outcome = judged(stage, kind, begin, first, REACTION)
    cell_has_ended(stage)
    return outcome
