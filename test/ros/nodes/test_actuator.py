"""The actuator node on the simulated controller: the push action, its published states, and every way a motion can end."""

import itertools
import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace

import pytest
from action_msgs.msg import GoalStatus
from calls import killed_at_the_end, wait_until
from composition import made
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.action import ActionClient
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from stage import STAGE
from std_msgs.msg import Bool, Empty, String
from std_srvs.srv import Trigger

from pushfric_core.pushers.clock import clock
from pushfric_core.pushers.position_memory import PositionMemory
from pushfric_core.pushers.pusher import Mode, PusherConfig
from pushfric_core.simulated.grbl_firmware import SimulatedGrbl
from pushfric_msgs.action import Push
from pushfric_msgs.msg import PusherState
from pushfric_ros.node_kit.diagnostics import DiagnosticStatus
from pushfric_ros.node_kit.heartbeat import Heartbeat
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE, SENSOR_DATA
from pushfric_ros.node_kit.stop_button import press
from pushfric_ros.nodes.actuator import ActuatorNode
from pushfric_ros.nodes.actuator.needs import PushNeeds

NUMBERS = itertools.count()
MISSED = (
    r"{} shows no sign of life: its last heartbeat, number [1-9]\d*, came \d+\.\d\d s ago"
    r"( and said that its executor had hung for \d+\.\d\d s)?; {}(; the actuator itself stood still for \d+\.\d\d s)?"
)
UNKNOWN = "where the pusher stands is not known: "
UNVOUCHED = UNKNOWN + "bring it to its home end, restart the controller, then reset"
LINE = STAGE | {
    "line_origin": [0.1, -0.2],
    "line_direction": [0.0, 2.0],
    "tip_radius": 0.004,
    "stroke": 0.08,
    "max_speed": 0.08,
}


def unplug(controller: SimulatedGrbl, link) -> None:
    link.unlink()  # first: the terminal that it leads to may be another test's next
    controller.close()


def plug_in(controller: SimulatedGrbl, link) -> None:
    controller.start()
    link.symlink_to(controller.port)


class HeldClock:
    """A clock that stands still until it is released."""

    def __init__(self) -> None:
        self._held: float | None = time.monotonic()
        self._behind = 0.0

    def __call__(self) -> float:
        return time.monotonic() - self._behind if self._held is None else self._held

    def release(self) -> None:
        """Let the clock go on from where it stood, because a carriage cannot jump."""
        self._behind, self._held = time.monotonic() - (self._held or 0.0), None


