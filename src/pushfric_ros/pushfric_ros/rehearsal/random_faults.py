"""Faults at random moments of a push: `kill -9` of the host's processes, and damage to the line."""

import random
import signal
import time
from collections.abc import Iterator

from pushfric_core.simulated.line_damage import LineDamage, random_damage
from pushfric_msgs.msg import PusherState
from pushfric_ros.rehearsal.faults import (
    TRUE,
    WATCHED,
    Excess,
    Fault,
    cell_ends,
    cell_signalled,
    signalled,
    waits_for_a_person,
)
from pushfric_ros.rehearsal.grbl_stage import GrblStage
from pushfric_ros.rehearsal.stage import words_of

KINDS = ("actuator", "client of a push", "experiment", "command line")
EARLIEST, LATEST = 0.05, 0.9  # of a push, for a kill
LATEST_DAMAGE = 0.8  # of a push
MOMENTS = ("in mid-push", "while it is stopped", "while an actuator connects")
CONNECTING = 5.0
"""An actuator tries to connect through a damaged line for this long [s]."""
PLAUSIBLE = 2.5e-3
"""A wrong digit that changes the position by less than this looks like a motion at 2 cm/s [m]."""


def kills(times: int, seed: int) -> Iterator[Fault[GrblStage]]:
    """Kill each kind of process in turn. The remaining processes go on; a new actuator must wait for a person.

    The experiment and the command line are those of a whole cell, with a rendered camera (`run --simulated-camera`).
    """
    randomly = random.Random(seed)
    for k in range(times):
        kind, share = KINDS[k % len(KINDS)], randomly.uniform(EARLIEST, LATEST)
        if kind == "actuator":
            yield Fault(kind, signalled(signal.SIGKILL, client=False, share=share), check=waits_for_a_person)
        elif kind == "client of a push":
            yield Fault(kind, signalled(signal.SIGKILL, client=True, share=share))
        else:
            yield Fault(kind, cell_signalled(signal.SIGKILL, kind, share), check=cell_ends)


def damages(times: int, seed: int) -> Iterator[Fault[GrblStage]]:
    """Damage the line in each of the `MOMENTS` in turn, until everything has ended. Afterwards, the line works again."""
    randomly = random.Random(seed)
    for k in range(times):
        moment, share = MOMENTS[k % len(MOMENTS)], randomly.uniform(EARLIEST, LATEST_DAMAGE)
        damage = random_damage(randomly.getrandbits(32))
        name = f"{moment}: {damage.name}"
        if moment == MOMENTS[2]:
            yield _of_a_connection(name, damage)
        else:
            yield _of_a_push(name, damage, share, stops=moment == MOMENTS[1])


def _of_a_push(name: str, damage: LineDamage, share: float, stops: bool) -> Fault[GrblStage]:
    def bring_about(stage: GrblStage) -> float:
        stage.states.clear()
        stage.under_way(share)
        client, begin = stage.client, time.monotonic()
        assert client is not None
        damage.begin(stage.line)
        if stops:
            stage.person.say_stop()
        stage.wait(lambda: client.poll() is not None, "the end of the push")
        stage.pause(damage.delay)
        return begin

    def check(stage: GrblStage) -> str | None:
        assert stage.client is not None
        rest = stage.along()
        if stage.client.returncode == 0 and abs(rest - stage.reach) > stage.same:
            return f"it rests at {1e3 * rest:.2f} mm, and the client was told: {words_of(stage.client)}"
        if not damage.to_controller and rest > stage.reach + stage.same:
            return f"it went to {1e3 * rest:.2f} mm, beyond the push"
        return _healed(stage)

    return Fault(name, bring_about, None, check, TRUE if damage.to_controller else PLAUSIBLE)


def _of_a_connection(name: str, damage: LineDamage) -> Fault[GrblStage]:
    def bring_about(stage: GrblStage) -> float:
        begin = time.monotonic()
        stage.end_actuator()
        damage.begin(stage.line)
        stage.start_actuator()
        stage.pause(CONNECTING + damage.delay)
        problem = _healed(stage) if abs(stage.along()) <= stage.same else "it moved unasked"
        if problem is not None:
            raise Excess(problem)
        stage.states.clear()
        return begin

    return Fault(name, bring_about)


def _healed(stage: GrblStage) -> str | None:
    """Make the line whole: nothing may move unasked, and a position that is published as known must be true."""
    stage.line.heal()
    rest = stage.along()
    stage.pause(WATCHED)
    stage.states.clear()
    stage.wait(lambda: stage.states, "a state")
    state = stage.states[-1][1]
    if abs(stage.along() - rest) > stage.same:
        return "it moved again when the line was whole"
    there = state.position - stage.position
    if state.mode not in (PusherState.MODE_ALARM, PusherState.MODE_DISCONNECTED) and abs(there - rest) > TRUE:
        return f"it rests at {1e3 * rest:.2f} mm, and {1e3 * there:.2f} mm is published"
    stage.make_ready()
    there = stage.states[-1][1].position - stage.position
    if abs(there - rest) > TRUE:
        return f"it rests at {1e3 * rest:.2f} mm, and {1e3 * there:.2f} mm is published after a reset"
    return None
