"""A whole cell on the stage: its own command line, experiment, tracker and estimator, with a rendered camera."""

import contextlib
import json
import pathlib
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

from pushfric_core.settings import plain
from pushfric_core.vision.camera import Camera, save_camera
from pushfric_msgs.msg import PlanProgress, PusherState
from pushfric_ros.node_kit.person import NoAnswer, Person
from pushfric_ros.node_kit.qos import LATCHED
from pushfric_ros.rehearsal.grbl_stage import GrblStage
from pushfric_ros.rehearsal.stage import RESET_AGAIN, EndedEarly, NotRehearsed, words_of

LONGEST = 0.05
"""Largest length of a push in the rendered camera's view [m]."""
ANSWERS = {PlanProgress.PHASE_ALARM: "actuator/reset", PlanProgress.PHASE_CHOOSING: "experiment/repeat"}
"""The answers that a cell awaits of a person."""


def cell_under_way(stage: GrblStage, share: float) -> "subprocess.Popen[str]":
    """Start `run --simulated-camera`, and wait until its first push has covered this share.

    Raises:
        EndedEarly: the cell ended before.
    """
    stage.end_actuator()
    distance = min(stage.reach, LONGEST)
    cell, bag = _written(stage, distance), stage.folder / f"bag_{time.monotonic_ns()}"
    arguments = ["run", str(cell), "--simulated-camera", "--headless", "--bag", str(bag)]
    stage.client = run = stage.process([sys.executable, "-m", "pushfric_core", *arguments])
    try:
        with _answering(stage.person) as answer:

            def far_enough() -> bool:
                answer()
                # a push that a pause of the computer ended is repeated: only in one that goes on is there anything to stop
                pushes = bool(stage.states) and stage.states[-1][1].push_id != PusherState.NO_PUSH
                return (pushes and stage.along() > share * distance) or run.poll() is not None

            stage.wait(far_enough, "the push of a cell")
    except NotRehearsed as error:
        if stage.broken_out is not None or stage.line.broken is not None:
            raise
        raise EndedEarly(str(error)) from error
    if run.poll() is not None:
        raise EndedEarly(f"the cell ended before the fault: {words_of(run)}")
    return run


@contextlib.contextmanager
def _answering(person: Person) -> Iterator[Callable[[], None]]:
    """Give a function that answers what a cell asks a person.

    On a busy machine a controller may seem silent; then a push is given up, and the cell asks what to do.
    """
    asked: str | None = None  # the service that the cell awaits
    again = 0.0

    def take(progress: PlanProgress) -> None:
        nonlocal asked
        asked = ANSWERS.get(progress.phase)

    def answer() -> None:
        nonlocal again
        if asked is not None and time.monotonic() > again:
            with contextlib.suppress(NoAnswer):
                person.call(asked)
            again = time.monotonic() + RESET_AGAIN

    with person.hearing(PlanProgress, "plan_progress", LATCHED, take):
        yield answer


def cell_has_ended(stage: GrblStage) -> None:
    """Wait until no process of the cell is left."""
    stage.wait(lambda: not _nodes(stage.namespace), "the end of the cell's processes")


def pid_of(node: str, stage: GrblStage) -> int:
    """The process id of a node of the cell."""
    return next(pid for pid, command in _nodes(stage.namespace).items() if f"{node}_node" in command)


def _written(stage: GrblStage, distance: float) -> pathlib.Path:
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
