"""The state tables of the actuator and of the serial drivers, exhaustively."""

import itertools
import pathlib
from collections import deque
from enum import Enum

import pytest

from pushfric_core.pushers.driver import (
    AT_FIRST,
    DRIVER,
    DriverAction,
    DriverEvent,
    Next,
    Phase,
    ReportedMode,
    Role,
    Trust,
)
from pushfric_core.pushers.states import (
    ACTUATOR,
    READY,
    UNDER_WAY,
    Action,
    Controller,
    Enable,
    Event,
    Hold,
    Homing,
    Life,
    Needs,
    Position,
    Task,
    Way,
    at_first,
    kinds,
    step,
)

DOCUMENT = pathlib.Path(__file__).resolve().parents[3] / "docs/safety.md"
NODE_STATE, NODE_FACTS = (Life, Task, Position, Hold), (Homing, Enable, Needs, Controller, Way)
DRIVER_STATE, DRIVER_FACTS = (Phase, Trust, Next), (Homing, ReportedMode, Role)
MOVING = {Action.MOVE, Action.RETRACT}


def every(*enumerations: type[Enum]):
    """All sets with one member of each."""
    return map(frozenset, itertools.product(*enumerations))


def every_pair(table):
    """Each state of a table with each event and all facts, and what follows."""
    state_of, facts_of, events = {
        id(ACTUATOR): (NODE_STATE, NODE_FACTS, Event),
        id(DRIVER): (DRIVER_STATE, DRIVER_FACTS, DriverEvent),
    }[id(table)]
    facts_of_event = {event: named(table, event) & set(facts_of) for event in events}
    for state, event in itertools.product(every(*state_of), events):
        for facts in every(*facts_of_event[event]):
            yield state, event, facts, step(table, state, event, facts)


def named(table, event):
    return set().union(*(kinds(row.when) for row in table if event in row.events))


@pytest.mark.parametrize(("table", "state_of"), [(ACTUATOR, NODE_STATE), (DRIVER, DRIVER_STATE)], ids=["actuator", "driver"])
def test_rows_that_apply_together_agree_and_each_row_changes_or_does_something(table, state_of):
    effective = set()
    for state, event, facts, following in every_pair(table):
        rows = [row for row in table if row.applies(event, state | facts)]
        assert bool(rows) == (following is not None)
        for one, other in itertools.combinations(rows, 2):
            common = kinds(one.then) & kinds(other.then)
            assert {m for m in one.then if type(m) in common} == {m for m in other.then if type(m) in common}, (one, other)
        if following is not None:
            assert kinds(following.state) == set(state_of)
            assert len(following.state) == len(state_of)
            effective |= {table.index(row) for row in rows if row.do or not row.then <= state or not row.then}
    assert effective == set(range(len(table)))


def test_no_event_leads_to_motion_without_a_live_owner_a_confirmed_position_and_an_enable():
    """In each state that can be written down, reachable or not."""
    for state, event, facts, following in every_pair(ACTUATOR):
        actions = set(following.actions) if following is not None else set()
        if actions & MOVING:
            assert state >= READY
            assert facts >= {Enable.ENABLED, Needs.MET}
            assert event in (Event.CHECKED, Event.RESTED)
        if Action.RECOVER in actions:
            assert event is Event.RESET or (event is Event.ACTIVATE and state >= {Position.UNHOMED, Hold.FREE})
            assert Enable.ENABLED in facts
            assert following.state >= {Life.ACTIVE, Hold.FREE, Task.RECOVERING}
        if Hold.HELD in state and event is not Event.RESET:
            assert not actions & {*MOVING, Action.RECOVER}
            assert following is None or Hold.HELD in following.state
        if Position.UNKNOWN in state and following is not None and Position.UNKNOWN not in following.state:
            assert (event, Task.RECOVERING in state) == (Event.RESTED, True)  # only a recovery that has ended says where it is
        if following is not None and Position.UNHOMED in following.state - state:
            assert Homing.HOMES in facts
            assert event is Event.CONFIGURE or Task.RECOVERING in state
        if event is Event.RESET:
            assert following is None or Life.ACTIVE in state
        if event is Event.DEACTIVATE and Life.UNCONFIGURED in state:
            assert following is None or Life.UNCONFIGURED in following.state


