"""The answers of the simulated firmware compared with those of real firmware, and the driver's reading of both.

Each `answers_*.json` holds a dialogue with the simulator of a real firmware, as [how, sent, answered lines]. `how` is "go" to
go on at once, "wait" to wait for the end of a motion, and "held" if there is no answer yet. Input pins are left out.
"""

import json
import os
import pathlib
import re
import time

import pytest

from pushfric_core.pushers.grbl_protocol import ALARM, BUILD, ERROR, GREETING, SETTING, STATES, parse_status
from pushfric_core.simulated.grbl_firmware import SimulatedGrbl

GRBL, GRBLHAL = (
    json.loads((pathlib.Path(__file__).parent / f"answers_{kind}.json").read_text()) for kind in ("grbl", "grblhal")
)
SAME_SETTINGS = ("$10=3", "$110=6000", "$120=500", "$130=100", "$20=0", "$21=0", "$22=0", "$23=0", "$25=500",
                 "$111=500", "$112=500", "$121=10", "$122=10", "$131=200", "$132=200")  # fmt: skip
SECONDS = {"go": 0.06, "wait": 1.4, "held": 0.3, "": 0.3}
NOT_THERE = {"G10L20P1X0\n", "G10L2P1X0\n", "G92X1\n", "G92.1\n", "G43.1Z1\n"}
"""Offsets: the simulated firmware does not have them, and says so (error:20)."""
FEED_IN_INCHES = "[GC:G1 G54 G17 G20 G90 G94 M5 M9 T0 F1200 S0]"
"""Real firmware shows the number of the feed as it was given in millimetres until the next F."""
MOVED = {"in a jog", "in a line", "reset in a line", "reset in a jog", "queue"}
"""Sections in which a position depends on when something was sent."""


class Terminal:
    """A serial terminal whose user waits for each answer, and holds the clock of the motion."""

    def __init__(self) -> None:
        self.now = 100.0
        self.controller = SimulatedGrbl(lambda: self.now, restarts=False)
        self._fd = -1
        self._heard = b""

    def __enter__(self) -> "Terminal":
        self.controller.start()
        self._fd = os.open(self.controller.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        for line in SAME_SETTINGS:
            assert self.say(line + "\n", 1) == ["ok"]
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._fd)
        self.controller.close()

    def say(self, text: str, count: int, how: str = "") -> list[str]:
        """Send a text, wait for `count` lines, and let time pass; return all lines that came."""
        os.write(self._fd, text.encode("latin1"))
        lines = self._lines(count, reports=text == "?")
        if not count and how != "held" and not self.controller._deaf and self.controller._state != "Sleep":
            os.write(self._fd, b"?")  # what needs no answer has been read when this is answered
            lines = [line for line in self._lines(1, reports=True) if not line.startswith("<")]
        self.now += SECONDS[how]
        return lines

    def _lines(self, count: int, reports: bool) -> list[str]:
        """All lines until `count` have come; status reports count only if they are what was asked for: one may come late."""
        deadline = time.monotonic() + 60
        while True:
            found = [line for line in self._heard.decode().split("\r\n")[:-1] if line]
            if sum(reports or not line.startswith("<") for line in found) >= count:
                break
            assert time.monotonic() < deadline, f"{count} lines expected, got {found}"
            try:
                self._heard += os.read(self._fd, 4096)
            except BlockingIOError:
                time.sleep(0.001)
                self.now += 1e-4  # a full planner gets room
        self._heard = b""
        return found


def shape(report: str, with_place: bool) -> object:
    """A status report without what depends on how many came before it, and on the moment."""
    state, *fields = report.strip("<>").split("|")
    kept = [field for field in fields if not field.startswith(("WCO", "Ov", "Pn"))]
    return state, kept if with_place and state in ("Idle", "Alarm", "Check") else [field.partition(":")[0] for field in kept]


@pytest.mark.parametrize("section", GRBL["sections"])
def test_the_simulated_firmware_answers_as_real_grbl_does(section):
    with Terminal() as terminal:
        for how, sent, answered in GRBL["sections"][section]:
            said = terminal.say(sent, len(answered), how)
            if sent in NOT_THERE:
                assert said == ["error:20"], sent
            elif FEED_IN_INCHES in answered:
                assert said == [FEED_IN_INCHES.replace("F1200", "F47"), "ok"]
            elif sent == "?":
                assert len(said) == len(answered)  # no answers while a reset is demanded
                assert not said or shape(said[0], section not in MOVED) == shape(answered[0], section not in MOVED), (
                    sent,
                    said,
                )
            else:
                assert [line for line in said if not line.startswith("<")] == answered, sent


@pytest.mark.parametrize("recorded", [GRBL, GRBLHAL], ids=["grbl", "grblhal"])
def test_the_driver_understands_all_that_real_firmware_said(recorded):
    lines = [line for steps in recorded["sections"].values() for _, _, answered in steps for line in answered]
    known = (ALARM.fullmatch, ERROR.fullmatch, GREETING.search, SETTING.match, parse_status)
    for line in lines:
        if line.startswith("<"):
            status = parse_status(line)
            assert status is not None, line
            assert status.state in STATES
            assert status.machine_position is not None or status.work_position is not None
        else:
            assert line == "ok" or line.startswith(("[", "$N")) or any(read(line) for read in known), line
    assert any(BUILD.match(line) for line in lines)
    assert re.search(r"1\.1[hf]", recorded["firmware"])
