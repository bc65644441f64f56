"""What a pusher does when something breaks in mid-stroke: the driver, a line that fails, and the simulated firmware."""

import contextlib
import math
import os
import re
import signal
import sys
import time
from collections.abc import Iterator
from itertools import pairwise

import pytest
from calls import killed_at_the_end, wait_until
from line_stage import ACCELERATION, DEAD_MAN, LATE, SPEED, LineStage

from pushfric_core.pushers.clock import suspended
from pushfric_core.pushers.driver import Phase
from pushfric_core.pushers.pusher import (
    Jumped,
    LeftTheWay,
    Mode,
    NotConnected,
    NotReady,
    PusherError,
    PusherReport,
    Suspended,
    Timeout,
    TooFast,
)
from pushfric_core.pushers.serial_config import GrblConfig
from pushfric_core.pushers.serial_pusher import SerialPusher
from pushfric_core.pushers.stroke import Plausibility, Stroke, unevenness
from pushfric_core.simulated.faulty_line import FaultyLine, nothing, once
from pushfric_core.simulated.grbl_firmware import SimulatedGrbl
from pushfric_ros.faults.line import random_damage, straying

FAR = 0.09

USUAL = 0.15
"""Within this time, the driver sees from two reports where the pusher goes, and stops it [s]."""


class Stage(LineStage):
    """A GRBL controller on a line that can fail."""

    config = GrblConfig

    def listen(self) -> bytearray:
        """All that is sent from now on."""
        heard = bytearray()
        self.line.to_controller = lambda data: heard.extend(data) or data
        return heard

    def outlast(self, pusher: SerialPusher, seconds: float = 2.0) -> list:
        """Poll until the driver is not busy, whatever it raises; if it is disconnected, connect again, for this long [s]."""
        reports = []
        deadline = math.inf
        while time.monotonic() < deadline:
            try:
                if pusher.mode is Mode.DISCONNECTED and not pusher.busy:
                    deadline = min(deadline, time.monotonic() + seconds)
                    pusher.connect()
                report = pusher.poll()
            except PusherError:
                continue
            if report is not None and report.mode is not Mode.DISCONNECTED:
                reports.append(report)
            if not pusher.busy and pusher.mode is not Mode.DISCONNECTED:
                break
            time.sleep(0.002)
        return reports


class JogsOn(SimulatedGrbl):
    """On grblHAL, for example, a feed hold does not end a jog."""

    def _hold(self) -> None:
        if self._state != "Jog":
            super()._hold()


class Deafened(SimulatedGrbl):
    """GRBL 1.1h if a jog ends just as it is cancelled: it answers questions, and reads no line until a reset."""

    reads = True

    def _cancel_jog(self) -> None:
        super()._cancel_jog()
        self.reads = False

    def _boot(self) -> None:
        super()._boot()
        self.reads = True

    def _receive(self, data: bytes) -> None:
        super()._receive(data if self.reads else bytes(byte for byte in data if byte in b"?!\x18\x85"))


@pytest.fixture
def stage(request) -> Iterator[Stage]:
    with (
        getattr(request, "param", SimulatedGrbl)(time.monotonic, acceleration=ACCELERATION, restarts=False) as controller,
        FaultyLine(controller.port) as line,
    ):
        yield Stage(controller, line)


def under_way(stage: Stage, distance: float = FAR, silence: float | None = None, **options) -> SerialPusher:
    """A driver in mid-stroke, which allows so much silence from now on."""
    pusher = stage.driver(**options)
    pusher.move_to(distance, SPEED)
    stage.drive(pusher, lambda: pusher.axis.last.position > 0.01)
    pusher._silence = silence or pusher._silence
    return pusher


def noticing(heard: list[float]) -> float:
    """USUAL, or longer on a busy machine, which asks late, by the times at which the controller was heard [s]."""
    longest = max(then - before for before, then in pairwise(heard))  # 0.05 s
    return USUAL if longest < 0.075 else 3 * longest


