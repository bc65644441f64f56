"""Random damage of a serial line: bytes that are lost, changed, repeated, delayed or made up, in either direction."""

import math
import random
import re
from collections.abc import Callable
from typing import NamedTuple

from pushfric_core.simulated.faulty_line import FaultyLine, Filter

SHARES = (0.003, 0.03, 0.2)
"""Shares of the bytes or pieces that are damaged."""
OFTEN = (1, 5, math.inf)
"""Largest numbers of damaged bytes or pieces."""
SHORTEST, LONGEST = 0.01, 3.0
"""Range of the delays [s]."""
SETTINGS = (13, 20, 22, 27, 100, 110, 120, 130)
ABSURD = (b"0", b"-1", b"1e999", b"nan", b"inf", b"", b"abc", b"9" * 4300, b"0.000001", b"25.4")
SAID = (
    b"Grbl 1.1h ['$' for help]\r\n",
    b"\r\nGrbl 1.1h ['$' for help]\r\n",
    b"ok\r\n",
    b"error:9\r\n",
    b"error:" + b"9" * 4300 + b"\r\n",
    b"ALARM:1\r\n",
    b"ALARM:" + b"9" * 4300 + b"\r\n",
    b"<Jog|MPos:1e999,0.000,0.000|FS:1200,0>\r\n",
    b"<Idle|MPos:" + b"9" * 4300 + b",0.000,0.000|FS:0,0>\r\n",
    b"<Jog|MPos:nan,nan,nan|FS:nan,0>\r\n",
    b"<Idle|WPos:7.000,0.000,0.000|FS:0,0>\r\n",
    b"<Hold:0|MPos:4.000,0.000,0.000|FS:0,0|WCO:9.000,0.000,0.000>\r\n",
    b"[MSG:Pgm End]\r\n",
    b"$13=1\r\n",
    b"\x00\xff\x80",
    b"\r\n",
)
"""Lines that the controller did not send."""


def straying(axis: int, way: Callable[[], float]) -> Filter:
    """A filter that reports another place of an axis, by its number, than the controller does: by this way [mm]."""

    def moved(match: re.Match[bytes]) -> bytes:
        places = match[1].split(b",")
        places[axis] = b"%.3f" % (float(places[axis]) + way())
        return b"Pos:" + b",".join(places)

    return lambda data: re.sub(rb"Pos:([-.\d]+(?:,[-.\d]+)+)", moved, data)


class LineDamage(NamedTuple):
    """A kind of damage to a line."""

    name: str
    begin: Callable[[FaultyLine], None]
    delay: float = 0.0  # how late bytes that are held back arrive [s]
    to_controller: bool = False  # whether bytes on the way to the controller are damaged


Kind = Callable[[random.Random], LineDamage]


def random_damage(seed: int) -> LineDamage:
    """Damage of a random kind; only the seed and the traffic decide which bytes it hits."""
    randomly = random.Random(seed)
    return randomly.choice(KINDS)(randomly)


def _kind(unit: str, what: str, change: Callable[[random.Random, bytes], bytes]) -> Kind:
    """A kind of damage to single "bytes", or to "pieces": all bytes that come at once, about one line or report."""

    def kind(randomly: random.Random) -> LineDamage:
        name, hits = _now_and_then(randomly)

        def filtered(data: bytes) -> bytes:
            parts = [data[k : k + 1] for k in range(len(data))] if unit == "bytes" else [data]
            return b"".join(change(randomly, part) if hits() else part for part in parts)

        name = name.format(f"{unit} {what}")
        if randomly.random() < 0.5:
            return LineDamage(f"to the controller: {name}", lambda line: setattr(line, "to_controller", filtered), 0.0, True)
        return LineDamage(f"to the host: {name}", lambda line: setattr(line, "to_host", filtered))

    return kind


