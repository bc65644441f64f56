"""Why an estimate is not to be used, or a push is left out: a code for programs, and a text for people."""

from enum import StrEnum, auto
from typing import NamedTuple


class ReasonCode(StrEnum):
    """Codes of reasons; pushfric_msgs/Reason has the same names."""

    # the pushes do not show how far p_CF is off
    FEW_PUSHES = auto()
    FEW_PLACES = auto()
    ONE_SIDE = auto()
    UNCERTAIN = auto()

    # mistakes in the input
    NORMALS_INWARD = auto()
    OMEGA_IN_DEGREES = auto()
    CONTACTS_RECEDE = auto()
    OMEGA_NEGATED = auto()
    SPEEDS_IN_MILLIMETRES = auto()
    SPEEDS_SWAPPED = auto()
    COLUMNS_MIXED = auto()
    MIRRORED = auto()
    TWIST_OF_CONTACT = auto()
    ORIGIN_OFF = auto()
    TOO_FAST = auto()
    FORCES_SCATTERED = auto()
    FORCES_OPPOSED = auto()
    FORCES_TURNED = auto()

    # the data contradict each other, or what is known of the object
    CONTRADICTION = auto()
    POOR_FIT = auto()
    SUPPORT_TOO_SMALL = auto()
    HALF_PLANES = auto()
    OBJECT_CHANGED = auto()

    # contacts lie elsewhere
    TIP_OFF_ACROSS = auto()
    OUTLINE_SHIFTED = auto()
    LINE_OFF_SIDEWAYS = auto()
    CONTACTS_DISPLACED = auto()

    # a push is left out
    PUSH_CONTRADICTS = auto()


class Reason(NamedTuple):
    """A reason; as text, what it says to people."""

    code: ReasonCode
    text: str  # the likely cause, and what to do

    def __str__(self) -> str:
        return self.text
