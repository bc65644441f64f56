"""The GRBL driver against a scripted controller, byte by byte, and against the simulated firmware."""

import itertools
import os
import re
import time
from collections.abc import Callable, Iterator

import pytest
from calls import wait_until

from pushfric_core.pushers.axis_reports import StatusReport
from pushfric_core.pushers.grbl_protocol import RealTime, parse_status
from pushfric_core.pushers.pusher import Halted, Held, Limits, Mode, NotConnected, NotReady, PusherReport, Timeout
from pushfric_core.pushers.serial_config import GrblConfig
from pushfric_core.pushers.serial_line import Refused
from pushfric_core.pushers.serial_pusher import SerialPusher
from pushfric_core.simulated.serial_controller import pseudo_terminal

GREETING = "\r\nGrbl 1.1h ['$' for help]\r\n"
SETTINGS = "$20=0\r\n$22=0\r\n$100=250.000\r\n$110=6000.000\r\n$120=500.000\r\n$130=200.000\r\n"
IDLE = "<Idle|MPos:0.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>"
JOG = b"\x90$J=G21G90X1.500F1200.000\n"
"""A stroke so short that `begin_move` sends it as one piece."""
ASKED, ASKED_AGAIN = b"$I\n$$\n$$\n$#\n$G\n", b"$#\n$G\n"
"""What a driver asks when it connects, and after a reset."""
PATIENT = {"silence": 10.0}
"""Silence allowed on a busy machine, in tests that are not about silence."""


class Peer:
    """A controller whose answers the test scripts; it serves when called, in the thread of the test."""

    def __init__(self) -> None:
        self._master, self._slave, self.port = pseudo_terminal()
        self.heard = b""  # everything except status queries
        self.status = IDLE
        self.replies = {b"$I": "[VER:1.1h.20190830:]\r\n[OPT:V,15,128]\r\nok\r\n", b"$$": SETTINGS + "ok\r\n"}
        self.on_reset = GREETING
        self._line = b""

    def say(self, text: str | bytes) -> None:
        os.write(self._master, text.encode() if isinstance(text, str) else text)

    def serve(self) -> None:
        try:
            data = os.read(self._master, 4096)
        except BlockingIOError:
            return
        for byte in data:
            one = bytes((byte,))
            if one == b"?":
                status = self.status() if callable(self.status) else self.status
                self.say(status and status + "\r\n")
                continue
            self.heard += one
            if one == b"\x18":
                self.say(self.on_reset)
            elif one == b"\n":
                self.say(self.replies.get(self._line, "ok\r\n"))
                self._line = b""
            elif one not in (b"!", b"\x85", b"\x90"):
                self._line += one

    def hear(self, wanted: bytes) -> None:
        """Serve until this was heard: a pty hands bytes over a moment after they were written."""
        wait_until(lambda: self.serve() or wanted in self.heard, wanted, 60.0)


@pytest.fixture
def peer() -> Iterator[Peer]:
    peer = Peer()
    yield peer
    os.close(peer._slave)
    os.close(peer._master)


def drive(pusher: SerialPusher, until: Callable[[], object], peer: Peer, ask: bool = True) -> list[PusherReport]:
    """Poll, with a status query now and then, until a condition holds; return the reports received."""
    reports = []
    deadline = time.monotonic() + 60.0
    turn = 0
    while not until():
        assert time.monotonic() < deadline, f"not within a minute: {pusher.mode}, busy {pusher.busy}"
        peer.serve()
        report = pusher.poll()
        if report is not None:
            reports.append(report)
        turn += 1
        if ask and turn % 4 == 0:
            pusher.ask(turn)
        time.sleep(0.001)
    return reports


def rest(pusher: SerialPusher, peer: Peer, status: str | None = None) -> None:
    """Poll until the pusher rests; from now on, the controller reports the status, if one is given."""
    peer.status = peer.status if status is None else status
    drive(pusher, lambda: not pusher.busy, peer)


def fail(pusher: SerialPusher, error: type[Exception], text: str, peer: Peer) -> None:
    """Poll until an error is raised, and expect it to be this one."""
    with pytest.raises(error, match=text):
        drive(pusher, lambda: False, peer)


def fail_and_rest(pusher: SerialPusher, error: type[Exception], text: str, peer: Peer) -> None:
    """The same, and poll on until the pusher rests."""
    fail(pusher, error, text, peer)
    rest(pusher, peer)


def report_now(pusher: SerialPusher, peer: Peer, stamp: int = 5) -> PusherReport:
    """The answer to a status query sent after all others were answered."""
    drive(pusher, lambda: not pusher.line._is_asked, peer, ask=False)
    pusher.ask(stamp)
    return drive(pusher, lambda: not pusher.line._is_asked, peer, ask=False)[-1]


