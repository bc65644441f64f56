"""State machines as tables, and that of an actuator: when it may move, what ends a motion, and who is told.

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


class Life(Enum):
    """Lifecycle of the managed node."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"


class Task(Enum):
    """The actuator's use of the pusher."""

    DISCONNECTED = "disconnected"
    NONE = "no task"
    WAITING = "a push waits"
    PUSHING = "pushing"
    RETRACTING = "on the way back"
    ABORTING = "ending a push"
    RECOVERING = "recovering"


class Position(Enum):
    """Whether the pusher stands where the controller says it does."""

    KNOWN = "position known"
    UNHOMED = "not homed yet"
    UNKNOWN = "position unknown"


class Needs(Enum):
    """The needs of a push: signs of life of its client and of the required nodes, a measured force, and time."""

    MET = "client lives, needs met"
    AWAITED = "signs of life awaited"
    MISSING = "client or need missing"


Hold = Enum("Hold", {"FREE": "free", "HELD": "held"})
"""Whether somebody, or a force, has stopped the pusher until a reset."""
Homing = Enum("Homing", {"HOMES": "homes", "UNLOCKS": "does not home"})
"""The setting `home`: what a recovery does."""
Enable = Enum("Enable", {"ENABLED": "enabled", "DISABLED": "not enabled"})
"""The last word of the topic enable within `enable_timeout`."""
Controller = Enum("Controller", {"IDLE": "driver idle", "NOT_IDLE": "driver not idle"})
Way = Enum("Way", {"RETURNS": "to come back", "ONE_WAY": "not to come back"})
"""Course of the push that is under way."""


class Event(Enum):
    """An event at an actuator."""

    CONFIGURE = "configure"
    ACTIVATE = "activate"
    DEACTIVATE = "deactivate"  # also before the node ends
    LEAVE = "clean up"  # or shut down, or a transition that failed
    CONNECTED = "connected"
    MISPLACED = "found elsewhere"  # than it rested, or the driver doubts where it is
    UNSURE = "position in doubt"  # or an alarm
    FAILED = "driver error"
    LOST = "connection lost"
    RESTED = "driver done"
    CHECKED = "check"  # every 5 ms
    GOAL = "goal"
    CANCEL = "cancel"
    STOP = "stop"  # by a person, or because of a force
    RESET = "reset"


class Action(Enum):
    """An action of the actuator."""

    MOVE = "push"
    RETRACT = "go back"
    BRAKE = "stop the pusher"
    RECOVER = "home or unlock"
    LEAVE = "stop and leave the port"
    TELL = "tell the client"
    CLEAR = "forget the fault"


E, T = Event, Task
UNDER_WAY: set[Enum] = {T.WAITING, T.PUSHING, T.RETRACTING, T.ABORTING}
"""There is a push, and its client is to be told how it ends."""
READY: set[Enum] = {Life.ACTIVE, Position.KNOWN, Hold.FREE}
SAFE = READY | {Enable.ENABLED, Needs.MET}
"""Whatever else is the case, a push moves only then."""
RECOVERABLE = {Life.ACTIVE, T.NONE, Enable.ENABLED}

