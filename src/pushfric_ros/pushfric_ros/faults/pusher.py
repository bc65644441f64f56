"""The faults of a moving pusher: the table that is rehearsed, and faults drawn by a seed."""

import os
import random
import re
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

from geometry_msgs.msg import WrenchStamped
from std_msgs.msg import Bool

from pushfric_core.cell.node_settings import PlanConfig
from pushfric_core.pushers.grbl import RESET_PATIENCE
from pushfric_core.pushers.pusher import Grade
from pushfric_core.pushers.serial_checks import check_controller
from pushfric_core.pushers.serial_pusher import SILENCE
from pushfric_core.pushers.stroke import OFF_WAY
from pushfric_core.simulated.faulty_line import Filter, nothing, once
from pushfric_msgs.msg import PusherState
from pushfric_ros.faults.fault import EndedEarly, Fault, demand
from pushfric_ros.faults.grbl_stage import GrblStage
from pushfric_ros.faults.line import LineDamage, in_lines, random_damage, straying
from pushfric_ros.faults.processes import end, pid_of, words_of
from pushfric_ros.faults.stage import EVENT_TIMEOUT, MID_PUSH, REACTION, Stage
from pushfric_ros.node_kit.person import NoAnswer
from pushfric_ros.node_kit.qos import RELIABLE, SENSOR_DATA

OWNER = 0.5  # after the owner of a push is gone, the pusher rests within this time and the braking [s]
RESOLUTION = 2e-4  # of what is measured: a report comes every 20 ms, and positions between are interpolated [m]
WATCHED = 1.0  # a pusher that rests is watched for this long [s]
LATE_GREETING = 3.0  # [s]
LATE_ANSWERS = 0.08  # [s]
SEEN_TWICE = 3.0  # a work offset comes with every 30th report at the latest [s]
ENABLE_TIMEOUT = 0.5  # [s]
LOST = PlanConfig.lost_object + OWNER  # [s]
MAX_FORCE = 5.0  # [N]
TRUE = 1e-4  # a published position must be true within this [m]
LATELY = 0.5  # a state describes a moment at most this far from its stamp [s]
HOSTILE = ((b"$120=", b"0"), (b"$100=", b"0.000"), (b"$22=", b"1e999"), (b"$110=", b"9" * 4300), (b"$27=", b"-1"))
PLAUSIBLE = 2.5e-3
"""A wrong digit that changes the position by less than this looks like a motion at 2 cm/s [m]."""
ALONE = 6.0
"""Duration of another program's motion [s]: long enough for a new process to start before its end."""


# What must follow


@dataclass(frozen=True)
class Rests:
    """The pusher comes to rest, and stays there."""

    within: float | None = REACTION
    """The pusher may go on for this long [s]; None: until it has left the way of its push, wherever that is."""
    check: Callable[[Any], None] = lambda stage: None
    """Called with the stage once the pusher rests; raises `Otherwise`."""
    true: float = TRUE
    """A published position must be true within this [m]."""
    goes_on: bool = False
    """The push must go on to its end, as if nothing had happened."""

    def __call__(self, stage: Stage, begin: float | None, found: dict[str, Any]) -> None:
        """Wait until the pusher rests, watch it for a while, and judge what it did since the stage was ready.

        `found` gets the time from the fault until the pusher rested [s], the distance after the fault and the largest
        allowed [m], unless it was not to stop.
        """
        given = stage.given
        # on a busy machine a push may pause
        if self.goes_on and stage.client is not None and (client := stage.client_ends()).returncode:
            raise EndedEarly(f"the push was to go on, but it ended: {words_of(client)}")
        at_rest = stage.rest()
        heard = stage.heard[stage.first :]
        furthest, fastest = max(one.along for one in heard), max(one.speed for one in heard)
        if self.goes_on or begin is None:
            ends = f"it rests at {1e3 * at_rest.along:.2f} mm, the push ends at {1e3 * stage.reach:.2f} mm"
            demand(abs(at_rest.along - stage.reach) <= stage.same, ends)
            demand(fastest <= 1.05 * given.speed, f"it went at {1e3 * fastest:.1f} mm/s")
        else:
            there, allowed = stage.at(begin), (self.within or 0.0) * given.speed + stage.braking
            if self.within is None:
                allowed += max(0.0, stage.reach - there) + OFF_WAY + REACTION * given.speed
            travelled = abs(at_rest.along - there)
            found.update(seconds=stage.seconds_until(at_rest, begin), travelled=travelled, allowed=allowed)
        demand(furthest <= given.stroke, f"it went to {1e3 * furthest:.1f} mm, beyond the stroke")
        demand(not found or travelled <= allowed + RESOLUTION, "it went too far")
        stays(stage, at_rest.along, WATCHED, "it moved again")
        for when, state in stage.states:
            if when < heard[0].when or state.mode == PusherState.MODE_DISCONNECTED:
                continue
            there, lately = state.position - stage.position, [one.along for one in stage.between(when - LATELY, when + LATELY)]
            places = f"the pusher was at {1e3 * min(lately):.2f} to {1e3 * max(lately):.2f} mm"
            is_true = min(lately) - self.true <= there <= max(lately) + self.true
            demand(is_true, f"{1e3 * there:.2f} mm was published, but {places}")
        moving = stage.mode() == PusherState.MODE_RUNNING and stage.states[-1][0] > at_rest.when + WATCHED / 2
        demand(not moving, "the published state says that the pusher moves, but it rests")
        self.check(stage)
        demand("Traceback" not in stage.log.read_text(errors="replace"), "the actuator ended with a traceback")