class Cell:
    """An actuator node, and everything that another node sees of it."""

    def __init__(self, ros, port, **parameters) -> None:
        self.ros = ros
        self.feedback: list[Push.Feedback] = []
        self.health: list[DiagnosticStatus] = []
        namespace = f"/cell_{next(NUMBERS)}"  # a new one, as nodes of earlier tests may live on until Python collects them
        # the executor gets it before it asks for anything, so that no state is missed
        self._other = ros.node("other", namespace=namespace)
        self.states = ros.heard(self._other, PusherState, "pusher_state", RELIABLE)
        self._other.create_subscription(DiagnosticArray, "/diagnostics", lambda msg: self.health.extend(msg.status), RELIABLE)
        self._client = ActionClient(self._other, Push, "push")
        self.heartbeat = Heartbeat(self._other)
        self.faults = ros.heard(self._other, String, "pusher_fault", LATCHED)
        self._stop = self._other.create_client(Trigger, "actuator/stop")
        self._reset = self._other.create_client(Trigger, "actuator/reset")
        self._change = self._other.create_client(ChangeState, "actuator/change_state")
        self._get = self._other.create_client(GetState, "actuator/get_state")
        self.node = ros.compose(made(ActuatorNode, namespace, port=str(port), **LINE | parameters))

    def wait_for_mode(self, mode: int) -> None:
        self.ros.wait_for(lambda: self.states and self.states[-1].mode == mode, what=f"mode {mode}")

    def ready(self) -> "Cell":
        self.wait_for_mode(PusherState.MODE_IDLE)
        self.ros.wait_for(self._client.server_is_ready, what="the action server")
        # wait now; otherwise a push might be over before they are found
        for service in (self._reset, self._change, self._get, self._stop):
            self.ros.wait_for(service.service_is_ready, what=service.srv_name)
        return self

    def send(self, distance=0.03, speed=0.08, retract=False, push_id=7, owner=True):
        """Send a goal and return its handle."""
        goal = Push.Goal(push_id=push_id, distance=distance, speed=speed, retract=retract)
        given = goal, lambda msg: self.feedback.append(msg.feedback)
        ask = partial(self.heartbeat.send, self._client) if owner else self._client.send_goal_async
        return self.ros.answer(ask, *given, what="the answer to the goal")

    def result(self, handle) -> SimpleNamespace:
        return self.ros.answer(handle.get_result_async, what="the result")

    def reset(self) -> Trigger.Response:
        return self._call(self._reset, Trigger.Request())

    def change(self, transition: int) -> bool:
        """Ask for a lifecycle transition; return whether it succeeded."""
        return self._call(self._change, ChangeState.Request(transition=Transition(id=transition))).success

    @property
    def state(self) -> str:
        return self._call(self._get, GetState.Request()).current_state.label

    def _call(self, client, request):
        self.ros.wait_for(client.service_is_ready, what=client.srv_name)
        return self.ros.result(client.call_async(request), f"the answer of {client.srv_name}")

    def halfway(self, controller: SimulatedGrbl, **goal):
        """Start a motion that lasts longer than any timeout; return the handle of its goal."""
        start = controller.position()
        handle = self.send(**{"distance": 0.08, "speed": 0.004} | goal)
        self.ros.wait_for(lambda: controller.position() > start + 0.001, what="the motion")
        return handle

    def refuses(self, controller: SimulatedGrbl, capfd, why: str) -> None:
        """Assert that it is in alarm, accepts no goal, says why, and does not move."""
        rest = controller.position()
        self.wait_for_mode(PusherState.MODE_ALARM)
        self.ros.wait_for(lambda: self.health and self.health[-1].message == f"alarm: {why}", what="the diagnostic")
        assert self.health[-1].level == DiagnosticStatus.ERROR
        capfd.readouterr()
        assert not self.send(0.01, push_id=8).accepted
        assert f"push 8 rejected: the pusher must be idle, it is alarm: {why}\n" in capfd.readouterr().err
        assert controller.position() == rest

    def comes_to_rest(self, controller: SimulatedGrbl) -> float:
        """Wait until the pusher rests before its goal; return where."""
        rest = -1.0

        def rests() -> bool:
            nonlocal rest
            before, rest = rest, controller.position()
            return before == rest and controller._motion is None

        self.ros.wait_for(rests, what="the standstill")
        assert rest < 0.07
        return rest


@pytest.fixture
def cell(ros, controller, tmp_path) -> Cell:
    return Cell(ros, tmp_path / "port").ready()


class SimTime:
    """A clock that goes on in steps of 20 ms, faster than real time or with it."""

    def __init__(self, ros, rate: float, ready: Callable[[], bool] = lambda: True) -> None:
        self.now, self.stepped = 1000.0, lambda stamp: None
        self._node, self._rate, self._ready = ros.node("clock"), rate, ready
        self._out = self._node.create_publisher(Clock, "/clock", RELIABLE)

    def start(self) -> None:
        self._node.create_timer(1 / self._rate, self._tick)

    def _tick(self) -> None:
        if self._ready():
            self.now += 0.02
            stamp = Time(nanoseconds=round(self.now * 1e9))
            self.stepped(stamp.nanoseconds)
            self._out.publish(Clock(clock=stamp.to_msg()))


def test_modes_match_the_constants_of_the_message():
    numbers = {name[5:]: getattr(PusherState, name) for name in dir(PusherState) if name.startswith("MODE_")}
    assert numbers.keys() == {mode.name for mode in Mode}


def test_a_push_and_its_retraction(ros, controller, tmp_path):
    cell = Cell(ros, tmp_path / "port", max_speed=0.05).ready()
    result = cell.result(cell.send(0.03, 0.03, retract=True))
    assert result.status == GoalStatus.STATUS_SUCCEEDED
    assert result.result.outcome == Push.Result.OUTCOME_REACHED
    assert result.result.travelled == pytest.approx(0.03, abs=2e-5)
    assert result.result.message.startswith("reached")  # on a busy machine it may add: unevenly
    assert controller.position() == pytest.approx(0.0)
    assert cell.feedback[-1].travelled == pytest.approx(0.03, abs=2e-5)
    pushing = [state for state in cell.states if state.push_id == 7]
    assert max(state.speed for state in pushing) == pytest.approx(0.03, rel=0.01)
    assert all(state.speed >= 0 for state in pushing)
    assert min(state.speed for state in cell.states if state.speed < 0) == pytest.approx(-0.05, rel=0.01)
    assert all(state.push_id == PusherState.NO_PUSH for state in cell.states if state.speed < 0)
    for state in pushing:
        # the frames of a cell in a namespace begin with it
        assert (state.header.frame_id, state.tip_radius) == (f"{cell.node.get_namespace()[1:]}/table", 0.004)
        assert (state.direction.x, state.direction.y) == (0.0, 1.0)
        assert (state.tip.x, state.tip.y) == (0.1, pytest.approx(-0.2 + state.position))
    stamps = [state.header.stamp.sec * 10**9 + state.header.stamp.nanosec for state in cell.states]
    assert stamps == sorted(stamps)


