"""Why an estimate is not to be used, or a push is left out: a code for programs, and a text for people."""

from typing import NamedTuple


class Reason(NamedTuple):
    """A reason; as text, what it says to people."""

    code: str  # for programs: a constant of pushfric_msgs/Reason, in lower case
    text: str  # for people: the likely cause, and what to do

    def __str__(self) -> str:
        return self.text