def test_the_driver_moves_only_as_told_and_nothing_in_doubt():
    for state, event, facts, following in every_pair(DRIVER):
        if following is None:
            continue
        entered = {phase for phase in following.state - state if isinstance(phase, Phase)}
        if Phase.STREAMING in entered:
            assert event is DriverEvent.MOVE
            assert state >= {Phase.RESTING, Trust.TRUSTED}
            assert facts >= {ReportedMode.IDLE, Role.DRIVES}
        if Phase.HOMING in entered:
            assert (event, Phase.RECOVERING in state, Homing.HOMES in facts) == (DriverEvent.DONE, True, True)
        if Phase.RECOVERING in entered:
            assert event is DriverEvent.RECOVER or state >= {Phase.RESETTING, Next.RECOVERY}
        if Trust.DOUBTED in state and Trust.TRUSTED in following.state:
            assert event is DriverEvent.CONNECT or state & {Phase.HOMING, Phase.UNLOCKING}
        if event is DriverEvent.STOP:
            assert following.state & {Phase.BRAKING, Phase.RESETTING}
            assert DriverAction.HOLD in following.actions or following.state >= state - set(Next) | {Next.NOTHING}


def test_the_driver_never_interferes_where_it_only_looks_or_is_not_connected():
    for state, event, facts, following in every_pair(DRIVER):
        if Role.LOOKS in facts or state & {Phase.CLOSED, Phase.CONNECTING}:
            assert following is None or not following.actions
            if event in (DriverEvent.MOVE, DriverEvent.STOP, DriverEvent.RECOVER) and not state & {
                Phase.BRAKING,
                Phase.RESETTING,
            }:
                assert following is None


def test_every_script_of_the_driver_ends_and_every_doubt_counts():
    for state, event, _, following in every_pair(DRIVER):
        if event is DriverEvent.DONE:
            assert (following is None) == bool(state & {Phase.CLOSED, Phase.RESTING})
            assert following is None or following.state - state & set(Phase)
        if event is DriverEvent.DOUBT:
            assert Trust.DOUBTED in following.state


P, D = Phase, DriverEvent


@pytest.mark.parametrize(
    ("homing", "events", "phases"),
    [
        (Homing.UNLOCKS, [D.CONNECT, D.DONE, D.MOVE, D.DONE], [P.CONNECTING, P.RESTING, P.STREAMING, P.RESTING]),
        (
            Homing.HOMES,
            [D.CONNECT, D.DONE, D.DOUBT, D.MOVE, D.RECOVER, D.DONE, D.DONE, D.MOVE],
            [P.CONNECTING, P.RESTING, P.RESTING, P.RESTING, P.RECOVERING, P.HOMING, P.RESTING, P.STREAMING],
        ),
        (
            Homing.UNLOCKS,
            [D.CONNECT, D.DONE, D.MOVE, D.STOP, D.RECOVER, D.DONE, D.DONE, D.DONE, D.DONE, D.LOST, D.CONNECT],
            [P.CONNECTING, P.RESTING, P.STREAMING, P.BRAKING, P.BRAKING, P.RESETTING, P.RECOVERING, P.UNLOCKING, P.RESTING]
            + [P.CLOSED, P.CONNECTING],
        ),
        (
            Homing.UNLOCKS,
            [D.CONNECT, D.DONE, D.STOP, D.RECOVER, D.STOP, D.DONE, D.DONE],
            [P.CONNECTING, P.RESTING, P.BRAKING, P.BRAKING, P.BRAKING, P.RESETTING, P.RESTING],
        ),
    ],
    ids=["a stroke", "a doubt that homing ends", "a recovery that waits for a stop", "a recovery that is given up"],
)
def test_the_driver_goes_from_phase_to_phase(homing, events, phases):
    state = AT_FIRST
    for event, phase in zip(events, phases, strict=True):
        following = step(DRIVER, state, event, {homing, ReportedMode.IDLE, Role.DRIVES})
        state = state if following is None else following.state
        assert phase in state, event


