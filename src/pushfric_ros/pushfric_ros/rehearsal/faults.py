"""The faults that are rehearsed: how each is caused, and what must follow."""

import os
import re
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Generic, NamedTuple, TypeVar

from geometry_msgs.msg import WrenchStamped
from std_msgs.msg import Bool

from pushfric_core.cell.node_settings import PlanConfig
from pushfric_core.errors import PushfricError
from pushfric_core.pushers.grbl import RESET_PATIENCE, Grbl
from pushfric_core.pushers.pusher import Grade
from pushfric_core.pushers.serial_checks import check_controller
from pushfric_core.pushers.serial_pusher import SILENCE
from pushfric_core.pushers.stroke import OFF_WAY
from pushfric_core.simulated.faulty_line import Filter, nothing, once
from pushfric_core.simulated.line_damage import in_lines, straying
from pushfric_msgs.msg import PusherState
from pushfric_ros.node_kit.person import NoAnswer
from pushfric_ros.node_kit.qos import RELIABLE, SENSOR_DATA
from pushfric_ros.rehearsal.grbl_stage import GrblStage, cell_has_ended, cell_under_way, pid_of
from pushfric_ros.rehearsal.stage import EVENT_TIMEOUT, MID_PUSH, REACTION, TRIES, EndedEarly, Stage, end, words_of

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


class Outcome(NamedTuple):
    """The outcome of a fault."""

    fault: str
    seconds: float | None  # from the fault until the pusher rested [s]; None: the pusher was not to stop
    travelled: float | None  # distance after the fault [m]
    allowed: float | None  # largest distance allowed [m]
    problem: str | None  # what was wrong; None: nothing
    tries: int = 1  # the pushes before ended before their fault


S_contra = TypeVar("S_contra", bound=Stage, contravariant=True)


class Fault(NamedTuple, Generic[S_contra]):
    """A row of the table."""

    name: str
    bring_about: Callable[[S_contra], float | None]
    """Causes the fault; returns when, or None if the pusher must go on as if nothing had happened."""
    within: float | None = REACTION
    """The pusher may go on for this long [s]; None: until it has left the way of its push, wherever that is."""
    check: Callable[[S_contra], str | None] = lambda stage: None
    """Called once the pusher rests; returns what is wrong, or None."""
    true: float = TRUE
    """A published position must be true within this [m]."""


class Excess(PushfricError):
    """A fault did not end as it must."""


def rehearse(stage: S_contra, faults: Iterable[Fault[S_contra]]) -> Iterator[Outcome]:
    """Cause the faults one after the other; the pusher is brought back after each.

    A fault is tried again if its push ended before, but not for ever.
    """
    for fault in faults:
        for tries in range(1, TRIES + 1):
            try:
                outcome = _rehearsed(stage, fault)._replace(tries=tries)
                break
            except EndedEarly as error:
                outcome = Outcome(fault.name, None, None, None, str(error), tries)
        yield outcome


def _rehearsed(stage: S_contra, fault: Fault[S_contra]) -> Outcome:
    stage.ready()
    first = len(stage.heard)
    try:
        begin = fault.bring_about(stage)
        outcome = _judged(stage, fault, begin, first)
        if outcome.problem is None:
            outcome = outcome._replace(problem=fault.check(stage) or traceback_in(stage))
    except (Excess, NoAnswer) as error:
        return Outcome(fault.name, None, None, None, str(error))
    return outcome


