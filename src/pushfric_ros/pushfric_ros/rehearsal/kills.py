"""kill -9 of the host's processes at random moments of a push."""

import json
import os
import pathlib
import random
import signal
import sys
import time
from collections.abc import Iterator
from functools import partial

from pushfric_core.settings import plain
from pushfric_ros.rehearsal.faults import Outcome, judged, traceback_in, tried, waits_for_a_person
from pushfric_ros.rehearsal.stage import REACTION, EndedEarly, NotRehearsed, Stage, end, words_of
from pushfric_ros.vision.camera import Camera, save_camera

KINDS = ("actuator", "client of a push", "experiment", "command line")
EARLIEST, LATEST = 0.05, 0.9  # of a push
LONGEST = 0.05
"""Largest length of a push in the rendered camera's view [m]."""


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
    stage.end_actuator()
    distance = min(stage.reach, LONGEST)
    cell = _written(stage, distance)
    first = len(stage.heard)
    arguments = [
        "run",
        str(cell),
        "--simulated-camera",
        "--headless",
        "--bag",
        str(stage.folder / f"bag_{time.monotonic_ns()}"),
    ]
    run = stage.process([sys.executable, "-m", "pushfric_ros", *arguments])
    try:
        try:
            stage.wait(lambda: stage.along() > share * distance or run.poll() is not None, "the push of a cell")
        except NotRehearsed as error:
            if stage.broken_out is not None:
                raise
            raise EndedEarly(str(error)) from error
        if run.poll() is not None:
            raise EndedEarly(f"the cell ended before the fault: {words_of(run)}")
        pid = run.pid if kind == "command line" else _pid_of("experiment_node", stage.namespace)
        begin = time.monotonic()
        os.kill(pid, signal.SIGKILL)
        outcome = judged(stage, kind, begin, first, REACTION)
        stage.wait(lambda: not _nodes(stage.namespace), "the end of the cell's processes")
        return outcome
    finally:
        end(run)


def _written(stage: Stage, distance: float) -> pathlib.Path:
    """Write a cell's file in which the place where the rehearsal began is the origin of the table."""
    pusher, driver = stage.config()
    camera, cell = stage.folder / "camera.yaml", stage.folder / "cell.yaml"
    save_camera(Camera.looking_down(640, 480, center=(0.0, 0.06), metres_per_pixel=0.000625), camera)
    content = {
        "namespace": stage.namespace,
        "object": "rubber_rect4",
        "camera": {"source": "topic", "calibration": str(camera)},
        "pusher": {**_given(plain(pusher)), "line_origin": [0.0, -stage.position], **_given(plain(driver))},
        "plan": {"distance": distance, "speed": stage.given.speed},
    }
    cell.write_text(json.dumps(content))  # JSON is YAML
    return cell


def _given(values: dict[str, object]) -> dict[str, object]:
    return {name: value for name, value in values.items() if name not in ("requires", "autostart", "real_time_factor")}


def _nodes(namespace: str) -> dict[int, str]:
    """The processes of a cell's nodes: their command lines, by process id."""
    found = {}
    for folder in pathlib.Path("/proc").glob("[0-9]*"):
        try:
            command = (folder / "cmdline").read_bytes().decode(errors="replace")
        except OSError:
            continue  # it has just ended
        if f"__ns:={namespace}" in command:
            found[int(folder.name)] = command
    return found


def _pid_of(node: str, namespace: str) -> int:
    return next(pid for pid, command in _nodes(namespace).items() if node in command)