class Pair:
    """An actuator and its driver, as tables: all that can happen to both from the beginning on."""

    def __init__(self, homing: Homing) -> None:
        self.homing = homing
        first = at_first(homing is Homing.HOMES), AT_FIRST
        self.reached, due = {first}, deque([first])
        self.steps = []
        while due:
            before = due.popleft()
            for event, facts in self.happenings(before):
                after, actions = self.follow(before, event, facts)
                self.steps.append((before, event, facts, after, actions))
                if after not in self.reached:
                    self.reached.add(after)
                    due.append(after)

    def happenings(self, pair):
        state, machine = pair
        told = Event.CONNECTED, Event.MISPLACED, Event.UNSURE, Event.FAILED, Event.LOST, Event.RESTED  # by the driver
        if Life.UNCONFIGURED in state:
            asked = [Event.CONFIGURE, Event.STOP]
        elif Life.INACTIVE in state:
            asked = [Event.ACTIVATE, Event.LEAVE, Event.STOP, Event.RESET, Event.GOAL, Event.CHECKED]
        else:
            asked = [e for e in Event if e not in (*told, Event.CONFIGURE, Event.ACTIVATE)]
        for event in asked:
            yield from ((event, facts) for facts in every(Enable, Needs, Way, ReportedMode))
        if Life.UNCONFIGURED in state:
            return
        if Phase.CLOSED in machine:
            yield DriverEvent.CONNECT, frozenset()
            return
        yield DriverEvent.LOST, frozenset()
        for facts in every(Enable, Needs, Way, ReportedMode):
            if Phase.RESTING not in machine:
                yield DriverEvent.DONE, facts
            if Phase.CONNECTING not in machine:
                yield DriverEvent.STOP, facts
                yield DriverEvent.DOUBT, facts

    def follow(self, pair, event, facts):
        """What follows, in both; and what the actuator did."""
        self.state, self.machine = pair
        self.facts = facts
        self.done = []
        connecting = Phase.CONNECTING in self.machine
        if isinstance(event, Event):
            self.tell_node(event)
        elif event is DriverEvent.CONNECT:
            self.tell_driver(event)
        elif event is DriverEvent.LOST:
            self.tell_driver(event)
            self.tell_node(Event.LOST)
        elif event is DriverEvent.DONE:
            self.tell_driver(event)
            if connecting:
                self.tell_node(Event.CONNECTED)
                if Trust.DOUBTED in self.machine or Needs.MISSING in self.facts:  # or it is elsewhere: any fact will do
                    self.tell_node(Event.MISPLACED)
                self.unsure()
            elif Phase.RESTING in self.machine:
                self.tell_node(Event.RESTED)
        else:  # an error
            stopping = self.machine & {Phase.BRAKING, Phase.RESETTING}
            if event is DriverEvent.DOUBT:
                self.tell_driver(event)
            self.tell_driver(DriverEvent.LOST if stopping else DriverEvent.STOP)
            self.tell_node(Event.LOST if stopping else Event.FAILED)
            if not stopping:
                self.unsure()
        return (self.state, self.machine), self.done

    def unsure(self):
        if ReportedMode.ALARM in self.facts or Trust.DOUBTED in self.machine:
            self.tell_node(Event.UNSURE)

    def tell_node(self, event):
        idle = {Phase.RESTING, ReportedMode.IDLE} <= self.machine | self.facts
        facts = self.facts | {self.homing, Controller.IDLE if idle else Controller.NOT_IDLE}
        following = step(ACTUATOR, self.state, event, facts)
        if following is None:
            return
        self.state = following.state
        told = {
            Action.MOVE: DriverEvent.MOVE,
            Action.RETRACT: DriverEvent.MOVE,
            Action.BRAKE: DriverEvent.STOP,
            Action.RECOVER: DriverEvent.RECOVER,
            Action.LEAVE: DriverEvent.LOST,
        }
        for action in following.actions:
            self.done.append(action)
            accepted = self.tell_driver(told[action]) if action in told else True
            if not accepted and action not in (Action.BRAKE, Action.LEAVE):
                self.tell_node(Event.FAILED)

    def tell_driver(self, event):
        status = self.facts & set(ReportedMode)
        following = step(DRIVER, self.machine, event, {self.homing, Role.DRIVES, *(status or {ReportedMode.OTHER})})
        self.machine = self.machine if following is None else following.state
        return following is not None


