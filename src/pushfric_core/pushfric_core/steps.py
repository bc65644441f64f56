"""Work in steps, for programs that have other things to do meanwhile: generators that pause after each."""

from collections.abc import Generator
from typing import TypeVar, cast

Result = TypeVar("Result")


def finished(work: Generator[None, None, Result]) -> Result:
    """The result of the work, all of whose steps are done at once."""
    while True:
        try:
            next(work)
        except StopIteration as end:
            return cast(Result, end.value)
