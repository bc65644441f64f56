"""Random damage to the line: in mid-push, while a push is stopped, and while an actuator connects."""

import random
import time
from collections.abc import Iterator
from functools import partial

from pushfric_msgs.msg import PusherState
from pushfric_ros.node_kit.person import NoAnswer
from pushfric_ros.rehearsal.faults import TRUE, WATCHED, Outcome, judged, traceback_in, tried
from pushfric_ros.rehearsal.stage import SAME, Stage, words_of
from pushfric_ros.simulated.line_damage import Damage, random_damage

EARLIEST, LATEST = 0.05, 0.8  # of a push
MOMENTS = ("in mid-push", "while it is stopped", "while an actuator connects")
CONNECTING = 5.0
"""An actuator tries to connect through a damaged line for this long [s]."""
PLAUSIBLE = 2.5e-3
"""A wrong digit that changes the position by less than this looks like a motion at 2 cm/s [m]."""


def damage(stage: Stage, times: int, seed: int) -> Iterator[Outcome]:
    """Make pushes, each with damage that begins at a random moment and lasts until everything has ended.

    Afterwards, the line works again.
    """
    randomly = random.Random(seed)
    for k in range(times):
        moment, share = MOMENTS[k % len(MOMENTS)], randomly.uniform(EARLIEST, LATEST)
        one = random_damage(randomly.getrandbits(32))
        what = f"{moment}: {one.name}"
        if moment == MOMENTS[2]:
            yield tried(partial(_of_a_connection, stage, what, one), what)
        else:
            yield tried(partial(_of_a_push, stage, what, one, share, moment == MOMENTS[1]), what)


def _of_a_push(stage: Stage, what: str, damage: Damage, share: float, stops: bool) -> Outcome:
    stage.ready()
    stage.states.clear()
    first = len(stage.heard)
    stage.under_way(share)
    client, begin = stage.client, time.monotonic()
    assert client is not None
    damage.begin(stage.line)
    if stops:
        stage.person.say_stop()
    stage.wait(lambda: client.poll() is not None, "the end of the push")
    stage.pause(damage.delay)
    outcome = judged(stage, what, begin, first, None, TRUE if damage.to_controller else PLAUSIBLE)
    stage.line.heal()
    said = words_of(client)
    if outcome.problem is None and "reached" in said and abs(stage.along() - stage.reach) > SAME:
        outcome = outcome._replace(problem=f"it rests at {1e3 * stage.along():.2f} mm, and the client was told: {said}")
    if outcome.problem is None and not damage.to_controller and stage.along() > stage.reach + SAME:
        outcome = outcome._replace(problem=f"it went to {1e3 * stage.along():.2f} mm, beyond the push")
    return outcome._replace(problem=outcome.problem or _healed(stage))


def _of_a_connection(stage: Stage, what: str, damage: Damage) -> Outcome:
    stage.ready()
    stage.end_actuator()
    damage.begin(stage.line)
    stage.start_actuator()
    stage.pause(CONNECTING + damage.delay)
    stage.line.heal()
    problem = None if abs(stage.along()) <= SAME else "it moved unasked"
    return Outcome(what, None, None, None, problem or _healed(stage))


def _healed(stage: Stage) -> str | None:
    """Once the line works again: nothing may move unasked, and a position that is published as known must be true."""
    rest = stage.along()
    stage.pause(WATCHED)
    stage.states.clear()
    stage.wait(lambda: stage.states, "a state")
    state = stage.states[-1][1]
    if abs(stage.along() - rest) > SAME:
        return "it moved again when the line was whole"
    there = state.position - stage.position
    if state.mode not in (PusherState.MODE_ALARM, PusherState.MODE_DISCONNECTED) and abs(there - rest) > TRUE:
        return f"it rests at {1e3 * rest:.2f} mm, and {1e3 * there:.2f} mm is published"
    try:
        stage.make_ready()
    except NoAnswer as error:
        return str(error)
    there = stage.states[-1][1].position - stage.position
    if abs(there - rest) > TRUE:
        return f"it rests at {1e3 * rest:.2f} mm, and {1e3 * there:.2f} mm is published after a reset"
    return traceback_in(stage)