def stays(stage: Stage, rest: float, seconds: float, otherwise: str) -> None:
    """Watch the pusher for this long [s]; it must stay at a place [m]."""
    stage.pause(seconds)
    demand(abs(stage.along() - rest) <= stage.same, otherwise)


def known_by_another_name(stage: GrblStage) -> None:
    """A new actuator must wait for a person, although its port has another name."""
    name = stage.folder / "by-another-name"
    name.symlink_to(stage.line.port)
    stage.port = str(name)
    try:
        stage.start_actuator()
        waits_for_a_person(stage)
    finally:
        stage.end_actuator()
        stage.port = stage.line.port
        name.unlink()


def cell_ends(stage: GrblStage) -> None:
    """All processes of the cell must end, and move nothing."""
    rest = stage.along()
    stage.cell_has_ended()
    stays(stage, rest, 0.0, "it moved again when the cell ended")


def cell_stays(stage: GrblStage) -> None:
    """The pusher must stay where it is, as long as the object is not seen."""
    stays(stage, stage.along(), 2 * WATCHED, "it moved although the object was not seen")
    os.kill(pid_of("simulated_cell", stage.folder), signal.SIGCONT)
    end(stage.client)
    stage.cell_has_ended()


def goes_on_and_moves_nothing(stage: Stage) -> None:
    """Let the stopped process go on; nothing may move."""
    rest = stage.along()
    signalled(signal.SIGCONT, "actuator", "client")(stage)
    stays(stage, rest, 2 * WATCHED, "it moved again when the process went on")


def client_is_told(stage: Stage) -> None:
    """The client must get a result, and the last state must be true."""
    said = words_of(stage.client_ends())
    demand("told to end" in said, f"the client was told: {said}")
    state, true = stage.states[-1][1], stage.position + stage.along()
    says = f"the last state says mode {state.mode} at {1e3 * state.position:.2f} mm, it rests at {1e3 * true:.2f} mm"
    demand(state.mode != PusherState.MODE_RUNNING and abs(state.position - true) <= TRUE, says)


def whole_again(stage: GrblStage) -> None:
    """The line works again, but only after the actuator has given up the connection."""
    stage.pause(SILENCE + RESET_PATIENCE + WATCHED)
    waits_for_a_person(stage)


def waits_for_a_person(stage: Stage) -> None:
    """Once the line works again, the actuator, or the next one, must say that the position is unknown, and wait."""
    stage.heal()
    stage.witness()
    rest = stage.along()
    stage.states.clear()
    stage.wait(lambda: stage.mode() == PusherState.MODE_ALARM, "the actuator to say that the position is not known")
    try:
        stage.person.jog(1e-3, stage.given.speed)
    except NoAnswer:
        stays(stage, rest, 0.0, "it moved unasked")
    else:
        demand(False, "it accepted a push without a reset")