def _now_and_then(randomly: random.Random) -> tuple[str, Callable[[], bool]]:
    """How often something is hit, as a name into which it goes, and whether the next one is."""
    share, most = randomly.choice(SHARES), randomly.choice(OFTEN)
    left = most

    def hits() -> bool:
        nonlocal left
        hit = left > 0 and randomly.random() < share
        left -= hit
        return hit

    return f"{100 * share:g} % of the {{}}, " + (f"at most {most:g}" if math.isfinite(most) else "for good"), hits


def _delayed(randomly: random.Random) -> LineDamage:
    seconds = math.exp(randomly.uniform(math.log(SHORTEST), math.log(LONGEST)))
    if randomly.random() < 0.5:
        begin = lambda line: setattr(line, "delay_to_controller", seconds)  # noqa: E731
        return LineDamage(f"to the controller: {seconds:.2f} s late", begin, seconds, True)
    return LineDamage(f"to the host: {seconds:.2f} s late", lambda line: setattr(line, "delay_to_host", seconds), seconds)


def _jittering(randomly: random.Random) -> LineDamage:
    longest = randomly.choice((0.05, 0.15, 0.5))

    def begin(line: FaultyLine) -> None:
        def held(data: bytes) -> bytes:
            line.delay_to_host = randomly.uniform(0.0, longest)
            return data

        line.to_host = held

    return LineDamage(f"to the host: up to {longest:g} s late", begin, longest)


def _echoed(randomly: random.Random) -> LineDamage:
    def begin(line: FaultyLine) -> None:
        def heard_twice(data: bytes) -> bytes:
            line.tell_host(data)
            return data

        line.to_controller = heard_twice

    return LineDamage("to the host: an echo of all that it sends", begin)


def _said(randomly: random.Random) -> LineDamage:
    said = randomly.choice(SAID)
    name, hits = _now_and_then(randomly)

    def filtered(data: bytes) -> bytes:
        if not hits():
            return data
        place = randomly.randrange(len(data) + 1)
        return data[:place] + said + data[place:]

    what = said.strip()[:30].decode("ascii", errors="replace")
    return LineDamage(f"to the host: {what!r} in {name.format('pieces')}", lambda line: setattr(line, "to_host", filtered))


def _absurd(randomly: random.Random) -> LineDamage:
    number, value = randomly.choice(SETTINGS), randomly.choice(ABSURD)
    key = b"$%d=" % number
    return LineDamage(
        f"to the host: the setting {(key + value[:10]).decode()}",
        lambda line: setattr(line, "to_host", in_lines(key, value)),
    )


def in_lines(key: bytes, value: bytes) -> Filter:
    """A filter that gives a setting another value, however the bytes are split into pieces."""
    left = b""

    def filtered(data: bytes) -> bytes:
        nonlocal left
        *lines, left = (left + data).split(b"\n")
        if not left.startswith(b"$"):  # all else passes at once
            lines, left = [*lines, left], b""
            return b"\n".join(key + value + b"\r" if line.startswith(key) else line for line in lines)
        return b"".join((key + value + b"\r" if line.startswith(key) else line) + b"\n" for line in lines)

    return filtered


def _digit(randomly: random.Random, byte: bytes) -> bytes:
    return b"%d" % randomly.randrange(10) if byte.isdigit() else byte


KINDS: tuple[Kind, ...] = (
    _kind("bytes", "lost", lambda randomly, byte: b""),
    _kind("bytes", "changed", lambda randomly, byte: randomly.randbytes(1)),
    _kind("bytes", "with a wrong bit", lambda randomly, byte: bytes((byte[0] ^ 1 << randomly.randrange(8),))),
    _kind("bytes", "repeated", lambda randomly, byte: 2 * byte),
    _kind("bytes", "wrong if digits", _digit),
    _kind("pieces", "repeated", lambda randomly, data: 2 * data),
    _kind("pieces", "lost", lambda randomly, data: b""),
    _kind("pieces", "cut off", lambda randomly, data: data[: randomly.randrange(len(data) + 1)]),
    _delayed,
    _jittering,
    _echoed,
    _said,
    _absurd,
)