def driver(port: str, home: bool = False, only_look: bool = False, **settings) -> SerialPusher:
    return SerialPusher(GrblConfig(port, **settings), home, only_look)


def greet(pusher: SerialPusher, peer: Peer, greeting: str = GREETING) -> None:
    """Connect a driver to a controller that greets it."""
    pusher.connect()
    peer.say(greeting)
    rest(pusher, peer)


def connect(peer: Peer, greeting: str = GREETING, **kwargs) -> SerialPusher:
    """A driver connected to a scripted controller."""
    pusher = driver(peer.port, connect_timeout=1.0, **PATIENT | kwargs)
    greet(pusher, peer, greeting)
    return pusher


def homing(peer: Peer) -> SerialPusher:
    """A driver that was told to recover, and homes."""
    peer.replies[b"$H"] = ""
    pusher = connect(peer, home=True)
    assert peer.heard == ASKED  # a connection does not move
    peer.heard = b""
    pusher.recover()
    drive(pusher, lambda: pusher.mode is Mode.HOMING and b"$H\n" in peer.heard, peer)
    return pusher


def begin_move(pusher: SerialPusher, peer: Peer, position: float = 0.0015, speed: float = 0.02) -> None:
    """A motion whose `ok` has come and which is reported to run."""
    peer.heard = b""
    pusher.move_to(position, speed)
    drive(pusher, lambda: peer.heard.endswith(b"\n") and pusher.line.pending is None, peer, ask=False)
    if position == 0.0015:
        peer.status = "<Jog|MPos:0.500,0.000,0.000|FS:1200,0>"
        drive(pusher, lambda: pusher.axis.status.state == "Jog" and pusher.axis.last.position == 0.0005, peer)


def under_way(peer: Peer, **kwargs) -> SerialPusher:
    """A driver connected to a scripted controller, in the motion of `begin_move`."""
    pusher = connect(peer, **kwargs)
    begin_move(pusher, peer)
    return pusher


@pytest.mark.parametrize(
    ("line", "status"),
    [
        (
            "<Idle|MPos:0.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>",  # GRBL 1.1h
            StatusReport("Idle", None, (0.0, 0.0, 0.0), work_offset=(0.0, 0.0, 0.0), feed=0.0),
        ),
        (
            "<Run|MPos:23.036,1.620,0.000|Bf:14,127|FS:500,8000|Ov:100,100,100|A:SFM>",
            StatusReport("Run", None, (23.036, 1.62, 0.0), feed=500.0,
                         overrides=(100, 100, 100)),
        ),
        (
            "<Hold:1|WPos:-2.500,0.000,11.000|Bf:15,128|Ln:99999|F:350|Pn:XYZPDHRS>",
            StatusReport("Hold", 1, work_position=(-2.5, 0.0, 11.0), feed=350.0, pins="XYZPDHRS"),
        ),
        ("<Door:3|MPos:0.000,0.000,0.000|FS:0,0>", StatusReport("Door", 3, (0.0, 0.0, 0.0), feed=0.0)),
        (
            "<Idle|MPos:0.000,0.000,0.000,0.000|Bf:100,1023|FS:0,0,0|Pn:|WCO:0.000,0.000,0.000,0.000|WCS:G54|H:0|SD:0|FW:grblHAL>",
            StatusReport("Idle", None, (0.0,) * 4, work_offset=(0.0,) * 4, feed=0.0),  # grblHAL
        ),
        ("<Alarm:11|MPos:0.0000,0.0000,0.0000|FS:0,0>", StatusReport("Alarm", 11, (0.0, 0.0, 0.0), feed=0.0)),
        ("?<Home>", StatusReport("Home")),
    ],
)  # fmt: skip
def test_a_status_report_is_understood_field_by_field(line, status):
    assert parse_status(line) == status


def test_connecting_asks_who_and_how(peer):
    pusher = connect(peer)
    assert peer.heard == ASKED
    assert pusher.mode is Mode.IDLE
    assert pusher.name == f"Grbl 1.1h.20190830 at {peer.port}"
    assert pusher.limits == Limits(float("inf"), pytest.approx(0.1), pytest.approx(0.5))


def test_the_travel_counts_if_the_controller_enforces_it(peer):
    peer.replies[b"$$"] = SETTINGS.replace("$20=0", "$20=1") + "ok\r\n"
    assert connect(peer).limits.travel == pytest.approx(0.2)


def test_homing_ends_inside_the_travel(peer):
    peer.replies[b"$$"] = SETTINGS.replace("$20=0", "$20=1") + "$22=1\r\n$27=2.000\r\nok\r\n"
    assert connect(peer).limits.travel == pytest.approx(0.198)  # the pull-off is lost