def test_the_speed_in_mid_stroke_is_that_of_one_long_line(stage):
    pusher = stage.driver()
    reports = stage.push(pusher, 0.05)
    mid = [report.speed for report in reports if 0.005 < report.position < 0.045]
    assert len(mid) > 20
    # a busy machine may send a piece late; the most of them are as even as one line
    assert sorted(mid)[len(mid) // 2] == pytest.approx(SPEED, rel=0.001)
    assert stage.controller.position() == pytest.approx(0.05, abs=1e-9)


@pytest.mark.parametrize(
    ("old", "new"),
    [(b".", b""), (b"X", b"X9"), (b"X", b"X-"), (b"G21", b"G20")],
    ids=["point", "digit", "sign", "inch"],
)
def test_a_line_that_was_damaged_on_its_way_never_leads_the_pusher_off_it(stage, old, new):
    """A report 2 mm off the commanded way is a hold; what follows is the way of two reports and the braking."""
    pusher = under_way(stage, 0.03)
    seen, heard = [0.01, 0.01], []

    def listen(data: bytes) -> None:
        here = stage.controller.position()
        seen[:] = [min(seen[0], here), max(seen[1], here)]
        heard.append(time.monotonic())

    stage.line.heard = listen
    stage.line.to_controller = once(old, new)
    stage.fails(pusher, PusherError)
    rest = stage.rest()
    fastest = 0.1 if old == b"G21" else SPEED  # inches per minute are beyond the controller's greatest speed
    late = 0.002 + fastest * noticing(heard) + fastest**2 / (2 * ACCELERATION)
    assert 0.01 - late < min(seen[0], rest)
    assert max(seen[1], rest) < 0.03 + late
    assert stage.rest() == rest


def test_an_ok_that_was_lost_is_not_waited_for_for_ever(stage):
    pusher = under_way(stage, silence=0.5)
    stage.line.to_host = once(b"ok\r\n", b"")
    begin = stage.controller.position()
    stage.fails(pusher, Timeout, r'no answer to "\$J=')
    assert pusher.mode is Mode.IDLE
    assert stage.rest() - begin < 0.5 * SPEED + DEAD_MAN + LATE


@pytest.mark.parametrize("stage", [SimulatedGrbl, JogsOn], indirect=True)
@pytest.mark.parametrize("what", ["a stroke", "a damaged line", "what somebody else sent"])
def test_any_jog_is_stopped_at_once(stage, what):
    """This holds for a jog that goes on far beyond the queue, too."""
    if what == "what somebody else sent":
        stage.line.tell_controller(b"$J=X90 F1200\n")
        wait_until(lambda: stage.controller.position() > 0.01)
        spoken: list[float] = []  # a busy machine may take its time until the driver says its first byte
        stage.line.to_controller = lambda data: spoken.append(stage.controller.position()) or data
        stage.driver()
        begin = spoken[0]
    else:
        pusher = under_way(stage, 0.03)
        if what == "a damaged line":
            heard: list[float] = []
            stage.line.heard = lambda data: heard.append(time.monotonic())
            stage.line.to_controller = once(b"X", b"X9")
            stage.fails(pusher, PusherError)
            assert stage.rest() < 0.032 + DEAD_MAN + LATE + SPEED * (noticing(heard) - USUAL)
            return
        begin = stage.controller.position()
        stage.carry_out(pusher, pusher.stop)
    assert stage.rest() - begin <= DEAD_MAN + LATE


@pytest.mark.parametrize("somebody", [b"G20\n", b"G91\n", b"G20 G91\n"])
def test_no_modal_state_is_trusted(stage, somebody):
    pusher = stage.driver()
    stage.line.tell_controller(somebody)
    reports = stage.push(pusher, 0.01)
    assert stage.controller.position() == pytest.approx(0.01, abs=1e-9)
    assert max(report.speed for report in reports) < SPEED * 1.05


@pytest.mark.parametrize("when", ["before", "in mid-stroke"])
def test_a_feed_override_changes_no_stroke_and_is_taken_back(stage, when):
    pusher = stage.driver()
    faster = b"\x91" * 10
    if when == "before":
        stage.line.tell_controller(faster)
    pusher.move_to(0.02, SPEED)
    reports = stage.drive(pusher, lambda: stage.controller.position() > 0.01)
    if when != "before":
        stage.line.tell_controller(faster)
    reports += stage.drive(pusher, lambda: not pusher.busy)
    assert max(report.speed for report in reports) < SPEED * 1.05
    assert stage.controller._percent["feed"] == 100


def test_a_pusher_that_is_faster_than_it_was_sent_is_held():
    stroke = Stroke(0.0, 0.05, SPEED, ACCELERATION, 0.25)
    assert stroke.next_piece(0.0) is not None
    stroke.check(0.001, 0.042)  # one report may be damaged
    with pytest.raises(TooFast, match=r"moves at 0.0420 m/s, was sent at 0.0200 m/s"):
        stroke.check(0.0015, 0.042)


def test_feeds_that_are_damaged_on_their_way_end_in_a_hold(stage):
    pusher = under_way(stage, 0.06)
    stage.line.to_controller = lambda data: data.replace(b"F1200.000", b"F6000.000")
    begin = stage.controller.position()
    error = stage.fails(pusher, TooFast, "was sent at 0.0200 m/s")
    assert pusher.doubt == str(error)
    fastest = 0.1
    assert stage.rest() - begin < DEAD_MAN + fastest * 0.1 + fastest**2 / (2 * ACCELERATION) + LATE


def test_a_stroke_that_takes_too_long_is_ended():
    stroke = Stroke(0.0, 0.05, SPEED, ACCELERATION, 0.25)
    stroke.check_time(stroke.longest)
    with pytest.raises(Timeout, match=r"the stroke to 0\.0500 m is not done after"):
        stroke.check_time(stroke.longest + 0.01)
    patient = Stroke(0.0, 0.05, SPEED, ACCELERATION, 0.25, wait=2.0)
    pieces = 0
    while patient.next_piece(patient.sent) is not None:
        pieces += 1
    assert patient.longest == pytest.approx(stroke.longest + 2.0 * pieces)


@pytest.mark.parametrize("acceleration", [math.inf, 0.5, 0.01])
@pytest.mark.parametrize(("start", "target"), [(0.0, 0.05), (0.05, 0.0), (0.0123, 0.0124), (0.001, 0.0613)])
def test_the_pieces_end_at_the_target_and_are_never_far_ahead(acceleration, start, target):
    stroke = Stroke(start, target, SPEED, acceleration, 0.25)
    ends = []
    for step in range(4001):
        here = start + (target - start) * step / 4000
        while (end := stroke.next_piece(here)) is not None:
            ends.append(end)
            braking = SPEED**2 / (2 * acceleration)
            assert len(ends) == 1 or abs(end - here) <= 0.25 * SPEED + braking + 1e-12
    assert stroke.all_sent
    assert ends[-1] == target
    assert len([end for end in ends if abs(end - start) <= 0.25 * SPEED]) <= 12 + 1


CHILD = """
import sys, time
from pushfric_core.pushers.serial_pusher import SerialPusher
from pushfric_core.pushers.serial_config import GrblConfig
pusher = SerialPusher(GrblConfig(sys.argv[1], silence=0.8))
for command in (pusher.connect, lambda: pusher.move_to(float(sys.argv[2]), float(sys.argv[3]))):
    command()
    while pusher.busy:
        pusher.poll()
        time.sleep(0.003)
"""
"""Another process that drives the pusher."""


def test_a_host_that_is_stopped_leaves_a_pusher_that_rests(stage):
    command = [sys.executable, "-c", CHILD, stage.line.port, str(FAR), str(SPEED)]
    heard: list[float] = []
    stage.line.heard = lambda data: heard.append(time.monotonic())
    with killed_at_the_end(command) as process:
        wait_until(lambda: stage.controller.position() > 0.01)
        process.send_signal(signal.SIGSTOP)
        begin = stage.controller.position()
        rest = stage.rest()
        assert 0 <= rest - begin <= DEAD_MAN + LATE + SPEED * (noticing(heard) - USUAL)
        assert stage.rest() == rest
        time.sleep(1.0)  # longer than the silence that it allows
        process.send_signal(signal.SIGCONT)  # it goes on, and moves nothing
        assert process.wait(30) != 0
        assert stage.rest() <= rest + LATE


def test_a_line_that_is_cut_leaves_a_pusher_that_rests(stage, monkeypatch):
    monkeypatch.setattr("pushfric_core.pushers.grbl.RESET_PATIENCE", 0.5)
    stage.patience = {"silence": 2.0}  # it is waited for
    pusher = under_way(stage)
    stage.line.to_controller = nothing
    begin = stage.controller.position()
    stage.fails(pusher, PusherError)
    assert stage.rest() - begin <= DEAD_MAN + LATE


def test_a_controller_that_restarts_while_its_cable_is_cut_is_not_believed(stage, monkeypatch):
    """Its greeting is lost, and its reports begin again while the driver still waits for an answer to its own reset."""
    monkeypatch.setattr("pushfric_core.pushers.grbl.RESET_PATIENCE", 1.0)
    stage.patience = {"silence": 2.0}  # it is waited for
    pusher = under_way(stage, silence=0.5)
    lost = bytearray()
    stage.line.to_controller, stage.line.to_host = nothing, lambda data: lost.extend(data) or b""
    with pytest.raises(Timeout):
        stage.drive(pusher, lambda: False)
    stage.drive(pusher, lambda: Phase.RESETTING in pusher._state)
    stage.controller.reset()
    wait_until(lambda: b"Grbl" in lost)  # its greeting is lost on the line
    stage.line.heal()
    with pytest.raises(NotConnected, match="no greeting within 1 s of a reset"):
        stage.drive(pusher, lambda: False)


def test_a_controller_that_falls_mute_is_held(stage):
    pusher = under_way(stage, silence=0.2)
    begin = stage.controller.position()
    stage.line.to_host = nothing
    with pytest.raises(Timeout, match=r"no report of .* for \d+\.\d\d s in mid-stroke|no answer to|stood still"):
        stage.drive(pusher, lambda: False)
    assert stage.rest() - begin <= DEAD_MAN + LATE
    stage.line.to_host = bytes
    stage.drive(pusher, lambda: not pusher.busy)  # it is heard again, and rests where it says
    assert pusher.mode is Mode.IDLE
    assert pusher.axis.last.position == pytest.approx(stage.controller.position(), abs=1e-6)


@pytest.mark.parametrize("stage", [SimulatedGrbl, Deafened], indirect=True)
@pytest.mark.parametrize("line", [b"G1 X90 F300\n", b"$J=X90 F300\n"])
def test_a_controller_found_moving_is_asked_held_and_not_believed(stage, line):
    stage.line.tell_controller(line)
    wait_until(lambda: stage.controller.position() > 0.002)
    heard = stage.listen()
    pusher = stage.driver()
    assert heard.lstrip(b"?")[:1] == b"!"
    assert b"$X" not in heard
    assert pusher.doubt in ("it moved when it was found", "it read lines only after a reset")
    rest = stage.rest()
    assert rest < 0.03
    assert pusher.axis.last.position == pytest.approx(rest, abs=1e-6)
    assert stage.controller._state == "Idle"  # and what was held does not go on
    stage.line.tell_controller(b"~")
    assert stage.rest() == rest
    stage.carry_out(pusher, pusher.recover)
    assert pusher.doubt is None


def test_who_only_looks_at_a_moving_controller_changes_nothing(stage):
    stage.line.tell_controller(b"G1 X20 F600\n")
    wait_until(lambda: stage.controller.position() > 0.001)
    heard = stage.listen()
    pusher = stage.driver(only_look=True)
    assert pusher.mode is Mode.RUNNING
    pusher.stop()
    pusher.close()
    assert set(heard) == {ord("?")}
    assert stage.rest() == pytest.approx(0.02)


def test_a_greeting_may_take_its_time(stage):
    """After the driver's own reset: its greeting is not taken for a reset by another program."""
    pusher = under_way(stage)

    def late(data: bytes) -> bytes:
        stage.line.delay_to_host = 3.0 if b"Grbl" in data else 0.0
        return data

    stage.line.to_host = late
    pusher.stop()
    stage.drive(pusher, lambda: not pusher.busy, 30.0)
    assert pusher.mode is Mode.IDLE
    assert pusher.doubt is None
    stage.drive(pusher, lambda: not pusher.line._is_asked)
    here = stage.controller.position()
    stage.push(pusher, here + 0.002)
    assert stage.controller.position() == pytest.approx(here + 0.002, abs=1e-5)  # a step of the motor is 4e-6


@pytest.mark.parametrize(
    ("number", "value", "text"),
    [
        (120, "0", r"\$120=0, expected a positive number"),
        (130, "nan", r"\$130=nan, expected 0 or more"),
        (110, "9" * 4300, r"\$110=9{20}\.\.\., expected a positive number"),
        (27, "-1", r"\$27=-1, expected 0 or more"),
    ],
)
def test_a_hostile_setting_is_one_clear_line(stage, number, value, text):
    stage.controller._settings[number] = value
    with pytest.raises(NotConnected, match=text) as caught:
        stage.driver()
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize(
    "line",
    [b"error:" + b"9" * 4300, b"ALARM:" + b"9" * 4300, b"$" + b"9" * 4300 + b"=1", b"<Idle:" + b"9" * 4300 + b"|MPos:0.000>",
     b"<Jog|MPos:" + b"9" * 4300 + b",0.000,0.000>", b"<Jog|MPos:1e999,0,0>", b"<Jog|MPos:nan,0,0>", b"[VER:" + b"9" * 4300,
     b"<Jog|MPos:inf,0.000,0.000|Bf:" + b"1" * 4300 + b",1>", b"Grbl " + b"1" * 4300 + b".1h ['$' for help]"],
    ids=range(10),
)  # fmt: skip
def test_hostile_numbers_end_no_stroke(stage, line):
    pusher = stage.driver()
    pusher.move_to(0.01, SPEED)
    stage.drive(pusher, lambda: stage.controller.position() > 0.003)
    stage.controller.say(line + b"\r\n")
    reports = stage.drive(pusher, lambda: not pusher.busy)
    assert stage.controller.position() == pytest.approx(0.01, abs=1e-9)
    assert all(0 <= report.position <= 0.0101 for report in reports)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        *[(b"MPos:", wrong) for wrong in (b"MPos:9", b"MPos:-", b"MPos:99999", b"MPos:nan")],
        (b"WCO:0.000", b"WCO:9.000"),
        (b",0.000,0.000|", b",0.000,7.000|"),
        (b"FS:1", b"FS:91"),
    ],
)
def test_a_report_that_cannot_be_true_is_dropped_and_ends_no_stroke(stage, old, new):
    pusher = under_way(stage, 0.03)
    stage.line.to_host = once(old, new)
    reports = stage.drive(pusher, lambda: not pusher.busy)
    assert all(0.009 < report.position < 0.0301 and report.speed < 0.03 for report in reports)
    assert pusher.dropped >= (b"WCO" not in old)
    assert stage.controller.position() == pytest.approx(0.03, abs=1e-9)


