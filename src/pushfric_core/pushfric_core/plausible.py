"""Bounds on numbers from outside that no cell exceeds, and the unit in which a number beyond its bound would make sense."""

import math
from collections.abc import Callable, Iterable

FARTHEST = 100.0
"""No coordinate and no length is larger, in any frame [m]."""

FARTHEST_TURN_CENTER = 1e9
"""A centre of rotation may lie this far away, as that of a translation does [m]."""

LARGEST = 3.0
"""No object is longer or wider [m]."""

FASTEST = 10.0
"""Nothing moves faster [m/s]."""

FASTEST_TURN = 1000.0
"""Nothing turns faster [rad/s]: an object of a few centimetres whose motion is given for a unit of time of one's own."""

STRONGEST = 1e4
"""No force is larger [N]."""

LONGEST = 600.0
"""No observation takes longer [s]."""

OTHER_UNITS = {
    "m": {"millimetres": 1e-3, "centimetres": 1e-2},
    "m/s": {"millimetres per second": 1e-3},
    "rad": {"degrees": math.pi / 180},
    "rad/s": {"degrees per second": math.pi / 180},
    "s": {"milliseconds": 1e-3, "nanoseconds": 1e-9},
    "N": {"millinewtons": 1e-3},
}
"""Units often written instead of another, as multiples of it."""


def check_within(what: str, values: Iterable[float], most: float, unit: str) -> None:
    """Refuse numbers beyond a bound, with the unit that would make them plausible.

    Raises:
        ValueError: one is not finite, or its absolute value is larger than `most`.
    """
    numbers = tuple(map(float, values))
    if all(abs(number) <= most for number in numbers):
        return
    got = f"{numbers[0]:g}" if len(numbers) == 1 else f"{numbers}"
    if not all(map(math.isfinite, numbers)):
        raise ValueError(f"{what} must be finite, got {got}")
    largest = max(numbers, key=abs)
    asked = other_unit(unit, lambda factor: abs(largest * factor) <= most)
    raise ValueError(f"{what} must lie within {f'{most:g} {unit}'.rstrip()}, got {got}{asked}")


def other_unit(unit: str, makes_sense: Callable[[float], bool]) -> str:
    """The question whether numbers were written in another unit, for the end of an error; empty if none would make sense.

    Args:
        unit: the one that is expected.
        makes_sense: whether the numbers would be right if they were this many times smaller or larger.
    """
    return next((f": are these {name}?" for name, factor in OTHER_UNITS.get(unit, {}).items() if makes_sense(factor)), "")
