"""One thing that the doctor, or a driver on its behalf, has checked."""

from enum import Enum
from typing import NamedTuple


class Grade(Enum):
    """How a check came out."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "failed"


class Check(NamedTuple):
    """One thing that was checked."""

    name: str
    level: Grade
    finding: str
    advice: str = ""  # what to do; empty if nothing is wrong