@pytest.mark.parametrize("often", [1, 5])
def test_false_lines_while_it_brakes_are_never_where_it_is(stage, often):
    """They agree with each other, and with a place where the pusher was a moment ago."""
    pusher = under_way(stage, 0.03)
    pusher.stop()

    def strayed(data: bytes) -> bytes:
        false = b"<Hold:0|MPos:8.000,0.000,0.000|FS:0,0>\r\n"
        return data + false * often if data.startswith(b"<") else data

    stage.line.to_host = strayed
    believed = [pusher.axis.last.position]
    while pusher.busy:
        with contextlib.suppress(PusherError):
            if (report := pusher.poll()) is not None and not pusher.doubt:
                believed.append(report.position)
        time.sleep(0.002)
    assert min(believed) == believed[0] > 0.009
    assert stage.controller.position() > 0.01
    assert (pusher.mode is Mode.DISCONNECTED) == (often > 1)


def test_two_reports_that_agree_move_no_pusher_that_rests(stage):
    """It was not sent anywhere: either they are false or the controller has lost its position, and a person must look."""
    pusher = stage.driver()
    stage.push(pusher, 0.01)
    false = b"<Idle|MPos:8.000,0.000,0.000|FS:0,0>\r\n"
    stage.line.to_host = lambda data: false if b"MPos" in data else data
    with pytest.raises(Jumped, match=r"it was at 0\.0100 m and then, at once, at 0\.0080 m"):
        stage.drive(pusher, lambda: pusher.ask(0))  # for ever
    assert pusher.doubt is not None