def test_a_controller_that_reports_no_limits_has_none(peer):
    peer.replies[b"$$"] = "$110=n/a\r\nok\r\n"
    assert connect(peer).limits == Limits(float("inf"), float("inf"), float("inf"))


@pytest.mark.parametrize(
    "greeting", ["GrblHAL 1.1f ['$' or '$HELP' for help]\r\n", "Grbl 3.7 [FluidNC v3.7.8 '$' for help]\r\n"]
)
def test_compatible_firmware_is_accepted(peer, greeting):
    assert connect(peer, greeting).mode is Mode.IDLE


FLUIDNC = {
    b"$I": "[VER:4.0 FluidNC v4.0.5 (esp32-wifi) :]\r\n[OPT:PHS]\r\n[MSG:INFO: Machine: stage]\r\nok\r\n",
    b"$$": "$13=0\r\n$10=1\r\n$22=0\r\n$20=1\r\n$100=80.000\r\n$101=80.000\r\n$110=6000.000\r\n$111=6000.000\r\n"
    "$120=500.000\r\n$121=500.000\r\n$130=300.000\r\n$131=200.000\r\nok\r\n",
    b"$#": "".join(f"[{name}:0.000,0.000,0.000]\r\n" for name in ("G54", "G55", "G59.3", "G28", "G30", "G92", "TLO"))
    + "ok\r\n",
    b"$G": "[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]\r\nok\r\n",
    b"$/axes/y/soft_limits": "$/axes/y/soft_limits=false\r\nok\r\n",
}
"""What FluidNC answers, by its source."""


@pytest.mark.parametrize(
    ("axis", "own", "travel"), [("X", "false", 0.3), ("Y", "false", float("inf")), ("Y", "true", 0.2), ("-Y", "true", 0.2)]
)
def test_the_soft_limits_of_fluidnc_are_those_of_the_axis(peer, axis, own, travel):
    """Its $20 is that of X, whatever the axis."""
    peer.replies |= FLUIDNC | {b"$/axes/y/soft_limits": f"$/axes/y/soft_limits={own}\r\nok\r\n"}
    pusher = connect(peer, "\r\nGrbl 4.0 [FluidNC v4.0.5 (esp32-wifi) '$' for help]\r\n", axis=axis)
    assert pusher.name.startswith("Grbl 4.0 FluidNC v4.0.5 (esp32-wifi)")
    assert pusher.limits == Limits(pytest.approx(travel), pytest.approx(0.1), pytest.approx(0.5))
    assert (b"soft_limits" in peer.heard) is (axis != "X")


def test_noise_at_boot_is_ignored(peer):
    noise = "\x00\xff\r\nerror:7\r\n$0=10\r\n$1=25\r\nok\r\n" + GREETING + "[MSG:Check Limits]\r\n>G20G54:ok\r\n>:error:7\r\n"
    peer.replies[b"$I"] = "$I\r\n[echo: $I]\r\n[VER:1.1f.20170131:bench 3]\r\nok\r\n"
    pusher = connect(peer, noise)
    assert pusher.mode is Mode.IDLE
    assert pusher.name.startswith("Grbl 1.1f.20170131")


def test_a_controller_that_runs_already_is_asked_and_not_reset(peer):
    pusher = connect(peer, "")
    assert peer.heard == ASKED
    assert pusher.mode is Mode.IDLE
    assert pusher.doubt is None


def test_a_controller_deaf_to_questions_is_held_and_reset_and_not_believed(peer):
    """GRBL is like this after a limit, and while it homes."""
    peer.status = ""
    pusher = driver(peer.port, connect_timeout=0.1)
    pusher.connect()
    drive(pusher, lambda: b"\x18" in peer.heard, peer)
    rest(pusher, peer, "<Alarm|MPos:0.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>")
    assert peer.heard == b"!\x85\x18" + ASKED
    assert pusher.mode is Mode.ALARM
    assert pusher.doubt == "it answered only after a reset"


def test_a_port_where_nothing_answers(peer, monkeypatch):
    monkeypatch.setattr("pushfric_core.pushers.grbl.RESET_PATIENCE", 0.1)
    peer.on_reset = peer.status = ""
    pusher = driver(peer.port, connect_timeout=0.1)
    pusher.connect()
    fail(pusher, NotConnected, "no GRBL controller answers at .*, 115200 baud", peer)
    assert pusher.mode is Mode.DISCONNECTED
    assert not pusher.busy


