"""The states of the driver of a controller on a serial port: which script runs, and what ends it."""

from enum import Enum

from pushfric_core.pushers.states import Homing, Row, State


class Phase(Enum):
    """The driver's activity; each phase but the first and the one at rest is a script, which ends with DriverEvent.DONE."""

    CLOSED = "port closed"
    CONNECTING = "connecting"
    RESTING = "at rest"
    STREAMING = "in a stroke"
    BRAKING = "braking"
    RESETTING = "reset to stop"
    RECOVERING = "reset to recover"
    HOMING = "homing"
    UNLOCKING = "unlocking"


class ReportedMode(Enum):
    """The controller's mode, as it reports it."""

    IDLE = "reported idle"
    ALARM = "reported in alarm"
    OTHER = "reported otherwise"


Trust = Enum("Trust", {"TRUSTED": "position trusted", "DOUBTED": "position in doubt"})
Next = Enum("Next", {"NOTHING": "nothing due", "RECOVERY": "recovery due"})
"""The step that a stop leaves due."""
Role = Enum("Role", {"DRIVES": "may interfere", "LOOKS": "only looks"})


class DriverEvent(Enum):
    """An event at the driver."""

    CONNECT = "connect"
    MOVE = "move"
    STOP = "stop"  # or any error
    RECOVER = "recover"
    DONE = "script done"
    DOUBT = "doubt"  # a report that cannot be true, a suspension, another offset
    LOST = "line lost"  # or left


class DriverAction(Enum):
    """A command that is sent at once."""

    HOLD = "feed hold"


E, P = DriverEvent, Phase
STOPPING: set[Enum] = {P.BRAKING, P.RESETTING}
STOPPABLE = {Role.DRIVES, P.RESTING, P.STREAMING, P.RECOVERING, P.UNLOCKING}

DRIVER = (
    Row((E.CONNECT,), {P.CLOSED}, {P.CONNECTING, Trust.TRUSTED}),
    Row((E.MOVE,), {Role.DRIVES, P.RESTING, Trust.TRUSTED, ReportedMode.IDLE}, {P.STREAMING}),
    Row((E.DONE,), {P.CONNECTING, P.STREAMING}, {P.RESTING}),
    Row((E.STOP,), STOPPABLE | {ReportedMode.IDLE, ReportedMode.OTHER}, {P.BRAKING}, DriverAction.HOLD),
    Row((E.STOP,), STOPPABLE | {ReportedMode.ALARM}, {P.RESETTING}, DriverAction.HOLD),  # it may obey nothing but a reset
    Row((E.STOP,), {Role.DRIVES, P.HOMING}, {P.RESETTING}, DriverAction.HOLD),
    Row((E.STOP,), STOPPING, {Next.NOTHING}),
    Row((E.DONE,), {P.BRAKING}, {P.RESETTING}),
    Row((E.DONE,), {P.RESETTING, Next.NOTHING}, {P.RESTING}),
    Row((E.DONE,), {P.RESETTING, Next.RECOVERY}, {P.RECOVERING, Next.NOTHING}),
    Row((E.RECOVER,), {Role.DRIVES, P.RESTING}, {P.RECOVERING}),
    Row((E.RECOVER,), STOPPING, {Next.RECOVERY}),
    Row((E.DONE,), {P.RECOVERING, Homing.HOMES}, {P.HOMING}),
    Row((E.DONE,), {P.RECOVERING, Homing.UNLOCKS}, {P.UNLOCKING}),
    Row((E.DONE,), {P.HOMING, P.UNLOCKING}, {P.RESTING, Trust.TRUSTED}),
    Row((E.DOUBT,), set(), {Trust.DOUBTED}),
    Row((E.LOST,), set(), {P.CLOSED, Next.NOTHING}),
)

AT_FIRST: State = frozenset({P.CLOSED, Trust.TRUSTED, Next.NOTHING})