@pytest.mark.parametrize(("axis", "letter"), [(1, "Y"), (2, "Z")])
@pytest.mark.parametrize("moving", [True, False], ids=["in a stroke", "at rest"])
def test_another_axis_that_moves_is_a_fault_at_once(stage, axis, letter, moving):
    """A byte of a jog may change from X to Y or Z: then the reports of the pusher's own axis are as they should be."""
    pusher = under_way(stage, 0.03) if moving else stage.driver()
    begin = time.monotonic()
    stage.line.to_host = straying(axis, lambda: 20 * (time.monotonic() - begin))
    if not moving:
        pusher.ask(0)
    places = rf"axis {letter} went from 0\.000 mm to \d+\.\d{{3}} mm; only X may move"
    with pytest.raises(LeftTheWay, match=places):
        stage.drive(pusher, lambda: pusher.ask(0))  # for ever
    stage.drive(pusher, lambda: not pusher.busy)
    assert stage.rest() < 0.03
    assert pusher.doubt is not None
    with pytest.raises(NotReady, match="is not known until it is recovered: axis"):
        pusher.move_to(0.01, SPEED)
    stage.line.heal()
    stage.carry_out(pusher, pusher.recover)
    stage.push(pusher, 0.01)


@pytest.mark.parametrize("often", [True, False])
def test_the_first_work_offset_is_confirmed_by_its_parts(stage, often):
    wrong = b"WCO:-9.000"
    stage.line.to_host = (lambda data: data.replace(b"WCO:0.000", wrong)) if often else once(b"WCO:0.000", wrong)
    pusher = stage.driver()
    assert pusher.axis.last.position == 0.0
    if often:  # nothing moves while the two contradict each other
        pusher.move_to(FAR, SPEED)
        stage.fails(pusher, Jumped, r"the work offset of .* is \(-?9\.000, 0\.000, 0\.000\) mm now, it was \(0\.000, 0\.000")
        assert stage.rest() < FAR
        assert pusher.doubt is not None


