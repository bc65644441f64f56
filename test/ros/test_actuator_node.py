"""The actuator node on the simulated controller: the push action, the states it publishes, and every way out of a motion."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from types import SimpleNamespace

import pytest
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionClient
from rclpy.parameter import Parameter
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from pushfric_core.errors import InvalidInput
from pushfric_msgs.action import Push
from pushfric_msgs.msg import PusherState
from pushfric_ros.actuator_node import ActuatorNode
from pushfric_ros.diagnostics import DiagnosticStatus
from pushfric_ros.grbl_firmware import SimulatedGrbl
from pushfric_ros.pusher import Mode
from pushfric_ros.qos import RELIABLE

LINE = {"line_origin": [0.1, -0.2], "line_direction": [0.0, 2.0], "tip_radius": 0.004, "stroke": 0.08, "max_speed": 0.08}


@pytest.fixture
def controller(tmp_path) -> Iterator[SimulatedGrbl]:
    """A simulated controller whose port is at tmp_path / "port", wherever it is plugged in."""
    with SimulatedGrbl(time.monotonic) as controller:
        (tmp_path / "port").symlink_to(controller.port)
        yield controller


def plug_in(controller: SimulatedGrbl, link) -> None:
    controller.start()
    link.unlink()
    link.symlink_to(controller.port)


def overrides(**parameters) -> list[Parameter]:
    return [Parameter(name, value=value) for name, value in parameters.items()]


class Cell:
    """An actuator node, and all that another node sees of it."""

    def __init__(self, ros, port, **parameters) -> None:
        self.ros = ros
        self.states: list[PusherState] = []
        self.feedback: list[Push.Feedback] = []
        self.health: list[DiagnosticStatus] = []
        # given to the executor before it asks for anything, so that no state is missed
        self._other = ros.node("other", namespace="/cell")
        self._other.create_subscription(PusherState, "pusher_state", self.states.append, RELIABLE)
        self._other.create_subscription(DiagnosticArray, "/diagnostics", lambda msg: self.health.extend(msg.status), RELIABLE)
        self._client = ActionClient(self._other, Push, "push")
        self._reset = self._other.create_client(Trigger, "actuator/reset")
        self.node = ActuatorNode(namespace="/cell", parameter_overrides=overrides(port=str(port), **LINE | parameters))
        ros.compose(self.node)

    def wait_for_mode(self, mode: int) -> None:
        self.ros.wait_for(lambda: self.states and self.states[-1].mode == mode, 20.0, what=f"mode {mode}")

    def ready(self) -> "Cell":
        self.wait_for_mode(PusherState.MODE_IDLE)
        self.ros.wait_for(self._client.server_is_ready, what="the action server")
        return self

    def send(self, distance=0.03, speed=0.08, retract=False, push_id=7):
        """Send a goal; its handle."""
        goal = Push.Goal(push_id=push_id, distance=distance, speed=speed, retract=retract)
        answer = self._client.send_goal_async(goal, feedback_callback=lambda msg: self.feedback.append(msg.feedback))
        self.ros.wait_for(answer.done, what="the answer to the goal")
        return answer.result()

    def result(self, handle) -> SimpleNamespace:
        answer = handle.get_result_async()
        self.ros.wait_for(answer.done, 20.0, what="the result")
        return answer.result()

    def reset(self) -> Trigger.Response:
        answer = self._reset.call_async(Trigger.Request())
        self.ros.wait_for(answer.done, what="the answer of ~/reset")
        return answer.result()


def test_modes_are_those_of_the_message():
    numbers = {name[5:]: getattr(PusherState, name) for name in dir(PusherState) if name.startswith("MODE_")}
    assert numbers.keys() == {mode.name for mode in Mode}


def test_a_push_and_the_way_back(ros, controller, tmp_path):
    cell = Cell(ros, tmp_path / "port").ready()
    result = cell.result(cell.send(0.03, 0.03, retract=True))
    assert result.status == GoalStatus.STATUS_SUCCEEDED
    assert result.result.outcome == Push.Result.OUTCOME_REACHED
    assert result.result.travelled == pytest.approx(0.03, abs=2e-5)
    assert result.result.message == "reached"
    assert controller.position() == pytest.approx(0.0)
    assert cell.feedback[-1].travelled == pytest.approx(0.03, abs=2e-5)
    pushing = [state for state in cell.states if state.push_id == 7]
    assert max(state.speed for state in pushing) == pytest.approx(0.03, rel=0.01)
    assert all(state.speed >= 0 for state in pushing)
    back = [state.speed for state in cell.states if state.speed < 0]
    assert min(back) == pytest.approx(-0.08, rel=0.01)
    assert all(state.push_id == PusherState.NO_PUSH for state in cell.states if state.speed < 0)
    for state in pushing:
        assert (state.header.frame_id, state.tip_radius) == ("table", 0.004)
        assert (state.direction.x, state.direction.y) == (0.0, 1.0)
        assert (state.tip.x, state.tip.y) == (0.1, pytest.approx(-0.2 + state.position))
    stamps = [state.header.stamp.sec * 10**9 + state.header.stamp.nanosec for state in cell.states]
    assert stamps == sorted(stamps)


def test_a_push_in_simulated_time(ros, tmp_path):
    """The clock moves in steps and faster than real time; every state tells where the pusher was at its stamp."""
    now = [1000.0]
    truth: dict[int, float] = {}
    clock = ros.node("clock")
    clock_out = clock.create_publisher(Clock, "/clock", RELIABLE)
    with SimulatedGrbl(lambda: now[0]) as controller:

        def tick() -> None:
            now[0] += 1 / 50
            stamp = Time(nanoseconds=round(now[0] * 1e9))
            truth[stamp.nanoseconds] = controller.position()
            clock_out.publish(Clock(clock=stamp.to_msg()))

        cell = Cell(ros, controller.port, use_sim_time=True)
        clock.create_timer(1 / 250, tick)
        cell.ready()
        assert cell.result(cell.send(0.06, 0.02)).result.outcome == Push.Result.OUTCOME_REACHED
    pushing = [state for state in cell.states if state.push_id == 7]
    assert len(pushing) > 20  # 3 s at 20 Hz, with room for a busy machine
    late = sorted(abs(state.position - truth[Time.from_msg(state.header.stamp).nanoseconds]) for state in pushing)
    assert late[len(late) // 2] <= 0.0004 + 1e-6  # one step of the clock


def test_pushes_follow_each_other(ros, controller, tmp_path):
    cell = Cell(ros, tmp_path / "port").ready()
    for end in (0.02, 0.04):
        assert cell.result(cell.send(0.02)).result.outcome == Push.Result.OUTCOME_REACHED
        assert controller.position() == pytest.approx(end)


@pytest.mark.parametrize(
    "goal",
    [
        {"distance": 0.0801},
        {"distance": 0.0},
        {"distance": float("nan")},
        {"distance": float("inf")},
        {"speed": 0.081},
        {"speed": 0.0},
        {"speed": float("nan")},
        {"push_id": -1},
    ],
)
def test_a_goal_beyond_the_limits_is_rejected(ros, controller, tmp_path, goal):
    cell = Cell(ros, tmp_path / "port").ready()
    assert not cell.send(**goal).accepted
    assert controller.position() == 0.0


def test_a_goal_is_rejected_while_another_runs(ros, controller, tmp_path):
    cell = Cell(ros, tmp_path / "port").ready()
    running = cell.send(0.06)
    assert not cell.send(0.01, push_id=8).accepted
    assert cell.result(running).result.outcome == Push.Result.OUTCOME_REACHED
    assert controller.position() == pytest.approx(0.06)


def test_a_goal_is_rejected_while_disconnected(ros, tmp_path):
    cell = Cell(ros, tmp_path / "port")
    cell.wait_for_mode(PusherState.MODE_DISCONNECTED)
    ros.wait_for(cell._client.server_is_ready, what="the action server")
    assert not cell.send().accepted


def test_a_canceled_push_stops(ros, controller, tmp_path):
    cell = Cell(ros, tmp_path / "port").ready()
    handle = cell.send(0.08, 0.03, retract=True)
    ros.wait_for(lambda: controller.position() > 0.005, what="the motion")
    ros.wait_for(handle.cancel_goal_async().done, what="the answer to the cancel")
    result = cell.result(handle)
    assert result.status == GoalStatus.STATUS_CANCELED
    assert result.result.outcome == Push.Result.OUTCOME_CANCELED
    rest = controller.position()
    assert result.result.travelled == pytest.approx(rest, abs=2e-5)
    assert 0.005 < rest < 0.06
    cell.wait_for_mode(PusherState.MODE_IDLE)
    assert cell.result(cell.send(0.01)).result.outcome == Push.Result.OUTCOME_REACHED
    assert controller.position() == pytest.approx(rest + 0.01, abs=2e-5)


def test_a_limit_in_mid_push_aborts_it_until_a_person_resets(ros, controller, tmp_path):
    cell = Cell(ros, tmp_path / "port").ready()
    handle = cell.send(0.08, 0.03)
    ros.wait_for(lambda: controller.position() > 0.005, what="the motion")
    assert not cell.reset().success
    controller.hit_limit()
    result = cell.result(handle)
    assert result.status == GoalStatus.STATUS_ABORTED
    assert (result.result.outcome, result.result.message) == (Push.Result.OUTCOME_ABORTED, "ALARM:1 Hard limit")
    cell.wait_for_mode(PusherState.MODE_ALARM)
    assert not cell.send(0.01).accepted
    ros.wait_for(lambda: cell.health and "ALARM:1 Hard limit" in cell.health[-1].message, what="the diagnostic")
    assert cell.health[-1].level == DiagnosticStatus.ERROR
    answer = cell.reset()
    assert (answer.success, answer.message) == (True, "unlocking")
    cell.wait_for_mode(PusherState.MODE_IDLE)
    rest = controller.position()
    assert cell.result(cell.send(0.01)).result.outcome == Push.Result.OUTCOME_REACHED
    assert controller.position() == pytest.approx(rest + 0.01, abs=2e-5)


def test_an_unplugged_controller_is_found_again_and_not_moved(ros, controller, tmp_path):
    cell = Cell(ros, tmp_path / "port").ready()
    handle = cell.send(0.08, 0.03)
    ros.wait_for(lambda: controller.position() > 0.005, what="the motion")
    controller.unplug()
    result = cell.result(handle)
    assert result.status == GoalStatus.STATUS_ABORTED
    assert result.result.outcome == Push.Result.OUTCOME_ABORTED
    assert "lost " in result.result.message
    cell.wait_for_mode(PusherState.MODE_DISCONNECTED)
    plug_in(controller, tmp_path / "port")
    cell.wait_for_mode(PusherState.MODE_IDLE)
    rest = controller.position()
    cell.states.clear()
    ros.wait_for(lambda: len(cell.states) > 5, what="more states")
    assert controller.position() == rest
    assert cell.states[-1].push_id == PusherState.NO_PUSH


def test_a_port_that_appears_later_is_connected(ros, tmp_path, capfd):
    cell = Cell(ros, tmp_path / "port")
    cell.wait_for_mode(PusherState.MODE_DISCONNECTED)
    ros.wait_for(lambda: cell.node._told is not None, what="the complaint")
    with SimulatedGrbl(time.monotonic) as controller:
        (tmp_path / "port").symlink_to(controller.port)
        cell.wait_for_mode(PusherState.MODE_IDLE)
    assert capfd.readouterr().err.count(f"no serial port at {tmp_path}/port, retrying") == 1


def test_homing(ros, tmp_path):
    with SimulatedGrbl(time.monotonic, homing=True) as controller:
        cell = Cell(ros, controller.port, home=True).ready()
        assert PusherState.MODE_HOMING in {state.mode for state in cell.states}
        assert cell.states[-1].position == pytest.approx(0.0, abs=1e-6)
        assert cell.result(cell.send(0.02)).result.outcome == Push.Result.OUTCOME_REACHED
        assert controller.position() == pytest.approx(0.02)
        assert cell.reset().message == "homing"
        ros.wait_for(lambda: abs(controller.position()) < 1e-9, what="homing")


def test_garbage_and_lost_bytes_do_not_disturb_a_push(ros, controller, tmp_path):
    cell = Cell(ros, tmp_path / "port").ready()
    handle = cell.send(0.06, 0.04)
    ros.wait_for(lambda: controller.position() > 0.005, what="the motion")
    controller.say(b"\x00\xffnoise\r\n<Run|MPos:1.0.0>\r\nerror:7\r\nok\r\n")
    controller.lose_bytes(5)
    assert cell.result(handle).result.outcome == Push.Result.OUTCOME_REACHED


def test_a_node_that_ends_stops_its_pusher(ros, controller, tmp_path):
    cell = Cell(ros, tmp_path / "port").ready()
    cell.send(0.08, 0.02)
    ros.wait_for(lambda: controller.position() > 0.005, what="the motion")
    executor = cell.node.executor
    executor.remove_node(cell.node)
    ros._nodes.remove(cell.node)
    ended = executor.create_task(cell.node.destroy_node)
    ros.wait_for(ended.done, what="the end of the node")
    rest = controller.position()
    assert rest < 0.07
    assert controller.position() == rest


def test_a_signal_stops_the_pusher(controller, tmp_path):
    parameters = [f"{key}:={value}" for key, value in LINE.items()] + [f"port:={tmp_path}/port"]
    arguments = [argument for parameter in parameters for argument in ("-p", parameter)]
    program = "from pushfric_ros.actuator_node import main; main()"
    environment = os.environ | {"ROS_DOMAIN_ID": "101"}
    process = subprocess.Popen([sys.executable, "-c", program, "--ros-args", *arguments], env=environment)
    try:
        subprocess.run([sys.executable, "-c", PUSH], env=environment, check=True, timeout=60)
        deadline = time.monotonic() + 20
        while controller.position() < 0.005:
            assert time.monotonic() < deadline, "no motion"
            time.sleep(0.01)
        process.send_signal(signal.SIGTERM)
        assert process.wait(10) == 0
        rest = controller.position()
        assert rest < 0.07
        assert controller.position() == rest
    finally:
        process.kill()
        process.wait()


PUSH = """
import rclpy
from rclpy.action import ActionClient
from pushfric_msgs.action import Push
rclpy.init()
node = rclpy.create_node("client")
client = ActionClient(node, Push, "push")
client.wait_for_server()
while True:
    answer = client.send_goal_async(Push.Goal(push_id=1, distance=0.08, speed=0.02))
    rclpy.spin_until_future_complete(node, answer)
    if answer.result().accepted:
        break
node.destroy_node()
rclpy.shutdown()
"""


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({}, "port must name the serial port of the GRBL controller, got ''"),
        ({"port": "/dev/x", "line_direction": [0.0, 0.0]}, r"line_direction must have a length, got \(0, 0\)"),
        ({"port": "/dev/x", "line_origin": [0.0]}, r"line_origin must be two finite numbers, got \(0.0,\)"),
        ({"port": "/dev/x", "axis": "Q"}, "axis must be X, Y, Z, A, B or C, .*got 'Q'"),
        ({"port": "/dev/x", "stroke": 0.0}, "parameter stroke must lie in"),
        ({"port": "/dev/no_such_port", "wait_for_port": False}, "no serial port at /dev/no_such_port"),
    ],
)
def test_unusable_parameters_are_refused(ros, parameters, text):
    with pytest.raises(InvalidInput, match=text):
        ActuatorNode(parameter_overrides=overrides(**parameters))
