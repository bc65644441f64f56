"""Random damage of a serial line: bytes that are lost, changed, repeated, delayed or made up, in either direction."""

import math
import random
import re
from collections.abc import Callable, Sequence
from functools import partial
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


class LineDamage(NamedTuple):
    """A kind of damage to a line, in one direction."""

    name: str
    filtered: Callable[[FaultyLine], Filter] = lambda line: bytes
    delay: float = 0.0  # how late bytes that are held back arrive [s]
    way: str = "host"  # where the bytes go: to the "host" or to the "controller"

    @property
    def to_controller(self) -> bool:
        """Whether bytes on the way to the controller are damaged."""
        return self.way == "controller"

    def begin(self, line: FaultyLine) -> None:
        """Damage a line from now on."""
        line.damage(**{f"to_{self.way}": self.filtered(line)})
        setattr(line, f"delay_to_{self.way}", self.delay)


Kind = Callable[[random.Random], LineDamage]


def random_damage(seed: int) -> LineDamage:
    """Damage of a random kind; only the seed and the traffic decide which bytes it hits."""
    randomly = random.Random(seed)
    ways, kinds = randomly.choice(KINDS)
    damage, way = randomly.choice(kinds)(randomly), randomly.choice(ways)
    return damage._replace(name=f"to the {way}: {damage.name}", way=way)


def _now_and_then(what: str, change: Callable[[random.Random, bytes], bytes], randomly: random.Random) -> LineDamage:
    """Now and then, one of the bytes or pieces that come is changed."""
    share, most = randomly.choice(SHARES), randomly.choice(OFTEN)
    left = most

    def hit(part: bytes) -> bytes:
        nonlocal left
        if left <= 0 or randomly.random() >= share:
            return part
        left -= 1
        return change(randomly, part)

    def filtered(data: bytes) -> bytes:
        return b"".join(map(hit, [data[k : k + 1] for k in range(len(data))] if what.startswith("bytes") else [data]))

    often = f"at most {most:g}" if math.isfinite(most) else "for good"
    return LineDamage(f"{100 * share:g} % of the {what}, {often}", lambda line: filtered)


def _with(said: bytes, randomly: random.Random, data: bytes) -> bytes:
    place = randomly.randrange(len(data) + 1)
    return data[:place] + said + data[place:]


def _late(randomly: random.Random) -> LineDamage:
    seconds = math.exp(randomly.uniform(math.log(SHORTEST), math.log(LONGEST)))
    return LineDamage(f"{seconds:.2f} s late", delay=seconds)


def _jittering(randomly: random.Random) -> LineDamage:
    longest = randomly.choice((0.05, 0.15, 0.5))

    def held(line: FaultyLine, data: bytes) -> bytes:
        line.delay_to_host = randomly.uniform(0.0, longest)
        return data

    return LineDamage(f"up to {longest:g} s late", lambda line: partial(held, line), longest)


def _absurd(randomly: random.Random) -> LineDamage:
    key, value = b"$%d=" % randomly.choice(SETTINGS), randomly.choice(ABSURD)
    return LineDamage(f"the setting {(key + value[:10]).decode()}", lambda line: in_lines(key, value))


def _echoing(line: FaultyLine) -> Filter:
    def heard_twice(data: bytes) -> bytes:
        line.tell_host(data)
        return data

    line.to_controller = heard_twice
    return bytes


def in_lines(key: bytes, value: bytes) -> Filter:
    """A filter that gives a setting another value, however the bytes are split into pieces."""
    left = b""

    def filtered(data: bytes) -> bytes:
        nonlocal left
        *lines, left = (left + data).split(b"\n")
        last, left = (b"", left) if left.startswith(b"$") else (left, b"")  # all else passes at once
        return b"\n".join(key + value + b"\r" if line.startswith(key) else line for line in (*lines, last))

    return filtered


def straying(axis: int, way: Callable[[], float]) -> Filter:
    """A filter that reports another place of an axis, by its number, than the controller does: by this way [mm]."""

    def moved(match: re.Match[bytes]) -> bytes:
        places = match[1].split(b",")
        places[axis] = b"%.3f" % (float(places[axis]) + way())
        return b"Pos:" + b",".join(places)

    return lambda data: re.sub(rb"Pos:([-.\d]+(?:,[-.\d]+)+)", moved, data)


BOTH, HOST = ("controller", "host"), ("host",)
CHANGES: dict[str, Callable[[random.Random, bytes], bytes]] = {
    "bytes lost": lambda randomly, byte: b"",
    "bytes changed": lambda randomly, byte: randomly.randbytes(1),
    "bytes with a wrong bit": lambda randomly, byte: bytes((byte[0] ^ 1 << randomly.randrange(8),)),
    "bytes repeated": lambda randomly, byte: 2 * byte,
    "bytes wrong if digits": lambda randomly, byte: b"%d" % randomly.randrange(10) if byte.isdigit() else byte,
    "pieces repeated": lambda randomly, data: 2 * data,
    "pieces lost": lambda randomly, data: b"",
    "pieces cut off": lambda randomly, data: data[: randomly.randrange(len(data) + 1)],
}
"""Changes of single bytes, or of pieces: all bytes that come at once, about one line or report."""
KINDS: tuple[tuple[Sequence[str], Sequence[Kind]], ...] = (
    *((BOTH, (partial(_now_and_then, what, change),)) for what, change in CHANGES.items()),
    (BOTH, (_late,)),
    (HOST, (_jittering,)),
    (HOST, (lambda randomly: LineDamage("an echo of all that it sends", _echoing),)),
    (HOST, [partial(_now_and_then, f"pieces with {said.strip()[:30]!r}", partial(_with, said)) for said in SAID]),
    (HOST, (_absurd,)),
)
"""The ways that can be damaged, and the kinds of damage, which differ in their data alone."""