def test_a_place_that_is_never_the_same_twice_ends_the_connection(peer, monkeypatch):
    monkeypatch.setattr("pushfric_core.pushers.serial_pusher.REST_TIMEOUT", 0.3)
    pusher, places = driver(peer.port), itertools.cycle(("0.000", "0.003"))
    peer.status = lambda: f"<Idle|MPos:{next(places)},0.000,0.000|FS:0,0>"
    pusher.connect()
    fail(pusher, NotConnected, r"no two reports in a row gave the same place at rest within 0\.3 s", peer)


def test_an_old_grbl_is_refused(peer):
    with pytest.raises(NotConnected, match=r"Grbl 0\.9j at .* is too old, expected Grbl 1\.1"):
        connect(peer, "\r\nGrbl 0.9j ['$' for help]\r\n")


def test_a_port_that_is_not_there():
    with pytest.raises(NotConnected, match="no serial port at /dev/no_such_port"):
        driver("/dev/no_such_port").connect()


def test_a_port_in_use_is_left_alone(peer):
    pusher = connect(peer)
    with pytest.raises(NotConnected, match="cannot open"):
        driver(peer.port).connect()
    assert pusher.mode is Mode.IDLE


def test_a_pusher_that_is_not_connected_cannot_be_used():
    pusher = driver("/dev/no_such_port")
    with pytest.raises(NotConnected, match="is not open"):
        pusher.poll()
    with pytest.raises(NotConnected, match="is not open"):
        pusher.hold()
    with pytest.raises(NotConnected, match="the pusher is not connected: no controller at /dev/no_such_port"):
        pusher.recover()
    pusher.ask(1)
    pusher.stop()
    pusher.close()


def test_an_alarm_found_on_connecting_stays_until_a_person_says_otherwise(peer):
    peer.status = "<Alarm|MPos:0.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>"
    pusher = connect(peer, GREETING + "[MSG:'$H'|'$X' to unlock]\r\n")
    assert peer.heard == ASKED
    assert pusher.mode is Mode.ALARM
    pusher.recover()
    drive(pusher, lambda: b"$X" in peer.heard, peer)
    rest(pusher, peer, IDLE)
    assert pusher.mode is Mode.IDLE


def test_home_is_where_the_stroke_begins(peer):
    pusher = homing(peer)
    peer.say("ok\r\n")
    rest(pusher, peer, "<Idle|MPos:-199.000,0.000,0.000|FS:0,0>")
    assert peer.heard == b"\x18" + ASKED_AGAIN + b"$H\n"
    assert report_now(pusher, peer).position == pytest.approx(0.0)
    begin_move(pusher, peer, 0.001)
    assert peer.heard == b"\x90$J=G21G90X-198.000F1200.000\n"


def test_homing_that_fails_is_an_alarm_until_the_next_attempt(peer):
    pusher = homing(peer)
    peer.status = "<Alarm|MPos:0.000,0.000,0.000|FS:0,0>"
    peer.say("ALARM:8\r\n")
    fail_and_rest(pusher, Halted, "ALARM:8 Homing fail", peer)
    assert pusher.mode is Mode.ALARM


def test_homing_is_stopped_by_a_reset(peer):
    pusher = homing(peer)
    peer.heard, peer.on_reset = b"", "ALARM:6\r\n" + GREETING
    pusher.stop()
    rest(pusher, peer, "<Alarm|MPos:0.000,0.000,0.000|FS:0,0>")
    assert peer.heard == b"!\x85\x18" + ASKED_AGAIN
    assert pusher.mode is Mode.ALARM


def test_a_move_is_a_jog_that_trusts_no_modal_state_and_no_override(peer):
    pusher = under_way(peer)
    assert peer.heard == JOG
    assert pusher.busy
    peer.status = "<Jog|MPos:0.700,0.000,0.000|FS:1200,0|Ov:200,100,100>"
    drive(pusher, lambda: peer.heard == JOG + b"\x90", peer)
    rest(pusher, peer, "<Idle|MPos:1.500,0.000,0.000|FS:0,0|Ov:100,100,100>")
    assert report_now(pusher, peer) == (pytest.approx(0.0015), 0.0, Mode.IDLE, 5)


def test_a_piece_that_came_too_late_to_be_a_jog_is_sent_again(peer):
    """At the very end of the jog before, GRBL runs a piece as a line, and takes no jog until it is done."""
    pusher = connect(peer)
    peer.replies[JOG[1:-1]] = "error:8\r\n"
    peer.heard, peer.status = b"", "<Run|MPos:0.000,0.000,0.000|FS:0,0>"
    pusher.move_to(0.0015, 0.02)
    drive(pusher, lambda: peer.heard == JOG and pusher.line.pending is None, peer)
    del peer.replies[JOG[1:-1]]
    peer.status = IDLE
    drive(pusher, lambda: peer.heard == JOG + JOG[1:], peer)
    rest(pusher, peer, "<Idle|MPos:1.500,0.000,0.000|FS:0,0>")


