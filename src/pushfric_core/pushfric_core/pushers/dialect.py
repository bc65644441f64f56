"""The dialect of a controller on a serial port: commands to bytes, and lines to events. It knows nothing of what is under way.

`SerialPusher` runs the table of states for any of them. What a controller is asked in its own way, when it is found and when it
is reset, is a script: it waits for answers by `yield from`, and uses the public names of the pusher that runs it.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from pushfric_core.pushers.axis_reports import StatusReport
from pushfric_core.pushers.driver import Script
from pushfric_core.pushers.pusher import Halted, Limits

if TYPE_CHECKING:
    from pushfric_core.pushers.serial_pusher import SerialPusher

Settings = Mapping[str, str]
"""A controller's settings, or the like, by the names that its dialect uses."""


def number(settings: Settings, name: str, otherwise: float = math.inf) -> float:
    """A setting; `otherwise` if the firmware keeps it elsewhere."""
    try:
        return float(settings[name])
    except (KeyError, ValueError):
        return otherwise


class Answer(NamedTuple):
    """The line that waits was accepted, or refused."""

    refusal: str = ""  # what follows the line in a sentence; empty: accepted
    passing: bool = False  # the same line may be accepted a little later
    resend: int | None = None  # the number that the next line must have


class Greeting(NamedTuple):
    """It has started."""

    version: str = ""


class Alarmed(NamedTuple):
    """It has stopped by itself, and moves no more."""

    code: int | None = None


class HeldBy(NamedTuple):
    """It says what holds it."""

    why: str


class Version(NamedTuple):
    """The name of what answered."""

    name: str


class Values(NamedTuple):
    """Settings or the like, as part of the answer to a line; at any other time they mean nothing."""

    line: str
    values: Settings


class Garbled(NamedTuple):
    """A report came damaged."""


Event = StatusReport | Answer | Greeting | Alarmed | HeldBy | Version | Values | Garbled


class Dialect(ABC):
    """The protocol of a kind of controller. An axis is named by its letter."""

    sign_of_life: ClassVar[str]
    """A trial for a person in a terminal, and what must be seen."""
    question: ClassVar[bytes]
    """Asks for a report."""
    homing_line: ClassVar[str]
    """Seeks the home switch; {axis} stands for the axis."""
    unlock_line = ""
    """Ends an alarm, if a line does."""
    before_stroke: tuple[str, ...] = ()
    """Lines that are sent before each stroke."""
    full_feed = b""
    """Ends an override of the feed."""
    in_order = False
    """All that is sent is answered in its order, questions and stops, too."""
    only_positions = False
    """Reports say where the axis is, but neither its state (it moves if two of them differ) nor its speed."""
    needs_for_truth = ""
    """The option without which the firmware reports where the axis will be; empty: it reports where it is."""
    idle_reports = 10
    """This many in a row that say so, away from the target, mean that a motion ended early."""
    deaf_after_stop = 0.0
    """The controller may answer nothing for this long after a stop [s]."""

    @abstractmethod
    def decode(self, raw: bytes) -> Event | None:
        """The meaning of a line, whatever it is; None: nothing to a pusher."""

    @abstractmethod
    def piece(self, axis: str, target: float, feed: float) -> str:
        """The line that moves the axis on to a coordinate [mm] at a speed [mm/min]."""

    @abstractmethod
    def hold(self, homing: bool) -> bytes:
        """Stops the axis at once, and keeps its position unless it is homing."""

    def last_words(self, homing: bool) -> bytes:
        """Stops the axis when the port is left in mid-motion."""
        return self.hold(homing)

    def line(self, text: str, number: int) -> bytes:
        """A line with its number; the first one is 1."""
        return text.encode() + b"\n"

    @abstractmethod
    def halted(self, code: int | None) -> Halted:
        """Why a controller in alarm has stopped."""

    @staticmethod
    @abstractmethod
    def settings_of(axis: str) -> tuple[str, str, str, str]:
        """The firmware's names of the greatest travel, speed and acceleration of an axis, and of its steps in a millimetre."""

    @abstractmethod
    def limits(self, settings: Settings, axis: str) -> Limits:
        """The limits that the settings say."""

    @abstractmethod
    def wrong_setting(self, settings: Settings, axis: str) -> str | None:
        """A setting with an impossible value, and what was expected; None: there is none."""

    # Scripts

    @abstractmethod
    def connect(self, pusher: "SerialPusher") -> Script:
        """Find out who answers, bring it to rest, and learn its settings and its place; see Phase.CONNECTING."""

    @abstractmethod
    def reset(self, pusher: "SerialPusher") -> Script:
        """Discard all that has been sent; the axis rests."""

    def brake(self, pusher: "SerialPusher") -> Script:
        """Wait until the axis rests after `hold`."""
        return pusher.brake()