def test_an_offset_that_changes_is_a_doubt(stage):
    """As after a G92 that somebody else sent."""
    pusher = under_way(stage)
    stage.line.to_host = lambda data: data.replace(b"WCO:0.000", b"WCO:1.000")
    stage.fails(pusher, Jumped, "the work offset of")
    assert pusher.doubt is not None


@pytest.mark.parametrize("parts", [b"[G54:4.000,0.000,0.000]", b"[G92:4.000,0.000,0.000]"])
def test_a_shift_that_a_reset_ends_is_a_doubt(stage, parts):
    name = parts[:4]
    stage.line.to_host = lambda data: data.replace(name + b":0.000,0.000,0.000]", parts).replace(b"WCO:0.000", b"WCO:4.000")
    pusher = stage.driver()
    assert pusher.axis.last.position == -0.004
    stage.line.heal()
    stage.carry_out(pusher, pusher.stop)
    assert pusher.doubt == "a reset changed its work offset from (4.000, 0.000, 0.000) mm to (0.000, 0.000, 0.000) mm"


@pytest.mark.parametrize("late", [0.0, 0.08, 0.15])
def test_answers_that_come_late_leave_a_stroke_even(late):
    """The queue is never empty, and never longer than without a delay: the report that makes room for a piece is as old."""
    ahead, tick, asked = 0.25, 0.005, 0.025
    stroke = Stroke(0.0, 0.1, SPEED, ACCELERATION, ahead, latency=late)
    reports: list[tuple[float, float]] = []  # when each comes, and the position
    here = time_now = known = free_at = next_ask = 0.0
    while not stroke.all_sent:
        if time_now >= next_ask:
            reports.append((time_now + late, here))
            next_ask += asked
        while reports and reports[0][0] <= time_now:
            known = reports.pop(0)[1]
        if time_now >= free_at and stroke.next_piece(known) is not None:
            free_at = time_now + late  # when its answer comes
        assert stroke.sent - here <= SPEED * ahead + SPEED**2 / (2 * ACCELERATION) + 1e-9
        assert stroke.sent > here
        time_now += tick
        here += SPEED * tick
    assert stroke.sent == 0.1