def is_released(stage: Stage) -> None:
    """The pusher must be held without an alarm, and a person's reset must release it."""
    stage.pause(LATE_GREETING)
    stage.states.clear()
    stage.wait(lambda: stage.mode() is not None, "a state")
    demand(stage.mode() == PusherState.MODE_HOLD, f"the published mode is {stage.mode()}, expected that of a hold")
    answer = stage.person.call("actuator/reset")
    demand(answer == "released", f"a reset was answered with {answer!r}")


# How each fault is caused


def mid_push(act: Callable[[Any], object] = lambda stage: None, share: float = MID_PUSH) -> Callable[[Stage], float]:
    """Do something to the stage once a push has covered this share."""

    def cause(stage: Stage) -> float:
        stage.under_way(share)
        begin = time.monotonic()
        act(stage)
        return begin

    return cause


def signalled(number: signal.Signals, *names: str) -> Callable[[Stage], None]:
    """Send a signal to the "actuator", the "client" of its push, or both."""

    def act(stage: Stage) -> None:
        for process in (getattr(stage, name) for name in names):
            if process.poll() is None:
                process.send_signal(number)

    return act


def cell_signalled(number: signal.Signals, node: str, share: float = MID_PUSH) -> Callable[[GrblStage], float]:
    """Send a signal to a node of a whole cell, or its "command line", in a push; the cell's other processes live on."""

    def cause(stage: GrblStage) -> float:
        run = stage.cell_under_way(share)
        pid = run.pid if node == "command line" else pid_of(node, stage.folder)
        begin = time.monotonic()
        os.kill(pid, number)
        return begin

    return cause


def damaged(share: float = MID_PUSH, **filters: Callable[[GrblStage], Filter]) -> Callable[[GrblStage], float]:
    """Set filters of the line in mid-push, and wait until one of them has changed anything."""

    def act(stage: GrblStage) -> None:
        stage.line.damage(**{way: make(stage) for way, make in filters.items()})
        caused(stage)

    return mid_push(act, share)


def caused(stage: GrblStage) -> None:
    """Wait until the line has damaged anything."""
    assert stage.client is not None
    client = stage.client
    stage.wait(lambda: stage.line.damaged or client.poll() is not None, "the damage")
    if not stage.line.damaged:
        raise EndedEarly("the push ended before anything was damaged")


def silent(stage: Stage) -> Filter:
    return nothing


def faster(stage: GrblStage) -> Filter:
    """A filter that changes the feed of each jog."""
    return lambda data: re.sub(rb"F(\d+)", lambda feed: b"F%d" % (5 * int(feed[1])), data)


def longer(stage: GrblStage) -> Filter:
    """A filter that adds a digit to the next place that the pusher is sent to."""
    axis = stage.grbl.axis[-1].encode()
    return once(axis, axis + b"9")


def another_axis(stage: GrblStage) -> Filter:
    """From now on, reports say that another axis moves as fast as the pusher, as after a damaged letter of a command."""
    begin, other = time.monotonic(), int(stage.grbl.axis[-1] == "X")
    return straying(other, lambda: 1e3 * stage.given.speed * (time.monotonic() - begin))


def other_offset(stage: GrblStage) -> Filter:
    """From now on, reports have another work offset, as if another program had set one."""
    return lambda data: data.replace(b"WCO:", b"WCO:9")


def offset_damaged(stage: GrblStage) -> None:
    """Put a wrong digit into the first work offset that a new actuator asks for."""
    stage.end_actuator()
    wrong = once(b"WCO:", b"WCO:9")

    def asked(data: bytes) -> bytes:
        stage.line.to_host = wrong
        return data

    stage.line.damage(to_controller=asked)
    stage.start_actuator()
    stage.make_ready()
    stage.under_way()
    caused(stage)


def late_answers(stage: GrblStage) -> None:
    """Delay all that the controller says."""
    stage.line.delay_to_host = LATE_ANSWERS
    stage.pause(WATCHED)
    stage.under_way()