def test_an_axis_that_runs_backwards(peer):
    peer.status = "<Idle|MPos:0.000,-4.000,0.000|FS:0,0|WCO:0.000,6.000,0.000>"
    pusher = connect(peer, axis="-Y")
    assert report_now(pusher, peer).position == pytest.approx(0.010)
    begin_move(pusher, peer, 0.0105, 0.01)
    assert peer.heard == b"\x90$J=G21G90Y-10.500F600.000\n"


def test_the_work_offset_is_waited_for_and_remembered(peer):
    late = driver(peer.port)
    late.connect()
    peer.status = "<Idle|MPos:10.000,0.000,0.000|FS:0,0>"
    peer.say(GREETING)
    drive(late, lambda: late.axis.statuses >= 3, peer)
    assert late.mode is Mode.DISCONNECTED
    peer.status = "<Idle|MPos:10.000,0.000,0.000|FS:0,0|WCO:10.000,0.000,0.000>"
    drive(late, lambda: not late.busy, peer)
    peer.status = "<Idle|MPos:10.000,0.000,0.000|FS:0,0>"
    assert report_now(late, peer).position == pytest.approx(0.0)


def test_reports_in_inches(peer):
    peer.replies[b"$$"] = SETTINGS + "$13=1\r\nok\r\n"
    peer.status = "<Idle|WPos:0.0000,0.0000,0.0000|FS:0,0>"
    pusher = connect(peer)
    peer.heard = b""
    pusher.move_to(0.0015, 0.02)
    drive(pusher, lambda: peer.heard.endswith(b"\n"), peer, ask=False)
    peer.status = "<Jog|WPos:0.0200,0.0000,0.0000|FS:47.2,0>"
    report = drive(pusher, lambda: pusher.axis.status.state == "Jog", peer)[-1]
    assert report[:2] == (pytest.approx(0.000508), pytest.approx(0.01998, abs=1e-5))
    assert peer.heard == JOG


def test_the_speed_is_signed(peer):
    pusher = under_way(peer)
    assert pusher.axis.last[:2] == (pytest.approx(0.0005), pytest.approx(0.02))
    peer.status = "<Jog|MPos:0.300,0.000,0.000|FS:600,0>"
    assert drive(pusher, lambda: pusher.axis.last.position < 0.0004, peer)[-1].speed == pytest.approx(-0.01)


def test_without_a_feed_field_positions_and_stamps_give_the_speed(peer):
    pusher = connect(peer)
    for stamp, x in ((1_000_000_000, "0.100"), (1_500_000_000, "0.300")):
        peer.status = f"<Run|MPos:{x},0.000,0.000>"
        report = report_now(pusher, peer, stamp)
    assert report.speed == pytest.approx(0.0004)


def test_a_pusher_that_brakes_is_not_said_to_rest(peer):
    """A busy controller answered twice in one moment: its speed was published as 0, and it went on by 0.3 mm."""
    pusher = under_way(peer)
    peer.status = "<Hold:1|MPos:0.300,0.000,0.000|FS:0,0>"
    pusher.stop()
    for second, x in ((1, 0.3), (2, 0.5), (3, 0.5)):
        peer.status = f"<Hold:1|MPos:{x:.3f},0.000,0.000|FS:0,0>"
        report = report_now(pusher, peer, second * 10**9)
    assert report.speed == pytest.approx(0.0002)
    peer.status = "<Hold:0|MPos:0.500,0.000,0.000|FS:0,0>"
    assert report_now(pusher, peer, 4 * 10**9).speed == 0.0


def test_idle_right_after_ok_does_not_mean_arrival(peer):
    pusher = connect(peer)
    pusher.move_to(0.0015, 0.02)
    seen = pusher.axis.statuses
    drive(pusher, lambda: pusher.axis.statuses >= seen + 5, peer)
    assert pusher.busy
    rest(pusher, peer, "<Idle|MPos:1.504,0.000,0.000|FS:0,0>")  # within a motor step


def test_a_pusher_that_comes_to_rest_elsewhere(peer):
    pusher = under_way(peer)
    peer.status = "<Idle|MPos:1.000,0.000,0.000|FS:0,0>"
    rests = "the pusher rests at 0.0010 m, was sent to 0.0015 m"
    fail_and_rest(pusher, Held, f"held at the controller, or a line was lost: {rests}", peer)
    refuses(pusher)


