"""Whether pushes vary enough to determine p_CF."""

import itertools
import math

from pushfric_core.wording import Reason, counted

FEWEST_PUSHES = 4
"""For fewer pushes there is no spread: how far p_CF scatters would rest on two differences between pushes, or fewer."""

SEPARATE = 0.12
"""Contacts at least this far apart are at different places, as a share of the support's size."""

FEWEST_PLACES = 3
"""Pushes at fewer places all carry the same information."""

FINENESS = 20
"""Places are distinguished to this fraction of the distance that separates them, so that only a limited number are kept."""

ONE_SIDE = 30
"""Contacts whose normals lie within this angle of one another are on the same side [degrees]."""


class Excitation:
    """Whether the pushes come from enough places and sides to determine p_CF; the order of the pushes does not matter.

    Args:
        size: of the support [m].
    """

    def __init__(self, size: float) -> None:
        self._step = SEPARATE * size / FINENESS or 1.0
        self._pushes: set[int] = set()
        self._places: set[tuple[int, int]] = set()  # in steps
        self._bearings: set[int] = set()  # of the normals, to a degree
        self._separate = 1  # so many places are separate, at most FEWEST_PLACES
        self._one_side = True

    def add(self, push_id: int, contact: tuple[float, float], normal: tuple[float, float]) -> None:
        """Take an observation; the first one of each push says where it is."""
        if push_id in self._pushes:
            return
        self._pushes.add(push_id)
        place = round(contact[0] / self._step), round(contact[1] / self._step)
        if self._separate < FEWEST_PLACES and place not in self._places:
            if others := [other for other in self._places if math.dist(place, other) > FINENESS]:
                third = any(math.dist(*pair) > FINENESS for pair in itertools.combinations(others, 2))
                self._separate = FEWEST_PLACES if third else 2
            self._places.add(place)
        bearing = round(math.degrees(math.atan2(normal[1], normal[0])))
        if self._one_side and bearing not in self._bearings:
            self._one_side = all(abs((bearing - other + 180) % 360 - 180) <= ONE_SIDE for other in self._bearings)
            self._bearings.add(bearing)

    def lack(self, pushes: int) -> Reason | None:
        """The lack of this number of pushes that keeps it from showing how far p_CF is off; None if there is none."""
        if pushes < FEWEST_PUSHES:
            return Reason(
                "few_pushes",
                f"p_CF rests on {counted(pushes, 'push', 'pushes')}, and fewer than {FEWEST_PUSHES} cannot tell how far it is "
                f"off: push at least {FEWEST_PUSHES} times, at {FEWEST_PLACES} places or more, on more than one side",
            )
        if self._separate < FEWEST_PLACES:
            where = "one place" if self._separate == 1 else f"{self._separate} places"
            text = f"all pushes are at {where} and say the same: push at least {FEWEST_PLACES} places, on more than one side"
            return Reason("few_places", text)
        if self._one_side:
            text = "all pushes are against one side, which leaves p_CF open across it: push another side, too"
            return Reason("one_side", text)
        return None
