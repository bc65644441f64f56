"""The stage of a rehearsal with a GRBL controller: a line that can fail, and the truth as the controller reports it.

A whole cell may play on it: its own command line, experiment, tracker and estimator, with a rendered camera.
"""

import contextlib
import json
import pathlib
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

from pushfric_core.errors import InvalidInput
from pushfric_core.pushers.grbl import INCH, Grbl
from pushfric_core.pushers.grbl_protocol import RealTime, parse_status
from pushfric_core.pushers.pusher import PusherConfig, drive
from pushfric_core.pushers.serial_config import GrblConfig
from pushfric_core.pushers.serial_pusher import SerialPusher
from pushfric_core.pushers.serial_settings import AXES
from pushfric_core.settings import plain
from pushfric_core.simulated.faulty_line import FaultyLine
from pushfric_core.vision.camera import Camera, save_camera
from pushfric_msgs.msg import PlanProgress, PusherState
from pushfric_ros.node_kit.person import NoAnswer, Person
from pushfric_ros.node_kit.qos import LATCHED
from pushfric_ros.rehearsal.stage import RESET_AGAIN, EndedEarly, Heard, NotRehearsed, Stage, words_of

LISTENING = 0.02  # the stage asks for a report if none was heard for this long [s]
LONGEST = 0.05
"""Largest length of a push in the rendered camera's view [m]."""
ANSWERS = {PlanProgress.PHASE_ALARM: "actuator/reset", PlanProgress.PHASE_CHOOSING: "experiment/repeat"}
"""The answers that a cell awaits of a person."""


class GrblStage(Stage):
    """A stage that hears all that the controller says, whatever happens to the actuator."""

    same = 2e-5
    line: FaultyLine
    grbl: GrblConfig

    def _open(self, leaving: contextlib.ExitStack) -> None:
        assert isinstance(self.given.driver, GrblConfig)
        self.grbl = self.given.driver
        self._lines: list[str] = []
        self._rest, self._unit, self._zero, self._raw = b"", 1.0, 0.0, 0.0  # [mm]
        self._heard_at = 0.0
        try:
            self.line = leaving.enter_context(FaultyLine(self.grbl.port, self.grbl.baud))
        except OSError as error:
            raise InvalidInput(f"cannot open {self.grbl.port}: {error}") from error
        self.port = self.line.port  # the name by which an actuator calls it
        self.line.heard = self._listen

    def _check(self) -> None:
        super()._check()
        if self.position > self.same:  # the cells of a rehearsal bring the pusher back to 0
            here = f"the controller stands at {1e3 * self.position:.3f} mm"
            raise NotRehearsed(f"{here}, expected 0: bring it there, or set its work zero")

    def _look(self) -> None:
        self._unit = INCH if "$13=1" in self.ask("$$") else 1.0
        before = self._heard_at
        self.wait(lambda: self._heard_at > before, "a report")
        self._zero = self._raw
        self.heard.clear()
        self.broken_out = None
        self.before = self.known()

    def heal(self) -> None:
        self.line.heal()

    def _listen(self, data: bytes) -> None:
        """Take what the controller says; called in the line's thread."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for raw in lines:
            text = raw.decode("ascii", errors="replace").strip()
            status = parse_status(text)
            if status is None:
                self._lines.append(text)
                continue
            place = status.machine_position or status.work_position
            index = AXES.index(self.grbl.axis[-1])
            if place is None or len(place) <= index:
                continue
            self._raw, self._heard_at = place[index] * self._unit, time.monotonic()
            along = self.sign * (self._raw - self._zero) * 1e-3
            speed = (status.feed or 0.0) * self._unit / 60e3
            self.hear(Heard(self._heard_at, along, speed, status.state in ("Run", "Jog")))

    def hear(self, one: Heard) -> None:
        before = self.broken_out
        super().hear(one)
        if self.broken_out is not before:
            self.line.tell_controller(RealTime.HOLD.value)

    @property
    def sign(self) -> int:
        """-1 if the stroke runs towards negative coordinates."""
        return -1 if self.grbl.axis[0] == "-" else 1

    def _witnessed(self, when: float, state: PusherState) -> None:
        """The published state is judged, not believed."""

    def spin(self, seconds: float = 0.005) -> None:
        """See Stage; ask the controller for a report if nobody else does."""
        if self.line.broken is not None:
            raise NotRehearsed(f"the line to the controller at {self.grbl.port} is broken: {self.line.broken}")
        if time.monotonic() - self._heard_at > LISTENING:
            self.line.tell_controller(RealTime.ASK.value)
            self._heard_at = time.monotonic()
        super().spin(seconds)

    def ask(self, line: str) -> list[str]:
        """The controller's answer to a line; only for use at rest."""
        self._lines.clear()
        self.line.tell_controller(line.encode() + b"\n")
        self.wait(lambda: "ok" in self._lines or any(text.startswith("error") for text in self._lines), f"the answer to {line}")
        return list(self._lines)

    def known(self) -> dict[str, list[str]]:
        """The controller's settings and modes, which the rehearsal must not change."""
        return {line: self.ask(line) for line in ("$$", "$#", "$G")}

    @contextlib.contextmanager
    def driver(self, look: bool = False) -> Iterator[SerialPusher]:
        with contextlib.closing(SerialPusher(replace(self.grbl, port=self.line.port), Grbl(), only_look=look)) as pusher:
            pusher.connect()
            drive(pusher)
            yield pusher

    def config(self) -> tuple[PusherConfig, GrblConfig]:
        """As of any stage; the actuator is on the line's other end."""
        return super().config()[0], replace(self.grbl, port=self.port)

    def bring_back(self) -> list[str]:
        self._end_processes()
        self.line.heal()
        with self.driver() as pusher:
            pusher.recover()
            drive(pusher)
            pusher.move_to(self.position, min(5 * self.given.speed, self.limits.max_speed))
            drive(pusher)
        self.ask(" ".join(word for word in self.before["$G"][0].strip("[]GC:").split() if word in RESTORED))
        now = self.known()
        changed = [line for line, answer in self.before.items() if comparable(answer) != comparable(now[line])]
        return [f"{line} is not what it was" for line in changed] + ["the position"] * (abs(self.along()) > self.same)


RESTORED = {"G20", "G21", "G90", "G91", "G17", "G18", "G19", "G93", "G94", *(f"G{n}" for n in range(54, 60))}
"""Modal words that a reset of the controller changes and that a line restores."""


def comparable(answer: list[str]) -> list[str]:
    """An answer without the parts that mean nothing: the last feed, and the motion mode, which the next line sets."""
    words = [[word for word in text.split() if not word.startswith(("F", "[GC:"))] for text in answer]
    return [" ".join(text) for text in words]


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