def test_a_controller_that_answers_too_late_gets_no_stroke(stage):
    pusher = stage.driver()
    pusher._silence = 0.5  # once it is connected, for which a busy machine takes longer
    stage.line.delay_to_host = 0.7
    for _ in range(9):
        pusher.ask(0)
        stage.drive(pusher, lambda: not pusher.line._is_asked)
    with pytest.raises(NotReady, match=r"answers after \d\.\d\d s; silence is 0\.5 s"):
        pusher.move_to(0.03, SPEED)


def test_a_computer_that_was_suspended_sends_nothing_more(stage, monkeypatch):
    """The clock of a suspended computer goes on, its processes do not; so does the controller."""
    pusher = under_way(stage, 0.05)
    slept = suspended() + 4.0
    monkeypatch.setattr("pushfric_core.pushers.clock.suspended", lambda: slept)
    stage.fails(pusher, Suspended, r"this computer was suspended for 4\.\d s")
    rest = stage.rest()
    assert rest < 0.01 + DEAD_MAN + LATE
    assert pusher.doubt is not None
    with pytest.raises(NotReady):
        pusher.move_to(0.05, SPEED)
    assert stage.rest() == rest


def test_unevenness_is_that_of_the_middle_of_a_stroke():
    def at(position: float, speed: float) -> PusherReport:
        return PusherReport(position, speed, Mode.RUNNING, None)

    even = [at(position / 100, 0.02) for position in range(11)]
    assert unevenness(even, 0.0, 0.1) == 0.0
    assert unevenness([at(0.001, 0.0), *even, at(0.099, 0.001)], 0.0, 0.1) == 0.0
    varied = [at(0.03 + position / 200, (0.01, 0.03)[position % 2]) for position in range(8)]
    assert unevenness(varied, 0.0, 0.1) == pytest.approx(0.5)
    assert unevenness(varied, 0.1, 0.0) == pytest.approx(0.5)
    assert unevenness(varied[:4], 0.0, 0.1) == 0.0  # too few


