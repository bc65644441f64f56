"""Numbers and names in sentences, and reasons: a text for people, and a code for programs."""

from collections.abc import Iterable
from typing import NamedTuple


class Reason(NamedTuple):
    """A reason; as text, what it says to people."""

    code: str  # for programs: a constant of pushfric_msgs/Reason, in lower case
    text: str  # for people: the likely cause, and what to do

    def __str__(self) -> str:
        return self.text


def counted(number: int, one: str, several: str = "") -> str:
    """A number with its noun: 1 push, 2 pushes.

    Args:
        number: how many there are.
        one: the noun in the singular.
        several: the noun in the plural; empty: with an s.
    """
    return f"{number} {one if number == 1 else several or one + 's'}"


def data_of(data_points: int, pushes: int) -> str:
    """The basis of an estimate: 81 observations of 14 pushes."""
    return f"{counted(data_points, 'observation')} of {counted(pushes, 'push', 'pushes')}"


def no_such(kind: str, word: str, known: Iterable[str], see: str) -> str:
    """A word that names nothing, with the nearest name.

    Args:
        kind: what the word should name.
        word: the unknown word.
        known: all names of this kind.
        see: the command that lists them.
    """
    import difflib  # late: only a wrong word needs it

    names = {name.lstrip("-"): name for name in known}  # --cell is not like --help
    nearest = difflib.get_close_matches(word.lstrip("-"), list(names), n=1, cutoff=0.65)
    return f"no such {kind} {word!r}; {f'did you mean {names[nearest[0]]}? ' if nearest else ''}see {see}"


LONGEST = 80
"""Number of characters of a wrong value that are shown."""


def shortened(value: object) -> str:
    """A wrong value for people, on one line of bounded length."""
    text = repr(value)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