def test_a_push_in_simulated_time(ros, tmp_path):
    """The clock moves in steps and faster than real time; every state says where the pusher was at its stamp."""
    truth: dict[int, float] = {}
    clock = SimTime(ros, 250, lambda: not cell.node._pusher.line._is_asked)  # a busy machine may be slower than the clock
    with SimulatedGrbl(lambda: clock.now) as controller:
        clock.stepped = lambda stamp: truth.update({stamp: controller.position()})
        cell = Cell(ros, controller.port, use_sim_time=True, real_time_factor=5.0)
        clock.start()
        cell.ready()
        assert cell.result(cell.send(0.06, 0.02)).result.outcome == Push.Result.OUTCOME_REACHED
    pushing = [state for state in cell.states if state.push_id == 7]
    assert len(pushing) > 50  # 3 s at 20 Hz
    late = sorted(abs(state.position - truth[Time.from_msg(state.header.stamp).nanoseconds]) for state in pushing)
    assert late[len(late) // 2] <= 0.0004 + 1e-6  # one step of the clock


def under_way_without(cell: Cell, controller: SimulatedGrbl, link, what: str) -> Callable[[], object]:
    """What takes from a push, once it is under way, what it needs."""
    if what.startswith("enable"):
        out = cell._other.create_publisher(Bool, "enable", LATCHED)
        timer = cell._other.create_timer(0.05, lambda: out.publish(Bool(data=True)))
        cell.ros.wait_for(lambda: cell.node._needs._enabled > 0, what="enable")
        return lambda: (timer.cancel(), what.endswith("false") and out.publish(Bool(data=False)))
    if what.startswith("force"):
        out, msg = cell._other.create_publisher(WrenchStamped, "wrench", SENSOR_DATA), WrenchStamped()
        msg.wrench.force.x = 2.9
        cell._other.create_timer(0.05, lambda: out.publish(msg))
        cell.ros.wait_for(lambda: cell.node._needs._forced > 0, what="a force")
        return lambda: setattr(msg.wrench.force, "y", float(what.split()[1]))
    if what == "tracker":
        return Heartbeat(cell.ros.node("tracker", namespace=cell.node.get_namespace())).end
    if what == "stop topic":
        out = cell.ros.publisher(cell._other, Empty, "stop", RELIABLE)
        return lambda: out.publish(Empty())
    return {
        "owner": lambda: cell.heartbeat.own(None),
        "stop service": lambda: cell._call(cell._stop, Trigger.Request()),
        "button": lambda: (press("/another_cell"), press(cell.node.get_namespace().strip("/"))),
        "deactivated": lambda: cell.change(Transition.TRANSITION_DEACTIVATE),
        "shut down": lambda: cell.change(Transition.TRANSITION_ACTIVE_SHUTDOWN),
        "time": lambda: None,
        "unplugged": lambda: unplug(controller, link),
    }[what]


IDLE, HELD = PusherState.MODE_IDLE, PusherState.MODE_HOLD
STOPPED = "somebody asked for a stop"


@pytest.mark.parametrize(
    ("what", "parameters", "message", "fault", "mode"),
    [
        ("owner", {"owner_timeout": 0.3}, MISSED.format("its client", "owner_timeout is 0.3 s"), "owner", IDLE),
        ("stop topic", {}, STOPPED, "stopped", HELD),
        ("stop service", {}, STOPPED, "stopped", HELD),
        ("button", {}, STOPPED, "stopped", HELD),
        ("enable is false", {"enable_timeout": 60.0}, "the topic enable does not say true", "disabled", IDLE),
        (
            "enable is silent",
            {"enable_timeout": 0.5},
            r"the topic enable said true \d+\.\d\d s ago; enable_timeout is 0\.5 s",
            "disabled",
            IDLE,
        ),
        (
            "tracker",
            {"requires": ["tracker"], "requires_timeout": 0.5},
            MISSED.format("tracker", "requires_timeout is 0.5 s"),
            "nodes",
            IDLE,
        ),
        ("force 1", {"max_force": 3.0}, "the force was 3.1 N, more than max_force 3 N", "force", HELD),
        ("force nan", {"max_force": 3.0}, r"no force was measured for \d+\.\d\d s, the limit is 0\.5 s", "force", None),
        ("force inf", {"max_force": 3.0}, "the force was inf N, more than max_force 3 N", "force", HELD),
        ("deactivated", {}, "the actuator was deactivated", None, HELD),
        ("shut down", {}, "the actuator was shut down", None, None),
        ("time", {"max_time": 2.0}, r"the push took \d+\.\d s, more than max_time 2 s", "time", IDLE),
        ("unplugged", {}, "lost .*", None, PusherState.MODE_DISCONNECTED),
    ],
)
def test_a_push_is_stopped_when_what_it_needs_is_gone(ros, controller, tmp_path, what, parameters, message, fault, mode):
    cell = Cell(ros, tmp_path / "port", **parameters).ready()
    take = under_way_without(cell, controller, tmp_path / "port", what)
    handle = cell.halfway(controller)
    take()
    result = cell.result(handle)
    assert (result.status, result.result.outcome) == (GoalStatus.STATUS_ABORTED, Push.Result.OUTCOME_ABORTED)
    assert re.fullmatch(message, result.result.message)
    rest = cell.comes_to_rest(controller)
    if fault is not None:
        ros.wait_for(lambda: cell.faults[-1:] == [String(data=fault)], what="the fault")
    if mode is None:
        return
    cell.wait_for_mode(mode)
    if mode != IDLE:
        assert not cell.send(0.01).accepted
    if what == "unplugged":
        plug_in(controller, tmp_path / "port")
        cell.wait_for_mode(PusherState.MODE_ALARM)  # its position is uncertain: see below
    cell.states.clear()
    ros.wait_for(lambda: len(cell.states) > 5, what="more states")
    assert controller.position() == rest  # nothing moves by itself
    if message is STOPPED:
        assert cell.reset().message == "released"
        cell.wait_for_mode(IDLE)
        assert cell.result(cell.send(0.01)).result.outcome == Push.Result.OUTCOME_REACHED


def test_enable_counts_from_when_it_came(ros):
    """Not from when a node that had stood still took it."""
    needs = PushNeeds(ros.node("late"), PusherConfig((0.0, 0.0), (0.0, 1.0), 0.003, 0.06, 0.1, enable_timeout=0.5), None, print)
    for waited, disabled in ((0.0, None), (3.0, "the topic enable said true 3.0")):
        needs._on_enable(Bool(data=True), {"received_timestamp": time.time_ns() - round(waited * 1e9)})
        assert needs.disabled == disabled or needs.disabled.startswith(disabled)


@pytest.mark.parametrize("parameters", [{"enable_timeout": 60.0}, {"requires": ["tracker"], "requires_timeout": 0.5}])
def test_nothing_moves_before_what_a_push_needs_was_heard(ros, controller, tmp_path, parameters):
    cell = Cell(ros, tmp_path / "port", **parameters).ready()
    handle = cell.send(0.01)
    if handle.accepted:
        unheard = r"tracker published no heartbeat in (\d+\.\d\d) s, expected one within 5 s"
        assert float(re.fullmatch(unheard, cell.result(handle).result.message)[1]) >= 5.0
    assert handle.accepted == ("requires" in parameters)
    assert controller.position() == 0.0


def test_a_goal_beyond_the_limits_or_while_another_runs_is_rejected(ros, tmp_path, capfd):
    clock = HeldClock()
    with SimulatedGrbl(clock) as controller:
        cell = Cell(ros, controller.port, max_distance=0.07).ready()
        nan, inf = float("nan"), float("inf")
        for name, values in {
            "distance": (0.0701, 0.0, -0.01, nan, inf),
            "speed": (0.081, 0.0, 5e-324, 9e-6, nan),
            "push_id": (-2,),
        }.items():
            for value in values:
                assert not cell.send(**{name: value}).accepted, (name, value)
        assert "push 7 rejected: distance must be at most max_distance 0.07 m, got 0.0701 m\n" in capfd.readouterr().err
        running = cell.send(0.06)
        assert not cell.send(0.01, push_id=8).accepted
        assert controller.position() == 0.0
        clock.release()
        assert cell.result(running).result.outcome == Push.Result.OUTCOME_REACHED
        assert controller.position() == pytest.approx(0.06)


def test_a_canceled_push_stops_and_the_next_goes_on_from_there(ros, controller, cell):
    handle = cell.halfway(controller, retract=True)
    ros.answer(handle.cancel_goal_async, what="the answer to the cancel")
    result = cell.result(handle)
    assert (result.status, result.result.outcome) == (GoalStatus.STATUS_CANCELED, Push.Result.OUTCOME_CANCELED)
    rest = controller.position()
    assert result.result.travelled == pytest.approx(rest, abs=2e-5)
    assert 0.001 < rest < 0.06
    cell.wait_for_mode(IDLE)
    assert cell.result(cell.send(0.01)).result.outcome == Push.Result.OUTCOME_REACHED
    assert controller.position() == pytest.approx(rest + 0.01, abs=2e-5)


def test_a_goal_that_is_disabled_as_it_is_accepted_ends_and_the_next_is_taken(ros, controller, tmp_path):
    """Once, nobody was told, and every later push was refused because this one was under way."""
    cell = Cell(ros, tmp_path / "port", enable_timeout=60.0)
    cell.node._needs._enabled = clock()
    cell.ready()
    refusal = cell.node._refusal

    def withdrawn(push):
        reason, cell.node._needs._enabled = refusal(push), -math.inf
        return reason

    cell.node._refusal = withdrawn
    result = cell.result(cell.send(0.01)).result
    assert (result.outcome, result.message) == (Push.Result.OUTCOME_ABORTED, "the topic enable does not say true")
    assert result.travelled == 0
    cell.node._needs._enabled, cell.node._refusal = clock(), refusal
    assert cell.result(cell.send(0.01)).result.outcome == Push.Result.OUTCOME_REACHED


def test_a_door_that_opens_while_a_canceled_push_brakes_asks_a_person(ros, controller, cell):
    """Once, the pusher was ready again as soon as the door was shut, and its driver refused the next push alone."""
    handle = cell.halfway(controller)
    controller._cancel_jog = controller._open_door
    ros.answer(handle.cancel_goal_async, what="the answer to the cancel")
    assert cell.result(handle).status == GoalStatus.STATUS_CANCELED
    cell.wait_for_mode(PusherState.MODE_ALARM)
    assert cell.states[-1].in_doubt


def test_the_retraction_is_not_a_push(cell, controller):
    cell.result(cell.send(0.04))
    cell.states.clear()
    back = cell.result(cell.send(-0.03, 0.05)).result
    assert (back.message[:7], back.travelled) == ("reached", pytest.approx(-0.03, abs=2e-5))
    assert controller.position() == pytest.approx(0.01)
    assert {state.push_id for state in cell.states} == {PusherState.NO_PUSH}
    assert min(state.speed for state in cell.states) == pytest.approx(-0.05, rel=0.01)
    assert cell.feedback[-1].travelled == pytest.approx(-0.03, abs=2e-5)
    assert not cell.send(-0.0101).accepted
    assert not cell.send(-0.01, retract=True).accepted


def test_a_push_whose_client_hangs_is_stopped_whoever_else_is_there(ros, controller, tmp_path):
    cell = Cell(ros, tmp_path / "port", owner_timeout=2.0).ready()
    arguments = ["--ros-args", "-r", f"__ns:={cell.node.get_namespace()}"]
    with killed_at_the_end([sys.executable, "-c", PUSH, *arguments], stdout=subprocess.DEVNULL) as client:
        ros.wait_for(lambda: controller.position() > 0.001, what="the motion")
        client.send_signal(signal.SIGSTOP)
        ros.wait_for(lambda: cell.faults[-1:] == [String(data="owner")], what="the fault")
        rest = cell.comes_to_rest(controller)
        cell.wait_for_mode(PusherState.MODE_IDLE)
        assert cell.result(cell.send(0.001)).result.outcome == Push.Result.OUTCOME_REACHED  # a client that lives may push
        assert controller.position() == pytest.approx(rest + 0.001, abs=2e-5)
        client.send_signal(signal.SIGCONT)
        cell.states.clear()
        ros.wait_for(lambda: len(cell.states) > 10, what="more states")
        assert controller.position() == pytest.approx(rest + 0.001, abs=2e-5)


def test_a_push_whose_client_sends_no_heartbeat_at_all_never_moves(ros, controller, tmp_path):
    cell = Cell(ros, tmp_path / "port", owner_timeout=0.3).ready()
    result = cell.result(cell.send(owner=False))
    assert result.result.outcome == Push.Result.OUTCOME_ABORTED
    assert "or set owner_timeout to 0" in result.result.message
    assert controller.position() == 0.0


def test_heartbeats_need_not_be_sent_where_that_is_configured(ros, controller, tmp_path):
    cell = Cell(ros, tmp_path / "port", owner_timeout=0.0).ready()
    assert cell.result(cell.send(0.01, owner=False)).result.outcome == Push.Result.OUTCOME_REACHED


def test_a_node_that_a_push_needs_may_have_much_to_do(ros, controller, tmp_path):
    """On a busy machine, one callback of the estimator lasts longer than requires_timeout."""
    cell = Cell(ros, tmp_path / "port", requires=["estimator"], requires_timeout=0.5).ready()
    estimator = ros.node("estimator", namespace=cell.node.get_namespace())
    Heartbeat(estimator)
    handle = cell.halfway(controller)
    ros.take_out(estimator)  # nobody spins it now
    ros.wait_for(lambda: cell.node._needs._life.node("estimator").stalled > 1.0, what="a long callback")
    assert cell.node._push is not None
    estimator.destroy_node()
    assert re.fullmatch(MISSED.format("estimator", "requires_timeout is 0.5 s"), cell.result(handle).result.message)


def test_a_new_process_knows_what_the_old_one_knew(ros, controller, tmp_path, capfd):
    """In turn: the pusher rested at 10 mm and still does; it is reported elsewhere; it moved when the old process died."""
    memory = PositionMemory(str(tmp_path / "memory"), controller.port)
    controller._carriage, controller._offset = 10.0, 0.0
    memory.keep(0.010)
    assert memory.settle(60) is None
    cell = Cell(ros, tmp_path / "port", memory=str(tmp_path / "memory")).ready()
    assert cell.result(cell.send(0.01)).result.outcome == Push.Result.OUTCOME_REACHED
    cell.wait_for_mode(PusherState.MODE_IDLE)
    ros.wait_for(lambda: PositionMemory(str(tmp_path / "memory"), controller.port).recall() == 0.02, what="the memory")
    cell.halfway(controller, distance=0.05)
    assert math.isnan(PositionMemory(str(tmp_path / "memory"), controller.port).recall())


@pytest.mark.parametrize("kept", [0.010, math.nan])
def test_a_new_process_that_cannot_know_waits_for_a_person(ros, controller, tmp_path, capfd, kept):
    memory = PositionMemory(str(tmp_path / "memory"), controller.port)
    memory.keep(kept)
    assert memory.settle(60) is None
    cell = Cell(ros, tmp_path / "port", memory=str(tmp_path / "memory"))
    cell.refuses(controller, capfd, UNVOUCHED)
    assert cell.reset().success
    cell.wait_for_mode(PusherState.MODE_IDLE)
    assert cell.result(cell.send(0.01)).result.outcome == Push.Result.OUTCOME_REACHED


def test_a_manager_takes_it_through_its_states(ros, controller, tmp_path):
    """Without autostart, the node leaves the port alone, then connects, then accepts goals; and back again."""
    cell = Cell(ros, tmp_path / "port", autostart=False)
    ros.wait_for(cell._client.server_is_ready, what="the action server")
    assert cell.state == "unconfigured"
    cell.wait_for_mode(PusherState.MODE_DISCONNECTED)
    assert not cell.change(Transition.TRANSITION_ACTIVATE)  # not a transition from this state
    assert cell.change(Transition.TRANSITION_CONFIGURE)
    cell.wait_for_mode(PusherState.MODE_HOLD)
    assert cell.state == "inactive"
    assert not cell.send().accepted
    answer = cell.reset()
    assert (answer.success, answer.message) == (False, "the actuator is inactive, expected active")
    ros.wait_for(lambda: cell.health and "inactive" in cell.health[-1].message, what="the diagnostic")
    assert cell.health[-1].level == DiagnosticStatus.WARN
    ros.wait_for(lambda: not cell.node._pusher.busy, what="the end of connecting")
    assert cell.change(Transition.TRANSITION_ACTIVATE)
    cell.wait_for_mode(PusherState.MODE_IDLE)
    assert cell.result(cell.send(0.02)).result.outcome == Push.Result.OUTCOME_REACHED
    assert cell.change(Transition.TRANSITION_DEACTIVATE)
    cell.wait_for_mode(PusherState.MODE_HOLD)
    assert cell.change(Transition.TRANSITION_CLEANUP)
    cell.wait_for_mode(PusherState.MODE_DISCONNECTED)
    assert controller.position() == pytest.approx(0.02)
    assert cell.change(Transition.TRANSITION_CONFIGURE)
    cell.wait_for_mode(PusherState.MODE_HOLD)
    assert cell.states[-1].position == pytest.approx(0.02)


def test_a_transition_that_fails_leaves_the_pusher(cell, controller, monkeypatch, capfd):
    cell.halfway(controller)
    monkeypatch.setattr(cell.node, "_revoke", lambda why: 1 / 0)
    assert not cell.change(Transition.TRANSITION_DEACTIVATE)
    assert cell.state == "unconfigured"
    cell.wait_for_mode(PusherState.MODE_DISCONNECTED)
    cell.comes_to_rest(controller)
    assert "a transition failed; the pusher is left" in capfd.readouterr().err


def test_a_clock_that_jumps_back_disturbs_nothing(ros, controller, tmp_path):
    clock = SimTime(ros, 50)
    cell = Cell(ros, tmp_path / "port", use_sim_time=True)
    clock.start()
    cell.ready()
    handle = cell.halfway(controller, speed=0.03)
    clock.now -= 500.0
    assert cell.result(handle).result.outcome == Push.Result.OUTCOME_REACHED
    cell.wait_for_mode(PusherState.MODE_IDLE)
    assert cell.states[-1].header.stamp.sec < 600
    assert cell.result(cell.send(-0.08)).result.outcome == Push.Result.OUTCOME_REACHED


def test_a_limit_during_a_push_stops_everything_until_a_person_resets(ros, controller, cell):
    handle = cell.halfway(controller)
    assert not cell.reset().success
    controller.hit_limit()
    result = cell.result(handle)
    assert result.status == GoalStatus.STATUS_ABORTED
    assert (result.result.outcome, result.result.message) == (Push.Result.OUTCOME_ABORTED, "ALARM:1 Hard limit")
    cell.wait_for_mode(PusherState.MODE_ALARM)
    alarmed = next(state for state in cell.states if state.mode == PusherState.MODE_ALARM)
    assert (alarmed.push_id, alarmed.speed) == (PusherState.NO_PUSH, 0.0)  # reported at once, and the push is over
    assert not cell.send(0.01).accepted
    ros.wait_for(lambda: cell.health and "ALARM:1 Hard limit" in cell.health[-1].message, what="the diagnostic")
    assert cell.health[-1].level == DiagnosticStatus.ERROR
    answer = cell.reset()
    assert (answer.success, answer.message) == (True, "unlocking")
    cell.wait_for_mode(PusherState.MODE_IDLE)
    rest = controller.position()
    assert cell.result(cell.send(0.01)).result.outcome == Push.Result.OUTCOME_REACHED
    assert controller.position() == pytest.approx(rest + 0.01, abs=2e-5)


def test_a_controller_lost_at_rest_continues_if_it_is_where_it_was(ros, controller, cell, tmp_path):
    cell.result(cell.send(0.03))
    cell.wait_for_mode(IDLE)
    assert (cell.states[-1].in_doubt, cell.states[-1].age) == (False, 0.0)
    unplug(controller, tmp_path / "port")
    cell.wait_for_mode(PusherState.MODE_DISCONNECTED)
    ros.wait_for(lambda: cell.states[-1].in_doubt and cell.states[-1].age > 0.2, what="a position that grows old")
    plug_in(controller, tmp_path / "port")
    cell.wait_for_mode(IDLE)
    assert cell.result(cell.send(0.01)).result.outcome == Push.Result.OUTCOME_REACHED
    assert controller.position() == pytest.approx(0.04)


def test_after_a_power_cut_during_a_push_nothing_moves_until_a_person_confirms(cell, controller, tmp_path, capfd):
    handle = cell.halfway(controller)
    controller.reset()
    result = cell.result(handle)
    assert result.result.outcome == Push.Result.OUTCOME_ABORTED
    assert result.result.message.endswith("restarted")
    cell.refuses(controller, capfd, UNVOUCHED)
    assert cell.states[-1].position < 1e-4  # what the controller claims
    assert cell.states[-1].in_doubt
    assert controller.position() > 0.001
    # do what the message asks for; the restart alone is not enough
    unplug(controller, tmp_path / "port")
    cell.wait_for_mode(PusherState.MODE_DISCONNECTED)
    controller._carriage = 0.0
    controller.reset()
    plug_in(controller, tmp_path / "port")
    cell.refuses(controller, capfd, UNVOUCHED)
    assert cell.reset().success
    cell.wait_for_mode(PusherState.MODE_IDLE)
    assert cell.result(cell.send(0.02)).result.outcome == Push.Result.OUTCOME_REACHED
    assert controller.position() == pytest.approx(0.02)


def test_a_port_that_appears_later_is_connected(ros, tmp_path, capfd):
    cell = Cell(ros, tmp_path / "port")
    cell.wait_for_mode(PusherState.MODE_DISCONNECTED)
    ros.wait_for(lambda: cell.node._connection._told is not None, what="the complaint")
    ros.wait_for(cell._client.server_is_ready, what="the action server")
    assert not cell.send().accepted
    with SimulatedGrbl(time.monotonic) as controller:
        (tmp_path / "port").symlink_to(controller.port)
        cell.wait_for_mode(PusherState.MODE_IDLE)
    assert capfd.readouterr().err.count(f"no serial port at {tmp_path}/port, retrying") == 1


def test_homing(ros, tmp_path):
    clock = HeldClock()
    with SimulatedGrbl(clock, homing=True) as controller:
        cell = Cell(ros, controller.port, home=True)
        cell.wait_for_mode(PusherState.MODE_HOMING)
        clock.release()
        cell.ready()
        assert cell.states[-1].position == pytest.approx(0.0, abs=1e-6)
        assert cell.result(cell.send(0.02)).result.outcome == Push.Result.OUTCOME_REACHED
        assert controller.position() == pytest.approx(0.02)
        assert cell.reset().message == "homing"
        ros.wait_for(lambda: abs(controller.position()) < 1e-9, what="homing")


def test_after_a_power_cut_a_pusher_that_homes_must_home_even_if_it_is_unlocked(ros, tmp_path, capfd):
    """Somebody at a terminal may unlock it, or the firmware: grblHAL boots unlocked unless configured otherwise."""
    with SimulatedGrbl(time.monotonic, homing=True) as controller:
        (tmp_path / "port").symlink_to(controller.port)
        cell = Cell(ros, tmp_path / "port", home=True).ready()
        cell.result(cell.send(0.02))
        cell.wait_for_mode(PusherState.MODE_IDLE)
        unplug(controller, tmp_path / "port")
        cell.wait_for_mode(PusherState.MODE_DISCONNECTED)
        controller.reset()
        controller._system("$X")
        plug_in(controller, tmp_path / "port")
        cell.refuses(controller, capfd, UNKNOWN + "see that it is free to move, then reset, which homes")
        assert cell.reset().success
        cell.wait_for_mode(PusherState.MODE_IDLE)
        assert controller.position() == pytest.approx(0.0)
        assert cell.states[-1].position == pytest.approx(0.0, abs=1e-6)


def test_a_node_that_ends_stops_its_pusher(ros, controller, cell):
    cell.halfway(controller)
    ros.end(cell.node)
    rest = controller.position()
    assert rest < 0.07
    assert controller.position() == rest


def test_a_signal_stops_the_pusher_and_its_client_is_told(controller, tmp_path):
    stage = LINE | {"port": f"{tmp_path}/port", "memory": "''"}
    arguments = [argument for key, value in stage.items() for argument in ("-p", f"{key}:={value}")]
    program = "from pushfric_ros.nodes.actuator import main; main()"
    environment = os.environ | {"ROS_DOMAIN_ID": "101"}
    with (
        killed_at_the_end([sys.executable, "-c", program, "--ros-args", *arguments], env=environment) as process,
        killed_at_the_end([sys.executable, "-c", PUSH], env=environment, stdout=subprocess.PIPE, text=True) as client,
    ):
        wait_until(lambda: controller.position() > 0.001, "a motion")
        process.send_signal(signal.SIGTERM)
        assert process.wait(10) == 0
        rest = controller.position()
        assert rest < 0.07
        assert controller.position() == rest
        said, _ = client.communicate(timeout=120)
        assert said.split() == ["2", "the", "actuator", "was", "told", "to", "end", str(PusherState.MODE_HOLD), "0.0"]


PUSH = """
import rclpy
from rclpy.action import ActionClient
from pushfric_msgs.action import Push
from pushfric_msgs.msg import PusherState
from pushfric_ros.node_kit.heartbeat import Heartbeat
from pushfric_ros.node_kit.network import configured
from pushfric_ros.node_kit.qos import RELIABLE
with configured():
    rclpy.init()
    node = rclpy.create_node("client")
states = []
node.create_subscription(PusherState, "pusher_state", states.append, RELIABLE)
client = ActionClient(node, Push, "push")
heartbeat = Heartbeat(node)
client.wait_for_server()
while True:
    answer = heartbeat.send(client, Push.Goal(push_id=1, distance=0.08, speed=0.004))
    rclpy.spin_until_future_complete(node, answer)
    if answer.result().accepted:
        break
result = answer.result().get_result_async()
rclpy.spin_until_future_complete(node, result)
for _ in range(20):
    rclpy.spin_once(node, timeout_sec=0.05)
print(result.result().result.outcome, result.result().result.message, states[-1].mode, states[-1].speed, flush=True)
"""