@pytest.fixture(scope="module", params=list(Homing), ids=lambda homing: homing.name)
def pair(request):
    return Pair(request.param)


def test_the_driver_is_in_a_stroke_only_while_a_push_is_under_way_and_allowed(pair):
    for (_, machine), event, facts, (after, machine_after), _ in pair.steps:
        if Phase.STREAMING in machine_after:
            assert after >= READY, event
            assert after & {Task.PUSHING, Task.RETRACTING}
            if Phase.STREAMING not in machine:
                assert facts >= {Enable.ENABLED, Needs.MET}
                assert Trust.TRUSTED in machine
        if machine_after & {Phase.HOMING, Phase.UNLOCKING, Phase.RECOVERING} or Next.RECOVERY in machine_after:
            assert after >= {Task.RECOVERING, Life.ACTIVE, Hold.FREE}
        if Task.NONE in after and Phase.RESTING not in machine_after:
            assert machine_after & {Phase.BRAKING, Phase.RESETTING}


def test_what_a_push_needs_is_gone_and_it_is_stopped_at_once(pair):
    for (_, machine), event, facts, (_, machine_after), _ in pair.steps:
        if Phase.STREAMING in machine and event is Event.CHECKED and facts & {Enable.DISABLED, Needs.MISSING}:
            assert Phase.BRAKING in machine_after or Phase.RESETTING in machine_after
        if Phase.HOMING in machine and event is Event.CHECKED and Enable.DISABLED in facts:
            assert Phase.RESETTING in machine_after
        if event in (Event.STOP, Event.DEACTIVATE, Event.LEAVE):
            assert not machine_after & {Phase.STREAMING, Phase.RECOVERING, Phase.HOMING, Phase.UNLOCKING}


def test_each_client_is_told_once_how_its_push_ended(pair):
    for (state, _), event, _, (after, _), actions in pair.steps:
        assert actions.count(Action.TELL) == bool(state & UNDER_WAY and not after & UNDER_WAY), event
        assert not state & UNDER_WAY or after & UNDER_WAY or Action.TELL in actions
        if not state & UNDER_WAY and after & UNDER_WAY:
            assert (event, Task.WAITING in after) == (Event.GOAL, True)


def test_a_person_can_always_make_it_ready_again(pair):
    """From each state in which it is active and connected, some sequence of resets and ends of scripts leads to readiness."""
    back: dict = {}
    for before, event, facts, after, _ in pair.steps:
        if event in (Event.RESET, DriverEvent.DONE, Event.CANCEL) and ReportedMode.IDLE in facts and Enable.ENABLED in facts:
            back.setdefault(after, set()).add(before)
    good = {one for one in pair.reached if one[0] >= READY | {Task.NONE} and Phase.RESTING in one[1]}
    due = deque(good)
    while due:
        for before in back.get(due.popleft(), set()) - good:
            good.add(before)
            due.append(before)
    stuck = {one for one in pair.reached - good if Life.ACTIVE in one[0] and Task.DISCONNECTED not in one[0]}
    assert not stuck


def test_what_is_accepted():
    needed = {
        Event.CONFIGURE: {Life.UNCONFIGURED},
        Event.ACTIVATE: {Life.INACTIVE, Task.NONE},
        Event.GOAL: READY | {Task.NONE, Enable.ENABLED, Controller.IDLE},
        Event.STOP: set(),
        Event.LEAVE: set(),
        Event.LOST: set(),
    }
    for state, event, facts, following in every_pair(ACTUATOR):
        if event in needed:
            assert (following is not None) == (state | facts >= needed[event])