def modes_changed(stage: GrblStage) -> None:
    """Switch to inches, incremental distances and 200 % of the feed, as another program might, before a push and in it."""
    for line in ("G20", "G91"):
        stage.ask(line)
    stage.line.tell_controller(b"\x91" * 10)
    mid_push(lambda stage: stage.line.tell_controller(b"\x91" * 10))(stage)


def moved_alone(stage: GrblStage) -> list[tuple[float, bytes]]:
    """Send one line as another program would: over the whole reach, slowly, in millimetres whatever the modes are.

    Returns:
        All that is sent to the controller afterwards, and when.
    """
    stage.end_actuator()
    slow = min(stage.given.speed, stage.reach / ALONE)
    line = f"$J=G21G91{stage.grbl.axis[-1]}{stage.sign * 1e3 * stage.reach:.3f}F{60e3 * slow:.3f}\n"
    stage.line.tell_controller(line.encode())
    stage.wait(lambda: stage.along() > 0.02 * stage.reach, "somebody else's motion")
    passed: list[tuple[float, bytes]] = []

    def listen(data: bytes) -> bytes:
        passed.append((time.monotonic(), data))
        return data

    stage.line.damage(to_controller=listen)
    return passed


def found_moving(stage: GrblStage) -> float:
    """Start a new actuator while the controller carries out another program's line."""
    passed = moved_alone(stage)
    stage.start_actuator()
    stage.wait(lambda: passed, "the first question")
    if stage.along() > stage.reach - stage.same:
        raise EndedEarly("the other program's motion ended before an actuator was there")
    return passed[0][0]


def late_greeting(stage: GrblStage) -> None:
    """Delay the controller's answer to the reset that ends a stop."""

    def late(data: bytes) -> bytes:
        stage.line.delay_to_host = LATE_GREETING if b"rbl" in data else 0.0
        return data

    stage.line.damage(to_host=late)
    stop(stage)


def stop(stage: Stage) -> None:
    """Call the service that stops the pusher."""
    stage.person.call("actuator/stop")


def hostile_settings(stage: GrblStage) -> None:
    """Answer with impossible settings; the doctor and the driver must say so in one line."""
    stage.end_actuator()
    config, driver = stage.config()
    listed = "\n".join(stage.ask("$$"))
    for key, value in HOSTILE:
        if key.decode() not in listed:  # FluidNC keeps some of them elsewhere
            continue
        stage.line.damage(to_host=in_lines(key, value))
        check, limits = check_controller(driver, config)
        refused = check.level is Grade.FAILED and limits is None and "\n" not in check.finding and len(check.finding) <= 300
        demand(refused, f"{key.decode()}{value[:10].decode()} was answered with {check.finding[:100]!r}")
    stage.heal()
    stage.start_actuator()
    stage.make_ready()
    stage.under_way()


def looked_at(stage: GrblStage) -> None:
    """Run the doctor while the controller moves: it must send only questions, and say that the controller moves."""
    passed = moved_alone(stage)
    config, driver = stage.config()
    check, _ = check_controller(driver, config)
    stage.heal()
    asked = b"".join(data for _, data in passed)
    demand(set(asked) == {ord("?")}, f"the doctor sent {asked[:40]!r}")
    demand("it moves now" in check.finding, f"the doctor found {check.finding!r}")


def no_more_enable(stage: Stage) -> float:
    """Withdraw the enable that an actuator has been told to need."""
    stage.start_actuator(enable_timeout=ENABLE_TIMEOUT)
    with stage.person.repeating("enable", Bool(data=True), RELIABLE, EVENT_TIMEOUT):
        stage.make_ready()
        stage.under_way()
    return time.monotonic()


def too_much_force(stage: Stage) -> float:
    """Report a force beyond the limit that an actuator has been given."""
    stage.start_actuator(max_force=MAX_FORCE)
    force = WrenchStamped()
    with stage.person.repeating("wrench", force, SENSOR_DATA, EVENT_TIMEOUT):
        stage.make_ready()
        stage.under_way()
        begin = time.monotonic()
        force.wrench.force.x = 2 * MAX_FORCE
        stage.wait(lambda: stage.mode() == PusherState.MODE_HOLD, "the hold")
    return begin


