"""State machines as tables: what an event changes and causes, row by row.

A state is a set with one member of each of several enumerations; facts are members of others, observed when the event comes.
A row applies if, of each enumeration that it names, one of the members named is there. All rows that apply take effect, and
no two of them disagree. An event to which no row applies is refused: it changes nothing.
"""

from collections.abc import Iterable, Sequence, Set
from enum import Enum
from typing import NamedTuple

State = frozenset[Enum]
"""The state: a member of each enumeration of the machine."""


class Row(NamedTuple):
    """A line of a table."""

    events: tuple[Enum, ...]
    when: Set[Enum]
    """The members that must be there; those of one enumeration are alternatives."""
    then: Set[Enum] = frozenset()
    """The members that are there afterwards, in place of the others of these enumerations."""
    do: Enum | None = None
    """The actions to be taken."""

    def applies(self, event: Enum, situation: State) -> bool:
        """Whether it applies to an event, given the state and the facts."""
        return event in self.events and kinds(self.when) == kinds(self.when & situation)


class Step(NamedTuple):
    """The consequence of an event."""

    state: State
    actions: tuple[Enum, ...]
    """In the order of the rows, each once."""


def step(table: Sequence[Row], state: State, event: Enum, facts: Iterable[Enum] = ()) -> Step | None:
    """The consequence of an event; None if it is refused."""
    situation = state.union(facts)
    rows = [row for row in table if row.applies(event, situation)]
    if not rows:
        return None
    then = frozenset[Enum]().union(*(row.then for row in rows))
    kept = {member for member in state if type(member) not in kinds(then)}
    return Step(then | kept, tuple(dict.fromkeys(row.do for row in rows if row.do is not None)))


def kinds(members: Iterable[Enum]) -> set[type[Enum]]:
    """The enumerations that these are members of."""
    return {type(member) for member in members}