ACTUATOR = (
    Row((E.CONFIGURE,), {Life.UNCONFIGURED}, {Life.INACTIVE}),
    Row((E.CONFIGURE,), {Life.UNCONFIGURED, Homing.HOMES, Position.KNOWN}, {Position.UNHOMED}),
    Row((E.ACTIVATE,), {Life.INACTIVE, T.NONE}, {Life.ACTIVE}),
    Row((E.ACTIVATE,), {Life.INACTIVE, T.NONE, Position.UNHOMED, Hold.FREE, Enable.ENABLED}, {T.RECOVERING}, Action.RECOVER),
    Row((E.GOAL,), READY | {T.NONE, Enable.ENABLED, Controller.IDLE}, {T.WAITING}),
    Row((E.CHECKED,), SAFE | {T.WAITING}, {T.PUSHING}, Action.MOVE),
    Row((E.RESTED,), SAFE | {T.PUSHING, Way.RETURNS}, {T.RETRACTING}, Action.RETRACT),
    Row((E.RESTED,), {T.PUSHING, Way.ONE_WAY}, {T.NONE}, Action.TELL),
    Row((E.RESTED,), {T.RETRACTING, T.ABORTING}, {T.NONE}, Action.TELL),
    Row((E.RESTED,), {T.RECOVERING}, {T.NONE, Position.KNOWN}, Action.CLEAR),
    Row((E.STOP,), set(), {Hold.HELD}),
    Row((E.DEACTIVATE,), {Life.ACTIVE}, {Life.INACTIVE}),
    Row((E.STOP, E.DEACTIVATE, E.CANCEL), {T.WAITING}, {T.NONE}, Action.TELL),
    Row((E.STOP, E.DEACTIVATE, E.CANCEL), {T.PUSHING, T.RETRACTING}, {T.ABORTING}, Action.BRAKE),
    Row((E.STOP, E.DEACTIVATE), {T.RECOVERING}, {T.NONE}, Action.BRAKE),
    Row((E.CHECKED,), {T.WAITING, Enable.DISABLED}, {T.NONE}, Action.TELL),
    Row((E.CHECKED,), {T.WAITING, Needs.MISSING}, {T.NONE}, Action.TELL),
    Row((E.CHECKED,), {T.PUSHING, T.RETRACTING, Enable.DISABLED}, {T.ABORTING}, Action.BRAKE),
    Row((E.CHECKED,), {T.PUSHING, T.RETRACTING, Needs.MISSING}, {T.ABORTING}, Action.BRAKE),
    Row((E.CHECKED,), {T.RECOVERING, Homing.HOMES, Enable.DISABLED}, {T.NONE}, Action.BRAKE),
    Row((E.CHECKED,), {T.RECOVERING, Homing.HOMES, Enable.DISABLED, Position.KNOWN}, {Position.UNHOMED}),
    Row((E.RESET,), {Life.ACTIVE, T.NONE, Hold.HELD, Position.KNOWN, Controller.IDLE}, {Hold.FREE}, Action.CLEAR),
    Row((E.RESET,), RECOVERABLE | {Hold.FREE}, {T.RECOVERING}, Action.RECOVER),
    Row((E.RESET,), RECOVERABLE | {Position.UNHOMED, Position.UNKNOWN}, {T.RECOVERING, Hold.FREE}, Action.RECOVER),
    Row((E.RESET,), RECOVERABLE | {Controller.NOT_IDLE}, {T.RECOVERING, Hold.FREE}, Action.RECOVER),
    Row((E.RESET,), {Life.ACTIVE, T.RECOVERING}),  # whoever asks again does not begin it again
    Row((E.FAILED,), UNDER_WAY | {T.RECOVERING}, {T.NONE}),  # the driver stops by itself
    Row((E.LEAVE,), set(), {Life.UNCONFIGURED, T.DISCONNECTED}, Action.LEAVE),
    Row((E.LOST,), set(), {T.DISCONNECTED}),
    Row((E.FAILED, E.LOST, E.LEAVE), UNDER_WAY, do=Action.TELL),
    # if homing is not completed, the pusher can be anywhere
    Row(
        (E.STOP, E.DEACTIVATE, E.FAILED, E.LOST, E.LEAVE),
        {T.RECOVERING, Homing.HOMES, Position.KNOWN},
        {Position.UNHOMED},
    ),
    Row((E.CONNECTED,), {Life.INACTIVE, Life.ACTIVE, T.DISCONNECTED}, {T.NONE}),
    Row((E.MISPLACED,), {Position.KNOWN, Position.UNHOMED}, {Position.UNKNOWN}),
    Row((E.UNSURE,), {Position.KNOWN}, {Position.UNKNOWN}),
)


def at_first(homes: bool) -> State:
    """The state of a new actuator."""
    return frozenset({Life.UNCONFIGURED, T.DISCONNECTED, Position.UNHOMED if homes else Position.KNOWN, Hold.FREE})
