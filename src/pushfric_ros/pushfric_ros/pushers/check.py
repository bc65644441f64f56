"""One thing that the doctor, or a driver on its behalf, has looked at."""

from enum import Enum
from typing import NamedTuple


class Level(Enum):
    """How a check came out."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "failed"


class Check(NamedTuple):
    """One thing that was looked at."""

    name: str
    level: Level
    finding: str
    advice: str = ""  # what to do; empty where all is well