def at_the_controller(byte: bytes) -> Callable[[Stage], float]:
    """Have an input of the controller end the push; the byte does what the input does."""
    return mid_push(lambda stage: stage.line.tell_controller(byte))


def sent(number: signal.Signals, *names: str, share: float = MID_PUSH) -> Callable[[Stage], float]:
    """Send a signal in mid-push to the "actuator", the "client" of the push, or both."""
    return mid_push(signalled(number, *names), share)


KILL, SUSPEND = signal.SIGKILL, signal.SIGSTOP
GOES_ON, AWAITS_A_PERSON, IS_RELEASED = Rests(goes_on=True), Rests(check=waits_for_a_person), Rests(check=is_released)

CONTRACT: tuple[Fault[Stage], ...] = (
    Fault("no fault", mid_push(), GOES_ON),
    Fault("kill -9 of the actuator", sent(KILL, "actuator"), AWAITS_A_PERSON),
    Fault("SIGSTOP of the actuator", sent(SUSPEND, "actuator"), Rests(check=goes_on_and_moves_nothing)),
    Fault("SIGTERM of the actuator", sent(signal.SIGTERM, "actuator"), Rests(check=client_is_told)),
    Fault("kill -9 of the push's client", sent(KILL, "client"), Rests(OWNER)),
    Fault("SIGSTOP of the push's client", sent(SUSPEND, "client"), Rests(OWNER, goes_on_and_moves_nothing)),
    Fault("SIGSTOP of both, as by a suspension", sent(SUSPEND, "actuator", "client"), Rests(check=goes_on_and_moves_nothing)),
    Fault("somebody calls actuator/stop", mid_push(stop), IS_RELEASED),
    Fault("the enable is withdrawn", no_more_enable, Rests(ENABLE_TIMEOUT + REACTION)),
    Fault("the force is too great", too_much_force, IS_RELEASED),
)
"""The rows that every driver must pass, with a controller of any kind."""

FAULTS: tuple[Fault[GrblStage], ...] = (
    *CONTRACT,
    Fault("a byte of a command is lost", damaged(0.5, to_controller=lambda stage: once(b".", b"")), Rests(None)),
    Fault("a digit is added to a command", damaged(0.5, to_controller=longer), Rests(None)),
    Fault("every feed is changed to five times the commanded one", damaged(0.5, to_controller=faster), Rests(None)),
    Fault("another program sets inches, increments and 200 % feed", modes_changed, GOES_ON),
    Fault("kill -9 of the actuator, then another name of its port", sent(KILL, "actuator"), Rests(check=known_by_another_name)),
    Fault("SIGSTOP of a cell's experiment", cell_signalled(SUSPEND, "experiment"), Rests(OWNER, cell_ends)),
    Fault("a cell's camera loses the object", cell_signalled(SUSPEND, "simulated_cell", 0.1), Rests(LOST, cell_stays)),
    Fault("the controller goes silent", damaged(to_host=silent), Rests()),
    Fault("the cable is cut", damaged(to_host=silent, to_controller=silent), Rests(check=whole_again)),
    Fault("a new actuator finds the controller moving", found_moving, AWAITS_A_PERSON),
    Fault("the greeting after a stop comes 3 s late", mid_push(late_greeting), IS_RELEASED),
    Fault("impossible settings", hostile_settings, GOES_ON),
    Fault("another axis is reported to move", damaged(to_host=another_axis), AWAITS_A_PERSON),
    Fault("a wrong digit in the first work offset", offset_damaged, GOES_ON),
    Fault("the work offset changes in mid-push", damaged(to_host=other_offset), Rests(SEEN_TWICE, waits_for_a_person)),
    Fault("all answers come 80 ms late", late_answers, GOES_ON),
    Fault("a wrong digit in a report", damaged(to_host=lambda stage: once(b"Pos:", b"Pos:9")), GOES_ON),
    Fault("the doctor looks at a moving controller", looked_at, GOES_ON),
    Fault("the controller's door input opens", at_the_controller(b"\x84"), AWAITS_A_PERSON),
    Fault("the emergency stop is pressed, wired to the reset input", at_the_controller(b"\x18"), AWAITS_A_PERSON),
)
"""The rows that the GRBL driver must pass, too."""