def _judged(stage: S_contra, fault: Fault[S_contra], begin: float | None, first: int) -> Outcome:
    """Wait until the pusher rests, watch it for a while, and judge what it did.

    Args:
        stage: where the fault was caused.
        fault: what was caused.
        begin: when; None: the pusher had to go on to the end of its push.
        first: index of the first report of this push.
    """
    client = stage.client
    if begin is None and client is not None:  # on a busy machine a push may pause
        stage.wait(lambda: client.poll() is not None, "the end of the push")
        if client.returncode:
            raise EndedEarly(f"the push was to go on, but it ended: {words_of(client)}")
    at_rest = stage.rest()
    given = stage.given
    seconds = travelled = allowed = problem = None
    if begin is None:
        if abs(at_rest.along - stage.reach) > stage.same:
            problem = f"it rests at {1e3 * at_rest.along:.2f} mm, the push ends at {1e3 * stage.reach:.2f} mm"
        elif (fastest := max(one.speed for one in stage.heard[first:])) > 1.05 * given.speed:
            problem = f"it went at {1e3 * fastest:.1f} mm/s"
    else:
        there = stage.at(begin)
        seconds, travelled = stage.seconds_until(at_rest, begin), abs(at_rest.along - there)
        if fault.within is None:
            allowed = max(0.0, stage.reach - there) + OFF_WAY + REACTION * given.speed + stage.braking
        else:
            allowed = fault.within * given.speed + stage.braking
        if travelled > allowed + RESOLUTION:
            problem = "it went too far"
    furthest = max(one.along for one in stage.heard[first:])
    if furthest > given.stroke:
        problem = f"it went to {1e3 * furthest:.1f} mm, beyond the stroke"
    stage.pause(WATCHED)
    if abs(stage.along() - at_rest.along) > stage.same:
        problem = "it moved again"
    problem = problem or untrue(stage, stage.heard[first].when, at_rest.when, fault.true)
    return Outcome(fault.name, seconds, travelled, allowed, problem)


def untrue(stage: Stage, since: float, rested: float, true: float) -> str | None:
    """The first published state that is untrue: the pusher was elsewhere at about that moment, or had already come to rest."""
    for when, state in stage.states:
        if when < since or state.mode == PusherState.MODE_DISCONNECTED:
            continue
        lately = [one.along for one in stage.between(when - LATELY, when + LATELY)]
        if not min(lately) - true <= state.position - stage.position <= max(lately) + true:
            places = f"{1e3 * min(lately):.2f} to {1e3 * max(lately):.2f} mm"
            return f"{1e3 * (state.position - stage.position):.2f} mm was published, but the pusher was at {places}"
    if stage.states and stage.mode() == PusherState.MODE_RUNNING and stage.states[-1][0] > rested + WATCHED / 2:
        return "the published state says that the pusher moves, but it rests"
    return None


def traceback_in(stage: Stage) -> str | None:
    """Whether an actuator ended with an error that nobody foresaw."""
    return "the actuator ended with a traceback" if "Traceback" in stage.log.read_text(errors="replace") else None


# How each fault is caused


def damaged(filtered: Filter) -> Callable[[GrblStage], float]:
    """Damage the next command that the filter recognises, in mid-push."""

    def bring_about(stage: GrblStage) -> float:
        stage.under_way(0.5)
        stage.line.to_controller = filtered
        return time.monotonic()

    return bring_about


def faster(data: bytes) -> bytes:
    """A filter that changes the feed of each jog."""
    return re.sub(rb"F(\d+)", lambda feed: b"F%d" % (5 * int(feed[1])), data)


def report_damaged(stage: GrblStage) -> None:
    """Put a wrong digit into a report; the published position must not follow it."""
    stage.under_way()
    stage.states.clear()
    stage.line.to_host = once(b"Pos:", b"Pos:9")


def another_axis(stage: GrblStage) -> float:
    """From now on, reports say that another axis moves as fast as the pusher, as after a damaged letter of a command."""
    stage.under_way()
    begin, other = time.monotonic(), int(stage.grbl.axis[-1] == "X")
    stage.line.to_host = straying(other, lambda: 1e3 * stage.given.speed * (time.monotonic() - begin))
    return begin


def offset_damaged(stage: GrblStage) -> None:
    """Put a wrong digit into the first work offset that a new actuator hears; its push must end where it should."""
    stage.end_actuator()
    stage.line.to_host = once(b"WCO:", b"WCO:9")
    stage.start_actuator()
    stage.make_ready()
    stage.under_way()


def offset_changed(stage: GrblStage) -> float:
    """From now on, reports have another work offset, as if another program had set one."""
    stage.under_way()
    stage.line.to_host = lambda data: data.replace(b"WCO:", b"WCO:9")
    return time.monotonic()


def late_answers(stage: GrblStage) -> None:
    """Delay all that the controller says; the push must be as it should be."""
    stage.line.delay_to_host = LATE_ANSWERS
    stage.pause(WATCHED)
    stage.under_way()


def known_by_another_name(stage: GrblStage) -> str | None:
    """A new actuator must wait for a person, although its port has another name."""
    name = stage.folder / "by-another-name"
    name.symlink_to(stage.line.port)
    stage.port = str(name)
    try:
        stage.start_actuator()
        return waits_for_a_person(stage)
    finally:
        stage.end_actuator()
        stage.port = stage.line.port
        name.unlink()