def refuses(pusher: SerialPusher) -> None:
    """Nothing moves until a person has confirmed where the pusher stands."""
    with pytest.raises(NotReady, match="where the pusher stands is not known until it is recovered: "):
        pusher.move_to(0.01, 0.01)


PINS = {"D": "door", "H": "feed hold", "R": "reset", "E": "emergency stop", "M": "motor fault"}


@pytest.mark.parametrize(
    ("status", "why"),
    [
        ("<Hold:1|MPos:0.600,0.000,0.000|FS:600,0>", "it reports Hold"),
        ("<Hold:0|MPos:0.600,0.000,0.000|FS:0,0>", "it reports Hold"),
        ("<Door:2|MPos:0.600,0.000,0.000|FS:600,0>", "it reports Door"),
        ("<Tool|MPos:0.600,0.000,0.000|FS:0,0>", "it reports Tool"),
        ("<Jog|MPos:0.600,0.000,0.000|FS:1200,0|Pn:XY>", "its limit input Y became active"),
        *((f"<Jog|MPos:0.600,0.000,0.000|FS:1200,0|Pn:P{pin}>", f"its {name} input is active") for pin, name in PINS.items()),
    ],
)
def test_what_the_controller_does_by_itself_ends_a_stroke_for_good(peer, status, why):
    """A feed hold in mid-push was ignored: the next jog went out, and the push ended as if nothing had been."""
    peer.status = IDLE.replace(">", "|Pn:XP>")  # inputs that were active before, as of an axis without a switch
    pusher = connect(peer)
    assert pusher.doubt is None
    begin_move(pusher, peer)
    peer.heard, peer.status = b"", status
    fail(pusher, Held, f"held at the controller: {why}", peer)
    assert b"$J" not in peer.heard
    rest(pusher, peer, "<Idle|MPos:0.610,0.000,0.000|FS:0,0>")
    refuses(pusher)
    assert pusher.doubt == f"held at the controller: {why}"
    pusher.recover()
    rest(pusher, peer)
    assert pusher.doubt is None


def test_a_stroke_whose_pieces_were_discarded_is_not_continued(peer):
    """A feed hold that no report shows: GRBL cancels the jogs, idles, and would take the next one."""
    pusher = connect(peer)
    pusher.move_to(0.03, 0.02)
    peer.status = "<Jog|MPos:2.000,0.000,0.000|FS:1200,0>"
    drive(pusher, lambda: pusher.axis.last.position == 0.002, peer)
    peer.status = "<Idle|MPos:2.400,0.000,0.000|FS:0,0>"
    drive(pusher, lambda: pusher.axis.status.state == "Idle", peer)
    peer.heard = b""
    fail(pusher, Held, r"the pusher (rests at 0\.0024 m, was sent to 0\.0|slowed down at 0\.0024 m)", peer)  # on busy cores
    assert b"$J" not in peer.heard


def test_a_controller_that_does_not_report_is_not_said_to_stand_still(peer):
    pusher = connect(peer, silence=1.2)  # more than a pusher may stand still
    begin_move(pusher, peer)
    peer.status = ""
    fail(pusher, Timeout, "no report of .* in mid-stroke", peer)


def test_a_jog_that_stands_still_is_held(peer):
    """On grblHAL, a door that opens at the end of a jog leaves the state Jog, for ever."""
    pusher = under_way(peer, silence=3.0)
    fail_and_rest(pusher, Held, "the pusher stands still at 0.0005 m", peer)
    pusher.recover()
    rest(pusher, peer, IDLE.replace("0.000", "0.500", 1))
    begin_move(pusher, peer)
    peer.say("[MSG:Check Door]\r\n")
    fail(pusher, Held, 'held at the controller: it says "Check Door"', peer)


def test_a_controller_that_is_held_at_rest_asks_a_person(peer):
    pusher = connect(peer)
    peer.status = IDLE.replace(">", "|Pn:D>")
    fail_and_rest(pusher, Held, "held at the controller: its door input is active", peer)
    pusher.recover()
    fail_and_rest(pusher, Held, "its door input is active; release it, then reset", peer)
    peer.status = IDLE
    drive(pusher, lambda: pusher.axis.status.pins == "", peer)
    refuses(pusher)
    pusher.recover()
    rest(pusher, peer)
    assert pusher.doubt is None


def test_a_controller_found_held_is_not_believed(peer):
    peer.status = IDLE.replace(">", "|Pn:R>")
    pusher = connect(peer)
    assert pusher.doubt == "held at the controller: its reset input is active"
    pusher.close()
    peer.status = IDLE.replace("Idle", "Door:1")
    with pytest.raises(NotConnected, match="it reads nothing until it is released"):
        connect(peer)


