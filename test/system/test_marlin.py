"""The example of a driver for a line protocol, on a line that can fail, with simulated firmware."""

import contextlib
import random
import time
from collections.abc import Callable, Iterator

import pytest
from calls import wait_until
from line_stage import DEAD_MAN, SPEED, LineStage
from marlin_firmware import SimulatedMarlin

from examples.marlin import MarlinConfig
from pushfric_core.pushers.pusher import Halted, NotConnected, NotReady
from pushfric_core.pushers.serial_pusher import SerialPusher
from pushfric_core.pushers.stroke import Plausibility, Stroke
from pushfric_core.simulated.faulty_line import FaultyLine, once

FAR = 0.05
STEP = 1e-3 / 80
ROUNDED = 5e-6
"""A report has two decimals of a millimetre."""


class Stage(LineStage):
    """A Marlin controller on a line that can fail; the stage hears what is sent."""

    config = MarlinConfig

    def __init__(self, controller: SimulatedMarlin, line: FaultyLine) -> None:
        super().__init__(controller, line)
        self.sent = b""
        self.listen()

    def listen(self, then: Callable[[bytes], bytes] = bytes) -> None:
        def heard(data: bytes) -> bytes:
            self.sent += data
            return then(data)

        self.line.to_controller = heard

    def under_way(self, pusher: SerialPusher, place: float = 0.01) -> None:
        """Begin a stroke, and poll until the carriage has passed a place [m]."""
        pusher.move_to(FAR, SPEED)
        self.drive(pusher, lambda: self.controller.position() > place)


@pytest.fixture
def stage() -> Iterator[Stage]:
    with stage_of() as stage:
        yield stage


@contextlib.contextmanager
def stage_of(**options) -> Iterator[Stage]:
    with SimulatedMarlin(time.monotonic, **options) as controller, FaultyLine(controller.port) as line:
        yield Stage(controller, line)


def test_a_stop_is_immediate_and_keeps_the_position(stage: Stage) -> None:
    with contextlib.closing(stage.driver()) as pusher:
        stage.under_way(pusher)
        begin = stage.controller.position()
        stage.carry_out(pusher, pusher.stop)
        rest = stage.controller.position()
        assert rest - begin <= DEAD_MAN / 2  # the most of what had been sent is not carried out
        assert pusher.doubt is None
        assert pusher.axis.last.position == pytest.approx(rest, abs=ROUNDED)
        stage.push(pusher, FAR)
        assert stage.controller.position() == pytest.approx(FAR, abs=STEP)


@pytest.mark.parametrize(("old", "new"), [(b"G1 X", b"G1 X9"), (b"F1200", b"F9200"), (b"G1 X", b"G1 Y")])
@pytest.mark.parametrize("together", [False, True])
def test_a_damaged_line_is_refused_and_sent_again(stage: Stage, old: bytes, new: bytes, together: bool) -> None:
    """It throws away what it has received with that line: two questions, where it reads late."""
    damage, held = once(old, new), bytearray()

    def late(data: bytes) -> bytes:
        damaged = damage(data)
        if together and (held or damaged != data) and held.count(b"M114") < 2:
            held.extend(damaged)
            return bytes(held) if held.count(b"M114") == 2 else b""
        return damaged

    with contextlib.closing(stage.driver()) as pusher:
        stage.under_way(pusher)
        stage.listen(late)
        reports = stage.drive(pusher, lambda: not pusher.busy)
        assert stage.controller.position() == pytest.approx(FAR, abs=STEP)
        assert max(report.position for report in reports) <= FAR + ROUNDED
        assert stage.sent.count(b"G90*") == 1  # it was the same stroke


def test_no_speed_is_reported_that_late_answers_do_not_prove(stage: Stage) -> None:
    delays = random.Random(1)

    def said(data: bytes) -> bytes:
        stage.line.delay_to_host = delays.uniform(0, 0.4)  # meanwhile the next question is sent
        return data

    with contextlib.closing(stage.driver()) as pusher:
        stage.line.to_host = said
        assert 0 < max(report.speed for report in stage.push(pusher, FAR)) <= 1.05 * SPEED
        assert stage.controller.position() == pytest.approx(FAR, abs=STEP)


def test_a_firmware_that_reports_planned_positions_is_refused_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    with stage_of(real_positions=False) as stage, contextlib.closing(stage.driver()) as pusher:
        monkeypatch.setattr(Stroke, "farthest", lambda *_: Plausibility.SLACK)  # a busy machine takes its time
        pusher.move_to(FAR, SPEED)
        stage.fails(pusher, NotReady, r"mm after \d\.\d\d s of a stroke at 20 mm/s: its firmware needs M114_REALTIME")
        assert stage.rest() <= DEAD_MAN


def test_a_halted_firmware_says_so(stage: Stage) -> None:
    with contextlib.closing(stage.driver(connect_timeout=1.0)) as pusher:
        stage.under_way(pusher)
        stage.controller.kill("Heating Failed, system stopped! Heater_ID: 0")
        stage.fails(pusher, Halted, "switch the controller off and on")
    with contextlib.closing(SerialPusher(MarlinConfig(stage.line.port, connect_timeout=0.5))) as pusher:
        pusher.connect()
        stage.fails(pusher, NotConnected, "no Marlin controller answers .*; if it was halted")


@pytest.mark.parametrize("gone", [-1.0, 0.001], ids=["before it begins", "in motion"])
def test_a_moving_pusher_is_stopped_when_it_is_found(stage: Stage, gone: float) -> None:
    stage.line.tell_controller(b"G1 X80 F600\n")
    wait_until(lambda: stage.controller.position() >= gone)
    with contextlib.closing(stage.driver()) as pusher:
        assert stage.rest() < 0.08
        assert pusher.doubt == "it moved when it was found"
        with pytest.raises(NotReady, match="not known until it is recovered"):
            pusher.move_to(0.0, SPEED)
        stage.carry_out(pusher, pusher.recover)
        stage.push(pusher, 0.0)
        assert stage.controller.position() == pytest.approx(0.0, abs=STEP)


def test_it_homes(stage: Stage) -> None:
    with contextlib.closing(stage.driver(home=True)) as pusher:
        stage.push(pusher, 0.01)
        stage.carry_out(pusher, pusher.recover)
        assert b" G28 X*" in stage.sent
        assert stage.controller.position() == pytest.approx(0.0, abs=STEP)
        assert pusher.axis.last.position == 0.0


def test_a_stop_while_it_homes_halts_the_firmware(stage: Stage) -> None:
    with contextlib.closing(stage.driver(home=True)) as pusher:
        stage.push(pusher, FAR)
        pusher.recover()
        stage.drive(pusher, lambda: stage.controller.position() < 0.04)
    assert 0 < stage.rest() < 0.04
    with contextlib.closing(SerialPusher(MarlinConfig(stage.line.port, connect_timeout=0.5))) as pusher:
        pusher.connect()
        stage.fails(pusher, NotConnected, "if it was halted")