# Faults at random moments

KINDS = ("actuator", "client of a push", "experiment", "command line")
EARLIEST, LATEST = 0.05, 0.9  # of a push, for a kill
LATEST_DAMAGE = 0.8  # of a push
MOMENTS = ("in mid-push", "while it is stopped", "while an actuator connects")
CONNECTING = 5.0
"""An actuator tries to connect through a damaged line for this long [s]."""


def kills(times: int, seed: int) -> Iterator[Fault[GrblStage]]:
    """Kill each kind of process in turn. The remaining processes go on; a new actuator must wait for a person.

    The experiment and the command line are those of a whole cell, with a rendered camera (`run --simulated-camera`).
    """
    randomly = random.Random(seed)
    for k in range(times):
        kind, share = KINDS[k % len(KINDS)], randomly.uniform(EARLIEST, LATEST)
        if kind in KINDS[:2]:
            must = AWAITS_A_PERSON if kind == "actuator" else Rests()
            yield Fault(kind, sent(KILL, kind.split()[0], share=share), must)
        else:
            yield Fault(kind, cell_signalled(KILL, kind, share), Rests(check=cell_ends))


def damages(times: int, seed: int) -> Iterator[Fault[GrblStage]]:
    """Damage the line in each of the `MOMENTS` in turn, until everything has ended. Afterwards, the line works again."""
    randomly = random.Random(seed)
    for k in range(times):
        moment, share = MOMENTS[k % len(MOMENTS)], randomly.uniform(EARLIEST, LATEST_DAMAGE)
        damage = random_damage(randomly.getrandbits(32))
        name = f"{moment}: {damage.name}"
        if moment == MOMENTS[2]:
            yield Fault(name, partial(_connection, damage), Rests())
        else:
            act = partial(_until_the_end, damage, moment == MOMENTS[1])
            true = TRUE if damage.to_controller else PLAUSIBLE
            yield Fault(name, mid_push(act, share), Rests(None, partial(_ends_well, damage), true))


def _until_the_end(damage: LineDamage, stops: bool, stage: GrblStage) -> None:
    damage.begin(stage.line)
    if stops:
        stage.person.say_stop()
    stage.client_ends()
    stage.pause(damage.delay)


def _ends_well(damage: LineDamage, stage: GrblStage) -> None:
    assert stage.client is not None
    rest = stage.along()
    arrived = stage.client.returncode != 0 or abs(rest - stage.reach) <= stage.same
    demand(arrived, f"it rests at {1e3 * rest:.2f} mm, and the client was told: {words_of(stage.client)}")
    beyond = not damage.to_controller and rest > stage.reach + stage.same
    demand(not beyond, f"it went to {1e3 * rest:.2f} mm, beyond the push")
    heals(stage)


def _connection(damage: LineDamage, stage: GrblStage) -> float:
    """Have a new actuator connect while the line is damaged."""
    begin = time.monotonic()
    stage.end_actuator()
    damage.begin(stage.line)
    stage.start_actuator()
    stage.pause(CONNECTING + damage.delay)
    stays(stage, 0.0, 0.0, "it moved unasked")
    heals(stage)
    stage.states.clear()
    return begin


def heals(stage: GrblStage) -> None:
    """Make the line whole: nothing may move unasked, and a position that is published as known must be true."""
    stage.line.heal()
    rest = stage.along()
    stays(stage, rest, WATCHED, "it moved again when the line was whole")
    stage.states.clear()
    stage.wait(lambda: stage.states, "a state")
    unknown = stage.states[-1][1].mode in (PusherState.MODE_ALARM, PusherState.MODE_DISCONNECTED)
    for known, after in ((not unknown, ""), (True, " after a reset")):
        if after:
            stage.make_ready()
        there = stage.states[-1][1].position - stage.position
        found = f"it rests at {1e3 * rest:.2f} mm, and {1e3 * there:.2f} mm is published{after}"
        demand(not known or abs(there - rest) <= TRUE, found)