def test_a_restart_at_rest_is_a_doubt_of_the_next_connection(peer):
    """The reset input, or the supply: nobody knows what happened to the motor meanwhile."""
    pusher = connect(peer)
    peer.say(GREETING)
    fail(pusher, NotConnected, "restarted", peer)
    greet(pusher, peer)
    assert pusher.doubt == "the controller restarted by itself: its reset input, or its supply"
    refuses(pusher)


def test_motions_are_refused_when_not_idle(peer):
    pusher = connect(peer)
    with pytest.raises(ValueError, match="speed must be positive, got 0"):
        pusher.move_to(0.01, 0)
    begin_move(pusher, peer)
    with pytest.raises(NotReady, match="the pusher's mode is running, expected idle"):
        pusher.move_to(0.01, 0.01)
    with pytest.raises(NotReady, match="the pusher's mode is running, expected a pusher at rest"):
        pusher.recover()


def test_a_stop_is_a_feed_hold_then_at_rest_a_reset(peer):
    pusher = under_way(peer)
    peer.heard = b""
    pusher.stop()
    pusher.stop()
    peer.status = "<Hold:1|MPos:0.600,0.000,0.000|FS:300,0>"
    seen = pusher.axis.statuses
    drive(pusher, lambda: pusher.axis.statuses >= seen + 4, peer)
    assert peer.heard.replace(b"!\x85", b"") == b""
    peer.status = "<Hold:0|MPos:0.610,0.000,0.000|FS:0,0>"
    drive(pusher, lambda: b"\x18" in peer.heard, peer)
    rest(pusher, peer, "<Idle|MPos:0.610,0.000,0.000|FS:0,0>")
    assert peer.heard.replace(b"!\x85", b"") == b"\x18" + ASKED_AGAIN
    assert pusher.mode is Mode.IDLE


def test_a_door_that_opens_during_a_stop_asks_a_person(peer):
    pusher = under_way(peer)
    pusher.stop()
    peer.status = "<Door:0|MPos:0.610,0.000,0.000|FS:0,0>"
    drive(pusher, lambda: b"\x18" in peer.heard, peer)
    rest(pusher, peer, "<Idle|MPos:0.610,0.000,0.000|FS:0,0>")
    assert pusher.doubt == "held at the controller: it reports Door"


@pytest.mark.parametrize(
    ("status", "doubt"),
    [
        ("<Door:0|MPos:0.610,0.000,0.000|FS:0,0|Pn:D>", "held at the controller: it reports Door"),
        (IDLE.replace("MPos:0", "MPos:190"), "cannot be believed: it was at 0.0006 m and then, at once, at 0.1900 m"),
    ],
)
def test_what_happens_during_the_reset_of_a_stop_asks_a_person_at_once(peer, status, doubt):
    """Once, the position counted as known until the reset gave up: by then, a motor without its supply was elsewhere."""
    pusher = connect(peer)
    peer.replies[b"$G"] = ""  # behind an open door, it reads no line
    begin_move(pusher, peer)
    pusher.stop()
    peer.status = "<Hold:0|MPos:0.610,0.000,0.000|FS:0,0>"
    drive(pusher, lambda: b"\x18" in peer.heard, peer)
    peer.status = "<Idle|MPos:0.610,0.000,0.000|FS:0,0>"
    drive(pusher, lambda: b"$G" in peer.heard, peer)
    assert pusher.doubt is None
    peer.status = status
    seen = pusher.axis.statuses
    drive(pusher, lambda: pusher.axis.statuses > seen + 4, peer)
    assert pusher.doubt.endswith(doubt)


def test_a_line_that_fluidnc_kept_is_not_carried_out_after_the_reset(peer):
    """FluidNC 4 executes what it had received; a feed hold makes it refuse that, and a second reset ends the hold."""
    peer.replies |= {b"$I": "[VER:4.0 FluidNC v4:]\r\nok\r\n", JOG[1:-1]: ""}
    pusher = connect(peer)
    peer.heard, peer.on_reset = b"", GREETING + "error:8\r\n"
    pusher.move_to(0.0015, 0.02)
    drive(pusher, lambda: peer.heard == JOG, peer)
    peer.say("[MSG:INFO: Check door]\r\n")
    fail_and_rest(pusher, Held, 'it says "Check door"', peer)
    assert peer.heard == JOG + b"!\x85" + b"\x18!\x85" + b"\x18" + ASKED_AGAIN


def test_a_refused_line_stops_and_is_named(peer):
    pusher = connect(peer)
    peer.heard = b""
    peer.replies[JOG[1:-1]] = "error:15\r\n"
    pusher.move_to(0.0015, 0.02)
    fail_and_rest(pusher, Refused, re.escape('"$J=G21G90X1.500F1200.000" refused: error:15 Travel exceeded'), peer)
    assert peer.heard == JOG + b"!\x85\x18" + ASKED_AGAIN