def published_nonsense(stage: Stage) -> str | None:
    """A published position that does not lie on the way of the push."""
    for _, state in stage.states:
        if not -stage.same <= state.position - stage.position <= stage.reach + stage.same:
            return f"{1e3 * state.position:.1f} mm was published"
    return None


def modes_changed(stage: GrblStage) -> None:
    """Switch to inches, incremental distances and 200 % of the feed, as another program might, and push afterwards."""
    for line in ("G20", "G91"):
        stage.ask(line)
    stage.line.tell_controller(b"\x91" * 10)
    stage.under_way()
    stage.line.tell_controller(b"\x91" * 10)


def signalled(number: signal.Signals, client: bool, share: float = MID_PUSH) -> Callable[[Stage], float]:
    """Send a signal to the actuator or the client once a push has covered this share."""

    def bring_about(stage: Stage) -> float:
        stage.under_way(share)
        process = stage.client if client else stage.actuator
        assert process is not None
        begin = time.monotonic()
        process.send_signal(number)
        return begin

    return bring_about


def all_stopped(stage: Stage) -> float:
    """Stop the actuator and its client at once, as a suspension does; the pusher's own controller goes on."""
    begin = signalled(signal.SIGSTOP, client=False)(stage)
    assert stage.client is not None
    stage.client.send_signal(signal.SIGSTOP)
    return begin


def cell_signalled(number: signal.Signals, node: str, share: float = MID_PUSH) -> Callable[[GrblStage], float]:
    """Send a signal to a node of a whole cell, or its "command line", in a push; the cell's other processes live on."""

    def bring_about(stage: GrblStage) -> float:
        run = cell_under_way(stage, share)
        pid = run.pid if node == "command line" else pid_of(node, stage)
        begin = time.monotonic()
        os.kill(pid, number)
        return begin

    return bring_about


def cell_ends(stage: GrblStage) -> str | None:
    """All processes of the cell must end, and move nothing."""
    rest = stage.along()
    cell_has_ended(stage)
    return "it moved again when the cell ended" if abs(stage.along() - rest) > stage.same else None


def cell_stays(stage: GrblStage) -> str | None:
    """The pusher must stay where it is, as long as the object is not seen."""
    rest = stage.along()
    stage.pause(2 * WATCHED)
    moved = abs(stage.along() - rest) > stage.same
    os.kill(pid_of("simulated_cell", stage), signal.SIGCONT)
    assert stage.client is not None
    end(stage.client)
    cell_has_ended(stage)
    return "it moved although the object was not seen" if moved else None


def goes_on_and_moves_nothing(stage: Stage) -> str | None:
    """Let the stopped process go on; nothing may move."""
    rest = stage.along()
    for process in (stage.actuator, stage.client):
        assert process is not None
        if process.poll() is None:
            process.send_signal(signal.SIGCONT)
    stage.pause(2 * WATCHED)
    return "it moved again when the process went on" if abs(stage.along() - rest) > stage.same else None


def client_is_told(stage: Stage) -> str | None:
    """The client must get a result, and the last state must be true."""
    assert stage.client is not None
    end_of_client = stage.client
    stage.wait(lambda: end_of_client.poll() is not None, "the end of the client")
    said = words_of(end_of_client)
    if "told to end" not in said:
        return f"the client was told: {said}"
    state = stage.states[-1][1]
    true = stage.position + stage.along()
    if state.mode == PusherState.MODE_RUNNING or abs(state.position - true) > TRUE:
        return f"the last state says mode {state.mode} at {1e3 * state.position:.2f} mm, it rests at {1e3 * true:.2f} mm"
    return None


def mute(stage: GrblStage) -> float:
    """From now on, nothing that the controller sends arrives."""
    stage.under_way()
    stage.line.to_host = nothing
    return time.monotonic()


def cut(stage: GrblStage) -> float:
    """From now on, nothing arrives in either direction."""
    stage.under_way()
    stage.line.to_host = stage.line.to_controller = nothing
    return time.monotonic()


def whole_again(stage: GrblStage) -> str | None:
    """The line works again, but only after the actuator has given up the connection."""
    stage.pause(SILENCE + RESET_PATIENCE + WATCHED)
    return waits_for_a_person(stage)