MET = {Enable.ENABLED, Needs.MET, Controller.IDLE}
REFUSED, ANYTHING = "refused", "anything"
ALONG = {
    "a push that comes back": [
        (Event.CONFIGURE, set(), {Life.INACTIVE, Position.KNOWN}, []),
        (Event.CONNECTED, set(), {Task.NONE}, []),
        (Event.ACTIVATE, set(), READY, []),
        (Event.GOAL, MET, {Task.WAITING}, []),
        (Event.CHECKED, {Enable.ENABLED, Needs.AWAITED}, {Task.WAITING}, REFUSED),
        (Event.CHECKED, MET, {Task.PUSHING}, [Action.MOVE]),
        (Event.CHECKED, MET, {Task.PUSHING}, REFUSED),
        (Event.RESTED, MET | {Way.RETURNS}, {Task.RETRACTING}, [Action.RETRACT]),
        (Event.RESTED, MET | {Way.RETURNS}, READY | {Task.NONE}, [Action.TELL]),
        (Event.GOAL, MET, {Task.WAITING}, []),
        (Event.CANCEL, MET, {Task.NONE}, [Action.TELL]),
        *[
            step
            for event in (Event.STOP, Event.DEACTIVATE, Event.CANCEL, Event.CHECKED)
            for task in (Task.WAITING, Task.PUSHING, Task.RETRACTING)
            for lacking in ({Enable.DISABLED, Needs.MET}, {Enable.ENABLED, Needs.MISSING})
            for step in [
                (Event.GOAL, MET, {Task.WAITING}, []),
                *[(Event.CHECKED, MET, {Task.PUSHING}, [Action.MOVE])] * (task is not Task.WAITING),
                *[(Event.RESTED, MET | {Way.RETURNS}, {Task.RETRACTING}, [Action.RETRACT])] * (task is Task.RETRACTING),
                (event, lacking, {Task.NONE}, [Action.TELL])
                if task is Task.WAITING
                else (event, lacking, {Task.ABORTING}, [Action.BRAKE]),
                *[(Event.RESTED, MET, {Task.NONE}, [Action.TELL])] * (task is not Task.WAITING),
                (Event.ACTIVATE, MET, {Life.ACTIVE}, ANYTHING),
                (Event.STOP, MET, {Hold.HELD}, []),
                (Event.RESET, MET, READY, [Action.CLEAR]),
            ]
        ],
        (Event.GOAL, MET, {Task.WAITING}, []),
        (Event.CHECKED, MET, {Task.PUSHING}, [Action.MOVE]),
        (Event.RESTED, MET, READY | {Task.NONE}, [Action.TELL]),
        (Event.FAILED, MET, {Task.NONE}, REFUSED),
        (Event.DEACTIVATE, MET, {Life.INACTIVE}, []),
        (Event.RESET, MET, {Life.INACTIVE, Task.NONE}, REFUSED),
        (Event.CONNECTED, MET, {Task.NONE}, REFUSED),
        (Event.LEAVE, MET, {Life.UNCONFIGURED, Task.DISCONNECTED, Position.KNOWN}, [Action.LEAVE]),
        (Event.CONNECTED, MET, {Task.DISCONNECTED}, REFUSED),
    ],
    "stops": [
        (Event.CONFIGURE, set(), set(), []),
        (Event.CONNECTED, set(), set(), []),
        (Event.ACTIVATE, set(), READY, []),
        (Event.GOAL, MET, set(), []),
        (Event.CHECKED, MET, {Task.PUSHING}, [Action.MOVE]),
        (Event.STOP, MET, {Task.ABORTING, Hold.HELD}, [Action.BRAKE]),
        (Event.RESET, {Enable.ENABLED, Controller.NOT_IDLE}, {Task.ABORTING, Hold.HELD}, REFUSED),
        (Event.RESTED, MET, {Task.NONE, Hold.HELD}, [Action.TELL]),
        (Event.RESET, {Enable.DISABLED, Controller.IDLE}, READY, [Action.CLEAR]),
        (Event.UNSURE, MET, {Position.UNKNOWN, Task.NONE}, []),
        (Event.RESET, {Enable.DISABLED, Controller.IDLE}, {Position.UNKNOWN, Task.NONE}, REFUSED),
        (Event.RESET, MET, {Task.RECOVERING, Position.UNKNOWN}, [Action.RECOVER]),
        (Event.CHECKED, {Enable.DISABLED}, {Task.RECOVERING}, REFUSED),
        (Event.RESET, MET, {Task.RECOVERING}, []),
        (Event.RESTED, MET, READY | {Task.NONE}, [Action.CLEAR]),
        (Event.RESET, MET, {Task.RECOVERING, Position.KNOWN}, [Action.RECOVER]),
        (Event.FAILED, MET, {Task.NONE, Position.KNOWN}, []),
        (Event.STOP, MET, {Hold.HELD}, []),
        (Event.RESET, {Enable.ENABLED, Controller.NOT_IDLE}, {Task.RECOVERING, Hold.FREE}, [Action.RECOVER]),
        (Event.STOP, MET, {Task.NONE, Hold.HELD}, [Action.BRAKE]),
        (Event.LOST, MET, {Task.DISCONNECTED, Hold.HELD}, []),
        (Event.RESET, MET, {Task.DISCONNECTED, Hold.HELD}, REFUSED),
        (Event.CONNECTED, MET, {Task.NONE}, []),
        (Event.MISPLACED, MET, {Position.UNKNOWN, Hold.HELD}, []),
        (Event.RESET, MET, {Task.RECOVERING, Hold.FREE}, [Action.RECOVER]),
    ],
    "homing": [
        (Event.CONFIGURE, set(), {Position.UNHOMED}, []),
        (Event.CONNECTED, set(), {Position.UNHOMED}, []),
        (Event.ACTIVATE, {Enable.DISABLED}, {Life.ACTIVE, Position.UNHOMED, Task.NONE}, []),
        (Event.DEACTIVATE, MET, {Life.INACTIVE}, []),
        (Event.ACTIVATE, MET, {Life.ACTIVE, Position.UNHOMED, Task.RECOVERING}, [Action.RECOVER]),
        (Event.DEACTIVATE, MET, {Life.INACTIVE, Position.UNHOMED, Task.NONE}, [Action.BRAKE]),
        (Event.ACTIVATE, MET, {Task.RECOVERING}, [Action.RECOVER]),
        (Event.RESTED, MET, READY | {Task.NONE}, [Action.CLEAR]),
        (Event.RESET, MET, {Task.RECOVERING, Position.KNOWN}, [Action.RECOVER]),
        (Event.CHECKED, {Enable.ENABLED}, {Task.RECOVERING, Position.KNOWN}, REFUSED),
        (Event.CHECKED, {Enable.DISABLED}, {Task.NONE, Position.UNHOMED}, [Action.BRAKE]),
        (Event.CHECKED, {Enable.DISABLED}, {Task.NONE, Position.UNHOMED}, REFUSED),
        (Event.RESET, MET, {Task.RECOVERING}, [Action.RECOVER]),
        (Event.RESTED, MET, READY, [Action.CLEAR]),
        *[
            step
            for event in (Event.STOP, Event.DEACTIVATE, Event.FAILED, Event.LOST, Event.LEAVE)
            for step in [
                (Event.RESET, MET, {Task.RECOVERING, Position.KNOWN}, [Action.RECOVER]),
                (event, MET, {Position.UNHOMED}, ANYTHING),
                (Event.CONFIGURE, MET, set(), ANYTHING),
                (Event.CONNECTED, MET, set(), ANYTHING),
                (Event.ACTIVATE, MET, {Life.ACTIVE}, ANYTHING),
                (Event.RESET, MET, {Task.RECOVERING, Hold.FREE}, ANYTHING),
                (Event.RESTED, MET, READY, [Action.CLEAR]),
            ]
        ],
        (Event.DEACTIVATE, MET, {Position.KNOWN}, []),
        (Event.LEAVE, MET, {Life.UNCONFIGURED, Position.KNOWN}, [Action.LEAVE]),
        (Event.CONFIGURE, MET, {Life.INACTIVE, Position.UNHOMED}, []),
        (Event.CONNECTED, MET, {Task.NONE}, []),
        (Event.MISPLACED, MET, {Position.UNKNOWN}, []),
        (Event.ACTIVATE, MET, {Life.ACTIVE, Position.UNKNOWN, Task.NONE}, []),
    ],
}


@pytest.mark.parametrize("name", ALONG)
def test_an_actuator_goes_from_state_to_state(name):
    homing = Homing.HOMES if name == "homing" else Homing.UNLOCKS
    state = at_first(homing is Homing.HOMES)
    for event, facts, members, actions in ALONG[name]:
        facts = {Way.ONE_WAY, homing, *facts}
        following = step(ACTUATOR, state, event, facts if Way.RETURNS not in facts else facts - {Way.ONE_WAY})
        state = state if following is None else following.state
        assert state >= members, event
        assert actions is ANYTHING or actions == (REFUSED if following is None else list(following.actions)), event
