"""Random damage of a serial line: bytes that are lost, changed, repeated, delayed or made up, in either direction."""

import math
import random
from collections.abc import Callable
from typing import NamedTuple

from pushfric_ros.simulated.faulty_line import FaultyLine, Filter

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


class Damage(NamedTuple):
    """One kind of damage to a line."""

    name: str
    begin: Callable[[FaultyLine], None]
    delay: float = 0.0  # how late bytes that are held back arrive [s]
    to_controller: bool = False  # whether bytes on the way to the controller are damaged


def random_damage(seed: int) -> Damage:
    """Damage of a random kind; only the seed and the traffic decide which bytes it hits."""
    randomly = random.Random(seed)
    return randomly.choice(KINDS)(randomly)


def _of_bytes(what: str, change: Callable[[random.Random, int], bytes]) -> Callable[[random.Random], Damage]:
    """A kind of damage to single bytes."""

    def kind(randomly: random.Random) -> Damage:
        share, most = randomly.choice(SHARES), randomly.choice(OFTEN)
        left = most

        def filtered(data: bytes) -> bytes:
            nonlocal left
            passed = bytearray()
            for byte in data:
                hit = left > 0 and randomly.random() < share
                left -= hit
                passed += change(randomly, byte) if hit else bytes((byte,))
            return bytes(passed)

        return _one_way(f"{100 * share:g} % of the bytes {what}, {_at_most(most)}", filtered, randomly)

    return kind


def _of_pieces(what: str, change: Callable[[random.Random, bytes], bytes]) -> Callable[[random.Random], Damage]:
    """A kind of damage to all bytes that come at once: about one line or report."""

    def kind(randomly: random.Random) -> Damage:
        share, most = randomly.choice(SHARES), randomly.choice(OFTEN)
        left = most

        def filtered(data: bytes) -> bytes:
            nonlocal left
            hit = left > 0 and randomly.random() < share
            left -= hit
            return change(randomly, data) if hit else data

        return _one_way(f"{100 * share:g} % of the pieces {what}, {_at_most(most)}", filtered, randomly)

    return kind


def _at_most(most: float) -> str:
    return f"at most {most:g}" if math.isfinite(most) else "for good"


def _one_way(what: str, filtered: Filter, randomly: random.Random) -> Damage:
    if randomly.random() < 0.5:
        return Damage(f"to the controller: {what}", lambda line: setattr(line, "to_controller", filtered), to_controller=True)
    return Damage(f"to the host: {what}", lambda line: setattr(line, "to_host", filtered))


def _delayed(randomly: random.Random) -> Damage:
    seconds = math.exp(randomly.uniform(math.log(SHORTEST), math.log(LONGEST)))
    if randomly.random() < 0.5:
        begin = lambda line: setattr(line, "delay_to_controller", seconds)  # noqa: E731
        return Damage(f"to the controller: {seconds:.2f} s late", begin, seconds, True)
    return Damage(f"to the host: {seconds:.2f} s late", lambda line: setattr(line, "delay_to_host", seconds), seconds)


def _jittering(randomly: random.Random) -> Damage:
    longest = randomly.choice((0.05, 0.15, 0.5))

    def begin(line: FaultyLine) -> None:
        def held(data: bytes) -> bytes:
            line.delay_to_host = randomly.uniform(0.0, longest)
            return data

        line.to_host = held

    return Damage(f"to the host: up to {longest:g} s late", begin, longest)


def _echoed(randomly: random.Random) -> Damage:
    def begin(line: FaultyLine) -> None:
        def heard_twice(data: bytes) -> bytes:
            line.tell_host(data)
            return data

        line.to_controller = heard_twice

    return Damage("to the host: an echo of all that it sends", begin)


def _said(randomly: random.Random) -> Damage:
    said, share, most = randomly.choice(SAID), randomly.choice(SHARES), randomly.choice(OFTEN)
    left = most

    def filtered(data: bytes) -> bytes:
        nonlocal left
        if left <= 0 or randomly.random() >= share:
            return data
        left -= 1
        place = randomly.randrange(len(data) + 1)
        return data[:place] + said + data[place:]

    what = said.strip()[:30].decode("ascii", errors="replace")
    return Damage(
        f"to the host: {what!r} in {100 * share:g} % of the pieces, {_at_most(most)}",
        lambda line: setattr(line, "to_host", filtered),
    )


def _absurd(randomly: random.Random) -> Damage:
    number, value = randomly.choice(SETTINGS), randomly.choice(ABSURD)
    key = b"$%d=" % number
    return Damage(
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


def _digit(randomly: random.Random, byte: int) -> bytes:
    return b"%d" % randomly.randrange(10) if 0x30 <= byte <= 0x39 else bytes((byte,))


KINDS: tuple[Callable[[random.Random], Damage], ...] = (
    _of_bytes("lost", lambda randomly, byte: b""),
    _of_bytes("changed", lambda randomly, byte: randomly.randbytes(1)),
    _of_bytes("with a wrong bit", lambda randomly, byte: bytes((byte ^ 1 << randomly.randrange(8),))),
    _of_bytes("repeated", lambda randomly, byte: bytes((byte, byte))),
    _of_bytes("wrong if digits", _digit),
    _of_pieces("repeated", lambda randomly, data: 2 * data),
    _of_pieces("lost", lambda randomly, data: b""),
    _of_pieces("cut off", lambda randomly, data: data[: randomly.randrange(len(data) + 1)]),
    _delayed,
    _jittering,
    _echoed,
    _said,
    _absurd,
)