def test_a_position_that_jumps_for_good_is_no_position_any_more(stage):
    """For example after a power cut, if the greeting was lost."""
    pusher = under_way(stage)
    stage.line.to_host = once(b"Grbl 1.1h", b"")
    stage.controller.reset()
    error = stage.fails(pusher, (Jumped, LeftTheWay))
    assert pusher.doubt is not None
    assert error.fault.name in ("POSITION", "WAY")


def test_a_report_of_rest_without_a_place_ends_no_stroke(stage):
    """The stroke was over 2 micrometres short, where the report before saw it, in motion."""
    pusher = under_way(stage, 0.02)
    first = iter([(b"<Idle|MPos:20.000", b"<Run|MPos:19.998")])

    def spoil(data: bytes) -> bytes:
        return data.replace(*next(first, (b"|MPos", b"|MPoos"))) if b"<Idle|MPos:20.000" in data else data

    stage.line.to_host = spoil
    stage.drive(pusher, lambda: not pusher.busy or pusher.dropped > 2)
    stage.line.heal()
    stage.drive(pusher, lambda: not pusher.busy)
    assert pusher.axis.last.position == pytest.approx(0.02, abs=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_random_damage_of_the_line_leads_no_pusher_astray(stage, seed):
    """A sample: `pushfric rehearse --damage` does it as often as it is told, on any controller."""
    end, damage = 0.02, random_damage(seed)
    pusher = under_way(stage, end, silence=0.5)
    places = [stage.controller.position()]
    stage.line.heard = lambda data: places.append(stage.controller.position())
    damage.begin(stage.line)
    reports = stage.outlast(pusher)
    time.sleep(damage.delay)
    stage.line.heal()
    reports += stage.outlast(pusher, 60.0)
    rest = stage.rest()
    assert stage.rest() == rest
    astray = 0.002 + DEAD_MAN + LATE if damage.to_controller else 1e-9
    assert places[0] - astray <= min(places)
    assert max(places) <= end + astray
    plausible = 2.5e-3
    assert all(min(places) - plausible <= report.position <= max(places) + plausible for report in reports)
    if pusher.doubt is None and pusher.mode is not Mode.ALARM:
        stage.drive(pusher, lambda: not pusher.line._is_asked)
        assert pusher.axis.last.position == pytest.approx(rest, abs=1e-6)


@pytest.mark.parametrize(("old", "new"), [(b"$13=0", b"$13=1"), (b"$13=0\r\n", b""), (b"$110=6", b"$110=9")])
def test_a_setting_that_was_damaged_on_its_way_is_asked_for_again(stage, old, new):
    """One setting, for example, is the unit of all positions."""
    stage.line.to_host = once(old, new)
    pusher = stage.driver()
    stage.line.to_host = bytes
    assert pusher.settings["$13"] == "0"
    assert pusher.limits.max_speed == pytest.approx(0.1)


def test_settings_that_never_come_twice_alike_are_none(stage):
    numbers = iter(range(10, 1000))
    stage.line.to_host = lambda data: data.replace(b"$110=6", b"$110=%d" % next(numbers))
    with pytest.raises(NotConnected, match=r"its settings \(\$\$\) came 6 times, each time different"):
        stage.driver()


def test_a_position_that_was_damaged_while_connecting_is_not_believed(stage):
    """This holds for each of the reports."""
    for damaged in range(8):
        count = iter(range(1000))

        def wrong(data: bytes, damaged: int = damaged, count: Iterator[int] = count) -> bytes:
            return data.replace(b"MPos:0", b"MPos:7") if b"MPos" in data and next(count) == damaged else data

        stage.line.to_host = wrong
        pusher = stage.driver()
        assert pusher.axis.last.position == 0.0
        pusher.close()


def test_a_restart_in_the_middle_of_a_report_is_heard(stage):
    pusher = under_way(stage)
    stage.line.to_host = once(b"|FS:", b"Grbl 1.1h ['$' for help]\r\n")
    stage.fails(pusher, NotConnected, "restarted")


def test_what_is_plausible():
    plausibility = Plausibility()
    assert plausibility.judge(0.01, 0.0, 0.01, SPEED, 0.1, 0.1) == (True, None)
    assert plausibility.judge(0.0105, 0.02, 0.03, SPEED, 0.1, 0.1) == (True, None)
    assert plausibility.judge(0.0405, 0.04, 0.05, SPEED, 0.1, 0.1) == (False, None)  # a wrong digit
    assert plausibility.judge(0.0109, 0.06, 0.07, SPEED, 0.1, 0.1) == (True, None)
    assert plausibility.judge(0.0135, 0.08, 0.09, SPEED, 0.1, 0.1) == (False, None)
    assert plausibility.judge(0.0150, 0.10, 0.11, SPEED, 0.1, 0.1) == (True, None)  # it moves faster than it was sent
    assert plausibility.judge(0.0, 0.12, 0.13, SPEED, 0.1, 0.1) == (False, None)
    assert plausibility.judge(0.0, 0.14, 0.15, SPEED, 0.1, 0.1) == (True, 0.0150)  # there it is, and cannot have gone
    assert plausibility.dropped == 3


@pytest.mark.parametrize("forward", [1.0, -1.0])
def test_what_is_plausible_in_a_stroke(forward):
    """A pusher that was sent forward has not come back."""
    plausibility = Plausibility()

    def believed(place: float, when: float) -> bool:
        return plausibility.judge(forward * place, when, when + 0.01, SPEED, 0.1, 0.1, forward)[0]

    assert believed(0.0100, 0.00)
    assert not believed(0.0085, 0.02)
    assert believed(0.0112, 0.04)
    assert believed(0.0108, 0.06)  # as near as two reports of one moment
    assert plausibility.dropped == 1


def test_the_bytes_that_are_ever_sent(stage):
    """No setting is changed, and nothing but a jog moves; see docs/hardware.md."""
    sent = stage.listen()
    pusher = under_way(stage, 0.03)
    stage.carry_out(pusher, pusher.stop)
    stage.controller.hit_limit()
    stage.fails(pusher, PusherError, "ALARM:1")
    stage.carry_out(pusher, pusher.recover)
    stage.push(pusher, 0.0)
    pusher.close()
    lines = bytes(sent).translate(None, b"?!\x85\x18\x90").split(b"\n")
    jogs = [line for line in lines if re.fullmatch(rb"\$J=G21G90X-?\d+\.\d{3}F1200\.000", line)]
    assert len(jogs) > 5
    assert set(lines) - set(jogs) == {b"$I", b"$$", b"$#", b"$G", b"$X", b""}


def test_the_line_dtr_stays_as_it_is_when_the_host_dies(stage):
    import termios

    pusher = stage.driver()
    assert not termios.tcgetattr(pusher.line._port.fd)[2] & termios.HUPCL
    pusher.close()
    assert os.path.exists(stage.line.port)
