"""A fault: what is done and when, and what must follow. It is tried until it was caused, but not for ever."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, Generic, NamedTuple, TypeVar

from pushfric_core.errors import PushfricError

TRIES = 5  # of what a busy machine may interrupt


class Otherwise(PushfricError):
    """Something followed that must not, or did not follow."""


class EndedEarly(Otherwise):
    """A push or a run ended before its fault was caused: on a busy machine, for example, a controller may seem silent."""


Place = TypeVar("Place", contravariant=True)


class Fault(NamedTuple, Generic[Place]):
    """A row of a table; where it is caused, whoever tries it says."""

    name: str
    cause: Callable[[Place], float | None]
    """Waits for the moment and causes the fault; returns when that was, or None if nothing may come of it."""
    must: Callable[[Place, float | None, dict[str, Any]], None]
    """Given this moment, notes what follows in the dictionary; raises `Otherwise` if that is not what must follow."""


class Outcome(NamedTuple):
    """The outcome of a fault."""

    fault: str
    found: dict[str, Any]  # what followed
    problem: str | None  # what was wrong; None: nothing
    tries: int = 1  # the runs before ended before their fault

    @property
    def tried(self) -> str:
        """How often a fault was tried, if its run ended before it."""
        return f", on try {self.tries}" if self.tries > 1 else ""

    def to_dict(self) -> dict[str, Any]:
        """All but the name of the fault."""
        return {**self.found, "problem": self.problem, "tries": self.tries}


def tried(fault: Fault[Place], place: Callable[[], AbstractContextManager[Place]]) -> Outcome:
    """Cause a fault at a place that is made ready for each try."""
    for tries in range(1, TRIES + 1):
        found: dict[str, Any] = {}
        problem: Otherwise | None = None
        try:
            with place() as here:
                fault.must(here, fault.cause(here), found)
        except Otherwise as error:
            problem = error
        outcome = Outcome(fault.name, found, None if problem is None else str(problem), tries)
        if not isinstance(problem, EndedEarly):
            break
    return outcome


def demand(condition: object, otherwise: str) -> None:
    """Raise `Otherwise` unless a condition holds."""
    if not condition:
        raise Otherwise(otherwise)