def waits_for_a_person(stage: Stage) -> str | None:
    """Once the line works again, the actuator, or the next one, must say that the position is unknown, and wait."""
    stage.heal()
    stage.witness()
    rest = stage.along()
    stage.states.clear()
    stage.wait(lambda: stage.mode() == PusherState.MODE_ALARM, "the actuator to say that the position is not known")
    try:
        stage.person.jog(1e-3, stage.given.speed)
    except NoAnswer:
        return "it moved unasked" if abs(stage.along() - rest) > stage.same else None
    return "it accepted a push without a reset"


def found_moving(stage: GrblStage) -> float:
    """Start a new actuator while the controller carries out another program's line."""
    stage.end_actuator()
    asked: list[float] = []

    def listen(data: bytes) -> bytes:
        asked.append(time.monotonic())
        return data

    move_alone(stage)
    stage.line.to_controller = listen
    stage.start_actuator()
    stage.wait(lambda: asked, "the first question")
    return asked[0]


def at_the_controller(byte: bytes) -> Callable[[GrblStage], float]:
    """Have an input of the controller end the push; the byte does what the input does."""

    def bring_about(stage: GrblStage) -> float:
        stage.under_way()
        begin = time.monotonic()
        stage.line.tell_controller(byte)
        return begin

    return bring_about


def move_alone(stage: GrblStage) -> None:
    """Send one line as another program would: over the whole reach, slowly, in millimetres whatever the modes are."""
    slow = min(stage.given.speed, stage.reach / ALONE)
    line = f"$J=G21G91{stage.grbl.axis[-1]}{stage.sign * 1e3 * stage.reach:.3f}F{60e3 * slow:.3f}\n"
    stage.line.tell_controller(line.encode())
    stage.wait(lambda: stage.along() > 0.02 * stage.reach, "somebody else's motion")


ALONE = 6.0
"""Duration of the other program's motion [s]: long enough for a new process to start before its end."""


def late_greeting(stage: GrblStage) -> float:
    """Delay the controller's answer to the reset that ends a stop."""
    stage.under_way()

    def late(data: bytes) -> bytes:
        stage.line.delay_to_host = LATE_GREETING if b"rbl" in data else 0.0
        return data

    stage.line.to_host = late
    begin = time.monotonic()
    stage.person.call("actuator/stop")
    return begin


def stopped(stage: Stage) -> float:
    """Call the service that stops the pusher."""
    stage.under_way()
    begin = time.monotonic()
    stage.person.call("actuator/stop")
    return begin


def is_released(stage: Stage) -> str | None:
    """The pusher must be held without an alarm, and a person's reset must release it."""

    def over() -> bool:
        return stage.mode() == PusherState.MODE_HOLD

    stage.pause(LATE_GREETING)
    stage.states.clear()
    stage.wait(lambda: stage.mode() is not None, "a state")
    if not over():
        return f"the published mode is {stage.mode()}, expected that of a hold"
    answer = stage.person.call("actuator/reset")
    return None if answer == "released" else f"a reset was answered with {answer!r}"


def hostile_settings(stage: GrblStage) -> None:
    """Answer with impossible settings; the doctor and the driver must say so in one line."""
    stage.end_actuator()
    config, driver = stage.config()
    listed = "\n".join(stage.ask("$$"))
    for key, value in HOSTILE:
        if key.decode() not in listed:  # FluidNC keeps some of them elsewhere
            continue
        stage.line.to_host = in_lines(key, value)
        check, limits = check_controller(driver, Grbl(), config)
        if check.level is not Grade.FAILED or limits is not None or "\n" in check.finding or len(check.finding) > 300:
            raise Excess(f"{key.decode()}{value[:10].decode()} was answered with {check.finding[:100]!r}")
    stage.line.to_host = bytes
    stage.start_actuator()
    stage.make_ready()
    stage.under_way()


def looked_at(stage: GrblStage) -> None:
    """Run the doctor while the controller moves: it must send only questions, and say that the controller moves."""
    stage.end_actuator()
    sent = bytearray()

    def listen(data: bytes) -> bytes:
        sent.extend(data)
        return data

    move_alone(stage)
    stage.line.to_controller = listen
    config, driver = stage.config()
    check, _ = check_controller(driver, Grbl(), config)
    stage.line.to_controller = bytes
    if set(sent) != {ord("?")}:
        raise Excess(f"the doctor sent {bytes(sent)[:40]!r}")
    if "it moves now" not in check.finding:
        raise Excess(f"the doctor found {check.finding!r}")