def test_after_a_limit_the_controller_accepts_only_a_reset(peer):
    """GRBL 1.1h does not even answer status queries then."""
    pusher = under_way(peer)
    peer.heard, peer.status = b"", ""
    peer.say("ALARM:1\r\n[MSG:Reset to continue]\r\n")
    fail(pusher, Halted, "ALARM:1 Hard limit", peer)
    drive(pusher, lambda: peer.heard == b"!\x85\x18", peer)
    rest(pusher, peer, "<Alarm|MPos:0.600,0.000,0.000|FS:0,0|Pn:X>")
    assert pusher.mode is Mode.ALARM


def test_a_reset_that_was_dropped_is_sent_again(peer):
    pusher = under_way(peer)
    peer.heard, peer.status, peer.on_reset = b"", "", ""
    peer.say("ALARM:2\r\n")
    fail(pusher, Halted, "ALARM:2 Soft limit", peer)
    drive(pusher, lambda: peer.heard == b"!\x85\x18", peer)
    peer.on_reset = GREETING
    rest(pusher, peer, "<Alarm|MPos:0.600,0.000,0.000|FS:0,0>")
    assert peer.heard == b"!\x85\x18\x18" + ASKED_AGAIN
    assert pusher.mode is Mode.ALARM


def test_a_stop_that_is_not_answered_leaves_the_port(peer, monkeypatch):
    monkeypatch.setattr("pushfric_core.pushers.grbl.RESET_PATIENCE", 0.1)
    pusher = under_way(peer, silence=2.0)
    peer.heard, peer.status = b"", ""
    pusher.stop()
    fail(pusher, NotConnected, "no answer to . within 2 s", peer)
    peer.hear(b"!\x85\x18")
    assert peer.heard.startswith(b"!\x85\x18")
    assert pusher.mode is Mode.DISCONNECTED


def test_an_alarm_whose_line_was_lost_is_seen_in_the_reports(peer):
    pusher = under_way(peer)
    peer.status = "<Alarm:1|MPos:0.600,0.000,0.000|FS:0,0|Pn:X>"
    fail(pusher, Halted, "ALARM:1 Hard limit", peer)
    assert pusher.mode is Mode.ALARM


@pytest.mark.parametrize("also", ["", "ALARM:11\r\n[MSG:Homing cycle required]\r\n"])  # grblHAL, $22=5
def test_a_restart_during_a_push_ends_the_connection(peer, also):
    pusher = under_way(peer)
    peer.say(GREETING + also)
    fail(pusher, NotConnected, "the controller at .* restarted", peer)
    assert pusher.mode is Mode.DISCONNECTED


def test_a_process_that_stood_still_moves_nothing_any_more(peer):
    """As after a SIGSTOP: the controller has long used up what it was sent."""
    pusher = under_way(peer)
    pusher._polled -= 10.1
    with pytest.raises(Timeout, match=r"this process stood still for 1\d\.\d\d s; silence is 10 s"):
        pusher.poll()
    peer.hear(b"!\x85")
    assert peer.heard.endswith(b"!\x85")


def test_a_write_that_succeeds_late_loses_nothing(peer, monkeypatch):
    """On a busy machine, a process can stand still for longer than a write may take, after the write has succeeded."""
    pusher = connect(peer)
    with monkeypatch.context() as patch:
        late = itertools.count(time.monotonic(), 1.0)
        patch.setattr("time.monotonic", lambda: next(late))
        patch.setattr("serial.serialutil.Timeout.TIME", time.monotonic)
        pusher.hold()
    peer.hear(RealTime.HOLD.value)
    assert peer.heard.endswith(RealTime.HOLD.value)


def test_a_port_that_takes_no_bytes_is_lost(peer):
    pusher = connect(peer)
    for write in (lambda: pusher.line.write(100_000 * b"?"), pusher.stop):
        with pytest.raises(NotConnected, match=r"lost .*: it takes no bytes for 0\.5 s"):
            write()
    assert pusher.mode is Mode.DISCONNECTED


def test_reconnecting_neither_moves_nor_homes(peer):
    pusher = connect(peer, home=True)
    pusher.close()
    peer.heard = b""
    peer.status = "<Alarm|MPos:0.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>"
    greet(pusher, peer)
    assert peer.heard == ASKED
    assert pusher.mode is Mode.ALARM
    with pytest.raises(NotReady, match="the pusher's mode is alarm, expected idle"):
        pusher.move_to(0.01, 0.01)
    pusher.recover()
    drive(pusher, lambda: b"$H\n" in peer.heard, peer)
