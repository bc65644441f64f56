"""A check by the doctor, or by a driver on its behalf."""

from enum import Enum
from typing import NamedTuple


class Grade(Enum):
    """How a check came out."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "failed"


class Check(NamedTuple):
    """A check and its finding."""

    name: str
    level: Grade
    finding: str
    advice: str = ""  # what to do; empty if nothing is wrong
