"""The stage of faults with a GRBL controller: a line that can fail, and the truth as the controller reports it.

A whole cell may play on it: its own command line, experiment, tracker and estimator, with a rendered camera.
"""

import json
import pathlib
import subprocess
import time
from dataclasses import replace

from pushfric_core.errors import blaming
from pushfric_core.pushers.axis_reports import AXES
from pushfric_core.pushers.grbl import INCH
from pushfric_core.pushers.grbl_protocol import RealTime, parse_status
from pushfric_core.pushers.pusher import PusherConfig
from pushfric_core.pushers.serial_config import GrblConfig
from pushfric_core.pushers.serial_pusher import SerialPusher
from pushfric_core.settings import plain
from pushfric_core.simulated.faulty_line import FaultyLine
from pushfric_core.vision.camera import Camera, save_camera
from pushfric_msgs.msg import PlanProgress, PusherState
from pushfric_ros.faults.fault import EndedEarly
from pushfric_ros.faults.processes import PROGRAM, nodes_alive, started, words_of
from pushfric_ros.faults.stage import Heard, NotRehearsed, Stage
from pushfric_ros.node_kit.qos import LATCHED

LISTENING = 0.02  # the stage asks for a report if none was heard for this long [s]
NOT_IN_A_FILE = ("requires", "autostart", "real_time_factor")
LONGEST = 0.05
"""Largest length of a push in the rendered camera's view [m]."""
ANSWERS = {PlanProgress.PHASE_ALARM: "actuator/reset", PlanProgress.PHASE_CHOOSING: "experiment/repeat"}
"""The answers that a cell awaits of a person."""


class GrblStage(Stage):
    """A stage that hears all that the controller says, whatever happens to the actuator."""

    same = 2e-5
    line: FaultyLine
    grbl: GrblConfig

    def open(self) -> None:
        assert isinstance(self.given.driver, GrblConfig)
        self.grbl = self.given.driver
        self._lines: list[str] = []
        self._rest, self._unit, self._raw = b"", 1.0, 0.0  # [mm]
        self._zero: float | None = None  # where the rehearsal began, by the controller's count [mm]
        self._heard_at = 0.0
        with blaming(f"cannot open {self.grbl.port}", OSError):
            self.line = self.enter_context(FaultyLine(self.grbl.port, self.grbl.baud))
        self.port = self.line.port  # the name by which an actuator calls it
        self.line.heard = self._listen
        super().open()
        if self.position > self.same:  # the cells of a rehearsal bring the pusher back to 0
            here = f"the controller stands at {1e3 * self.position:.3f} mm"
            raise NotRehearsed(f"{here}, expected 0: bring it there, or set its work zero")
        self._unit = INCH if "$13=1" in self.ask("$$") else 1.0
        before = self._heard_at
        self.wait(lambda: self._heard_at > before, "a report")
        self._zero = self._raw
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
            if self._zero is None:
                continue
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
        return {line: comparable(self.ask(line)) for line in ("$$", "$#", "$G")}

    def _pusher(self, look: bool) -> SerialPusher:
        return SerialPusher(replace(self.grbl, port=self.line.port), only_look=look)

    def config(self) -> tuple[PusherConfig, GrblConfig]:
        """As of any stage; the actuator is on the line's other end."""
        return super().config()[0], replace(self.grbl, port=self.port)

    def bring_back(self) -> list[str]:
        super().bring_back()
        self.ask(" ".join(word for word in self.before["$G"][0].strip("]").split() if word in RESTORED))
        now = self.known()
        changed = [f"{line} is not what it was" for line in now if now[line] != self.before[line]]
        return changed + ["the position"] * (abs(self.along()) > self.same)

    # A whole cell

    def cell_under_way(self, share: float) -> "subprocess.Popen[str]":
        """Start `run --simulated-camera`, and wait until its first push has covered this share.

        Raises:
            EndedEarly: the cell ended before.
        """
        self.end_actuator()
        distance = min(self.reach, LONGEST)
        bag = str(self.folder / f"bag_{time.monotonic_ns()}")
        arguments = ["run", str(self._written(distance)), "--simulated-camera", "--headless", "--bag", bag]
        self.client = run = started((*PROGRAM, *arguments), self.folder)
        progress: list[PlanProgress] = []

        def far_enough() -> bool:
            # on a busy machine a controller may seem silent; then a push is given up, and the cell asks what to do
            if progress and (answer := ANSWERS.get(progress[-1].phase)) is not None:
                self.insist(answer)
            # a push that a pause of the computer ended is repeated: only in one that goes on is there anything to stop; whether
            # it does, the controller says before the state
            moves = self.heard[-1].moves and self.along() > share * distance
            pushes = bool(self.states) and self.states[-1][1].push_id != PusherState.NO_PUSH
            return (moves and pushes) or run.poll() is not None

        try:
            with self.person.hearing(PlanProgress, "plan_progress", LATCHED, progress.append):
                self.wait(far_enough, "the push of a cell")
        except NotRehearsed as error:
            if self.broken_out is not None or self.line.broken is not None:
                raise
            raise EndedEarly(str(error)) from error
        if run.poll() is not None:
            raise EndedEarly(f"the cell ended before the fault: {words_of(run)}")
        return run

    def cell_has_ended(self) -> None:
        """Wait until no process of the cell is left."""
        self.wait(lambda: not nodes_alive(self.folder), "the end of the cell's processes")

    def _written(self, distance: float) -> pathlib.Path:
        """Write a cell's file in which the place where the rehearsal began is the origin of the table."""
        pusher, driver = self.config()
        camera, cell = self.folder / "camera.yaml", self.folder / "cell.yaml"
        save_camera(Camera.looking_down(640, 480, center=(0.0, 0.06), metres_per_pixel=0.000625), camera)
        given = {**plain(pusher), "line_origin": [0.0, -self.position], **plain(driver)}
        content = {
            "namespace": self.namespace,
            "object": "rubber_rect4",
            "camera": {"source": "topic", "calibration": str(camera)},
            "pusher": {name: value for name, value in given.items() if name not in NOT_IN_A_FILE},
            "plan": {"distance": distance, "speed": self.given.speed},
        }
        cell.write_text(json.dumps(content))  # JSON is YAML
        return cell


RESTORED = {"G20", "G21", "G90", "G91", "G17", "G18", "G19", "G93", "G94", *(f"G{n}" for n in range(54, 60))}
"""Modal words that a reset of the controller changes and that a line restores."""


def comparable(answer: list[str]) -> list[str]:
    """An answer without the parts that mean nothing: the last feed, and the motion mode, which the next line sets."""
    words = [[word for word in text.split() if not word.startswith(("F", "[GC:"))] for text in answer]
    return [" ".join(text) for text in words]
