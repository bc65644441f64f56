"""Many observations at once, with a line for each that is refused."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_core.estimation.estimator import Estimator
from pushfric_core.estimation.recognition import Ranking, Recognizer
from pushfric_core.trajectories.observation import Observation

Warn = Callable[[str], None]

Taken = TypeVar("Taken")


def taken(take: Callable[[Observation], Taken], data: Iterable[Observation], warn: Warn) -> Iterator[Taken]:
    """The result of each observation, one by one, as in a live node; `warn` is called with a line for each that is refused."""
    for observation in data:
        try:
            yield take(observation)
        except PushfricError as error:
            warn(f"observation of push {observation.push_id} refused: {error}")


def last(results: Iterable[Taken]) -> Taken:
    """The result of the last observation.

    Raises:
        InvalidInput: all observations were refused.
    """
    newest = deque(results, maxlen=1)
    if not newest:
        raise InvalidInput("no observation could be used, expected at least one")
    return newest[0]


def usable_by(estimator: Estimator, data: Iterable[Observation], warn: Warn) -> list[Observation]:
    """The observations that an estimator takes; warns as `taken`."""

    def checked(observation: Observation) -> Observation:
        estimator.check(observation)
        return observation

    return list(taken(checked, data, warn))


def recognize(recognizer: Recognizer, data: Iterable[Observation], warn: Warn) -> Ranking:
    """The ranking after the last observation; raises and warns as `taken` and `last`."""
    return last(taken(recognizer.add, data, warn))