def no_more_enable(stage: Stage) -> float:
    """Withdraw the enable that an actuator has been told to need."""
    stage.end_actuator()
    stage.start_actuator(enable_timeout=ENABLE_TIMEOUT)
    with stage.person.repeating("enable", Bool(data=True), RELIABLE, EVENT_TIMEOUT):
        stage.make_ready()
        stage.under_way()
    return time.monotonic()


def too_much_force(stage: Stage) -> float:
    """Report a force beyond the limit that an actuator has been given."""
    stage.end_actuator()
    stage.start_actuator(max_force=MAX_FORCE)
    force = WrenchStamped()
    with stage.person.repeating("wrench", force, SENSOR_DATA, EVENT_TIMEOUT):
        stage.make_ready()
        stage.under_way()
        begin = time.monotonic()
        force.wrench.force.x = 2 * MAX_FORCE
        stage.wait(lambda: stage.mode() == PusherState.MODE_HOLD, "the hold")
    return begin


killed_actuator = signalled(signal.SIGKILL, client=False)

CONTRACT: tuple[Fault[Stage], ...] = (
    Fault("no fault", lambda stage: stage.under_way()),
    Fault("kill -9 of the actuator", killed_actuator, check=waits_for_a_person),
    Fault("SIGSTOP of the actuator", signalled(signal.SIGSTOP, client=False), check=goes_on_and_moves_nothing),
    Fault("SIGTERM of the actuator", signalled(signal.SIGTERM, client=False), check=client_is_told),
    Fault("kill -9 of the push's client", signalled(signal.SIGKILL, client=True), OWNER),
    Fault("SIGSTOP of the push's client", signalled(signal.SIGSTOP, client=True), OWNER, goes_on_and_moves_nothing),
    Fault("SIGSTOP of both, as by a suspension", all_stopped, check=goes_on_and_moves_nothing),
    Fault("somebody calls actuator/stop", stopped, check=is_released),
    Fault("the enable is withdrawn", no_more_enable, ENABLE_TIMEOUT + REACTION),
    Fault("the force is too great", too_much_force, check=is_released),
)
"""The rows that every driver must pass, with a controller of any kind."""

FAULTS: tuple[Fault[GrblStage], ...] = (
    *CONTRACT,
    Fault("a byte of a command is lost", damaged(once(b".", b"")), None),
    Fault("a digit is added to a command", damaged(once(b"X", b"X9")), None),
    Fault("every feed is changed to five times the commanded one", damaged(faster), None),
    Fault("another program sets inches, increments and 200 % feed", modes_changed),
    Fault("kill -9 of the actuator, then another name of its port", killed_actuator, check=known_by_another_name),
    Fault("SIGSTOP of a cell's experiment", cell_signalled(signal.SIGSTOP, "experiment"), OWNER, cell_ends),
    Fault("a cell's camera loses the object", cell_signalled(signal.SIGSTOP, "simulated_cell", 0.1), LOST, cell_stays),
    Fault("the controller goes silent", mute),
    Fault("the cable is cut", cut, check=whole_again),
    Fault("a new actuator finds the controller moving", found_moving, check=waits_for_a_person),
    Fault("the greeting after a stop comes 3 s late", late_greeting, check=is_released),
    Fault("impossible settings", hostile_settings),
    Fault("another axis is reported to move", another_axis, check=waits_for_a_person),
    Fault("a wrong digit in the first work offset", offset_damaged),
    Fault("the work offset changes in mid-push", offset_changed, SEEN_TWICE, waits_for_a_person),
    Fault("all answers come 80 ms late", late_answers),
    Fault("a wrong digit in a report", report_damaged, check=published_nonsense),
    Fault("the doctor looks at a moving controller", looked_at),
    Fault("the controller's door input opens", at_the_controller(b"\x84"), check=waits_for_a_person),
    Fault("the emergency stop is pressed, wired to the reset input", at_the_controller(b"\x18"), check=waits_for_a_person),
)
"""The rows that the GRBL driver must pass, too."""
