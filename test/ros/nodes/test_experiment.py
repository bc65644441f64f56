"""The experiment node with an actuator on a simulated controller; the test plays the operator."""

import itertools
import re
import time
from types import SimpleNamespace

import pytest
from composition import made
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from rclpy.action import ActionServer, GoalResponse
from rosgraph_msgs.msg import Clock as ClockMsg
from stage import STAGE
from std_srvs.srv import Trigger

from pushfric_core import TABLE_1, Pose, PushingLine
from pushfric_core.bags.samples import pose_from_msg
from pushfric_core.cell.node_settings import PlanConfig
from pushfric_core.estimation.push_plan import SHARP, PlannedPush, placement
from pushfric_core.geometry.planar import TABLE
from pushfric_core.trajectories.samples import PoseSample
from pushfric_msgs.action import Push
from pushfric_msgs.msg import CenterOfFrictionRegion, ContactFriction, EstimatorProgress, Observation, PlanProgress, PusherState
from pushfric_msgs.msg import TestPush as Candidate
from pushfric_msgs.srv import SelectPush
from pushfric_ros.messages.conversions import pose_to_msg, stamp_to_msg
from pushfric_ros.node_kit.heartbeat import Heartbeat
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE, SENSOR_DATA
from pushfric_ros.node_kit.visit import visit
from pushfric_ros.nodes import experiment
from pushfric_ros.nodes.actuator import ActuatorNode
from pushfric_ros.nodes.experiment import ExperimentNode, others, reports
from pushfric_ros.nodes.experiment.reports import ReportedPusher, SeenObject

PLAN = "pushes: [{edge: 0}, {edge: 1, offset: 0.01}, {edge: 2, angle_deg: 10}]"
AWAY = Pose(0.0, 0.3, 0.0)
ALARM = "it is in alarm: mend what it reports, see that it is free to move, then press Reset"
GAP = 0.005
"""Gap between the resting tip and the placed object [m]."""
STILL = 0.15
"""How long the object must lie still [s]; short, so that the tests are quick."""


class Table:
    """The table as the experiment sees it: poses of an object that lies where the test, or the prompt, puts it."""

    def __init__(self, ros, tmp_path, actuator=None, period=0.02, obedient=True, observed=True, **parameters) -> None:
        self.ros, self.obedient, self.observed, self.object = ros, obedient, observed, AWAY
        self.visible = True
        self.wanted: list[Pose] = []
        self.progress: list[PlanProgress] = []
        self.states: list[PusherState] = []
        self.now = None  # time of the poses [ns]; None: that of the pusher's last report
        self.shown = lambda pose: pose  # what the camera shows of the object
        self._pushed: tuple[int, Pose] | None = None  # the present push, and where the object lay before it
        self.left_out: list[int] = []  # pushes that the estimator was told to exclude,
        self.refuses = 0  # and how often it refuses that
        self.newest = 0  # stamp of the estimator's newest observation [ns]
        self.well = ["/cell/estimator"]
        self.settled = 0 if parameters.get("choose") else (2**31 - 1) * 10**9  # what the estimator reports [ns]
        self._node = ros.node("table", namespace="/cell")  # spun from now on
        self._node.create_subscription(PoseStamped, "placement", self._on_placement, LATCHED)
        # every message counts here, not only the last one
        self._node.create_subscription(PlanProgress, "plan_progress", self.progress.append, RELIABLE)
        self._node.create_subscription(PusherState, "pusher_state", self._on_state, RELIABLE)
        self._pose_out = self._node.create_publisher(PoseWithCovarianceStamped, "object_pose", SENSOR_DATA)
        self._health_out = self._node.create_publisher(DiagnosticArray, "/diagnostics", RELIABLE)
        self._estimator_out = self._node.create_publisher(EstimatorProgress, "estimator_progress", LATCHED)
        self._observation_out = self._node.create_publisher(Observation, "observation", RELIABLE)
        self._node.create_timer(period, self._show)
        self._estimator = self._node.create_service(SelectPush, "estimator/exclude_push", self._on_exclude)
        (tmp_path / "plan.yaml").write_text(PLAN)
        given = {"object": "wood_rect4", "plan": str(tmp_path / "plan.yaml"), "distance": 0.03, "speed": 0.08,
                 "still": STILL, "awaits": ["estimator"]}  # fmt: skip
        time_of = {name: value for name, value in parameters.items() if name == "use_sim_time"}
        if actuator is None:
            self.actuator = ros.compose(made(ActuatorNode, port=str(tmp_path / "port"), **STAGE, **time_of))
        self.node = ros.compose(made(ExperimentNode, **given | parameters))

    def _on_placement(self, msg: PoseStamped) -> None:
        self.wanted.append(pose_from_msg(msg.pose))
        if self.obedient:
            self.object = self.wanted[-1]

    def _on_exclude(self, request: SelectPush.Request, response: SelectPush.Response) -> SelectPush.Response:
        self.left_out.append(request.push_id)
        response.success = len(self.left_out) > self.refuses
        return response

    def _on_state(self, msg: PusherState) -> None:
        self.states.append(msg)
        if msg.push_id != PusherState.NO_PUSH and (self._pushed is None or self._pushed[0] != msg.push_id):
            self._pushed = msg.push_id, self.object
            if self.observed:
                self._observation_out.publish(Observation(push_id=msg.push_id))

    def _follow(self) -> None:
        """Let the object follow the tip straight on, without turning."""
        if self.states and self.states[-1].push_id != PusherState.NO_PUSH:
            before = self._pushed[1]
            self.object = before._replace(y=before.y + max(0.0, self.states[-1].position - GAP))

    def _show(self) -> None:
        status = [DiagnosticStatus(level=DiagnosticStatus.OK, name=name) for name in self.well]
        progress = EstimatorProgress(settled_until=stamp_to_msg(self.settled), judged=True)
        progress.header.stamp = stamp_to_msg(self.newest)
        self._estimator_out.publish(progress)
        self._health_out.publish(DiagnosticArray(status=status))
        if not self.visible:
            return
        self._follow()
        msg = PoseWithCovarianceStamped()
        msg.pose.pose = pose_to_msg(self.shown(self.object))
        msg.header.frame_id = TABLE
        if self.now is not None:
            msg.header.stamp = stamp_to_msg(self.now())
        elif self.states:  # as late as the reports: else a busy machine would let the object leap
            msg.header.stamp = self.states[-1].header.stamp
        else:
            msg.header.stamp = self._node.get_clock().now().to_msg()
        self._pose_out.publish(msg)

    def wait_for_message(self, text: str, timeout: float = 120.0) -> PlanProgress:
        """Wait for the next report with this text that no earlier call has returned."""
        found: list[PlanProgress] = []

        def heard() -> bool:
            while self.progress and not found:
                if text in (msg := self.progress.pop(0)).message:
                    found.append(msg)
            return bool(found)

        self.ros.wait_for(heard, timeout, what=f"the report {text!r}")
        return found[0]

    def places(self, number: int, push: PlannedPush, prompt: str) -> None:
        """Say that all is settled; the prompt must come, and the placement of this number must be that of this push."""
        self.settled = time.time_ns()
        self.wait_for_message(prompt)
        self.ros.wait_for(lambda: len(self.wanted) == number, what="the placement")
        wanted = placement(TABLE_1["wood_rect4"].outline, push, PushingLine((0.0, 0.0), (0.0, 1.0), 0.003), 0.005)
        assert self.wanted[-1] == pytest.approx(wanted, abs=1e-3)

    def wait_for_end(self) -> PlanProgress:
        last = self.wait_for_message("pushes done")
        assert last.phase == PlanProgress.PHASE_FINISHED
        with pytest.raises(SystemExit) as ended:  # the node ends its process with its plan
            self.ros.wait_for(lambda: False, what="the end")
        assert ended.value.code == 0
        return last

    def ends_with(self, ids: list[int], completed: int, aborted: int = 0, skipped: int = 0) -> PlanProgress:
        """Wait for the end, and expect these pushes to have gone forward, and so many of each outcome."""
        last = self.wait_for_end()
        assert (last.completed, last.aborted, last.skipped) == (completed, aborted, skipped)
        assert pushed(self.states) == ids
        return last

    def call(self, service: str) -> bool:
        return self.ros.call(self._node, Trigger, service).success

    def choose(self, choice: str) -> None:
        """Wait until a person is asked what becomes of an aborted push, and answer."""
        asked = self.wait_for_message("Repeat it, skip it, or end the run?")
        assert asked.phase == PlanProgress.PHASE_CHOOSING
        assert "experiment/repeat" in asked.details
        assert self.call(f"experiment/{choice}")


def pushed(states) -> list[int]:
    """Ids of the pushes that went forward, in order."""
    ids = [state.push_id for state in states if state.push_id != PusherState.NO_PUSH]
    return [push_id for push_id, _ in itertools.groupby(ids)]


def test_a_plan_is_carried_out(ros, controller, tmp_path):
    table = Table(ros, tmp_path)
    first = table.wait_for_message("push 1 of 3: place the object at")
    assert (first.phase, first.push_id, first.count) == (PlanProgress.PHASE_PLACING, 0, 3)
    assert table.ends_with([0, 1, 2], completed=3).message == "3 of 3 pushes done"
    assert controller.position() == pytest.approx(0.0)
    # edge 0 of a rectangle about its origin faces -y: the object lies beyond the tip, its gap and the tip's radius
    assert table.wanted[0].theta == pytest.approx(0.0)
    assert table.wanted[0].x == pytest.approx(0.0)


def test_each_push_is_chosen_from_the_outcome_of_all_before_it(ros, controller, tmp_path):
    table = Table(ros, tmp_path, plan="", choose=3)
    region = table._node.create_publisher(CenterOfFrictionRegion, "center_of_friction_region", LATCHED)
    table.wait_for_message("waiting for: the region of p_CF")
    for number, choice in enumerate((PlannedPush(1, 0.01), PlannedPush(2, -0.02)), 1):
        region.publish(CenterOfFrictionRegion(next_pushes=[Candidate(**choice._asdict()), Candidate(edge=3)]))
        table.places(number, choice, f"push {number} of 3: place the object at")
        # the estimator has not processed the last push yet
        table.wait_for_message("waiting for: the region of p_CF")
    region.publish(CenterOfFrictionRegion(collapsed=True))
    ros.wait_for(lambda: table.node._estimator._region.collapsed, what="the collapse")
    table.settled = time.time_ns()
    last = table.wait_for_end()
    assert (last.completed, last.aborted, last.count) == (2, 0, 3)
    assert last.message == "2 of 3 pushes done"


def test_from_the_fourth_on_every_other_chosen_push_is_for_mu_c(ros, controller, tmp_path):
    node = ros.node("region", namespace="/cell")
    region = node.create_publisher(CenterOfFrictionRegion, "center_of_friction_region", LATCHED)
    mu_c = node.create_publisher(ContactFriction, "contact_friction", LATCHED)
    mu_c.publish(ContactFriction(kind=ContactFriction.KIND_BOUND))
    table = Table(ros, tmp_path, plan="", choose=8, start=4)
    shrink, slips = PlannedPush(1, 0.01), [PlannedPush(2, -0.01, SHARP), PlannedPush(0, 0.01, -SHARP)]
    msg = CenterOfFrictionRegion(
        next_pushes=[Candidate(**shrink._asdict())], slip_pushes=[Candidate(**slip._asdict()) for slip in slips]
    )
    for number, expected in ((4, slips[0]), (5, shrink), (6, slips[1]), (7, shrink), (8, shrink)):
        region.publish(msg)
        table.places(number - 3, expected, f"push {number} of 8: place the object at")
        table.wait_for_message("waiting for: the region of p_CF" if number < 8 else "5 of 8 pushes done")
        if number == 7:
            mu_c.publish(ContactFriction(kind=ContactFriction.KIND_SLIP))


def test_a_push_waits_for_the_nodes_that_listen(ros, controller, tmp_path):
    """The object may be placed meanwhile; if somebody then moves it, the operator is told before the push."""
    estimator = ros.node("estimator", namespace="/cell")
    life = Heartbeat(estimator)
    table = Table(ros, tmp_path, awaits=["estimator", "recorder"])
    table.wait_for_message("place the object")
    assert table.wait_for_message("waiting for: recorder").phase == PlanProgress.PHASE_WAITING
    assert not table.call("experiment/skip")  # there is no push to give up yet
    wanted, table.object = table.object, AWAY
    ros.wait_for(lambda: table.node._object.misplaced(wanted, "") == "move it by about 260 mm")
    table.well.append("/cell/recorder")
    table.wait_for_message("move it by about 260 mm")
    life.end()  # the node has died, and is started again
    ros.wait_for(lambda: table.node._others.unwell() == "estimator", 60.0, what="the silence of the estimator")
    table.object = wanted
    table.wait_for_message("waiting for: estimator")
    assert not pushed(table.states)
    life = Heartbeat(estimator)
    ros.wait_for(lambda: 0 in pushed(table.states), 60.0, what="the push")


def test_the_operator_is_told_what_is_wrong_with_the_placement(ros, controller, tmp_path):
    table = Table(ros, tmp_path, obedient=False)
    table.object = Pose(0.5, 0.5, 0.0)
    table.wait_for_message("move it by about")
    wanted = table.wanted[0]
    table.visible = False
    table.wait_for_message("it is not seen")
    reason = "outline does not fit: it looks 128.6 x 64.8 mm"
    # whichever node publishes poses says why there are none
    status = DiagnosticStatus(name="/cell/pose_source", values=[KeyValue(key="no pose", value=reason)])
    source = ros.node("pose_source", namespace="/cell")
    said = source.create_timer(0.1, lambda: table._health_out.publish(DiagnosticArray(status=[status])))
    table.wait_for_message(f": {reason}")
    said.cancel()
    table.object, table.visible = wanted._replace(theta=wanted.theta + 0.7), True
    table.wait_for_message(": turn it clockwise by about 40 degrees")
    table.object = wanted._replace(y=wanted.y + 0.02, theta=wanted.theta + 1.3)
    table.wait_for_message("move it by about 20 mm and turn it clockwise by about 70 degrees")
    table.object = wanted
    table.wait_for_message("let it lie still")
    assert table.wait_for_message("push 1 of 3").phase in (PlanProgress.PHASE_PLACING, PlanProgress.PHASE_PUSHING)
    ros.wait_for(lambda: 0 in pushed(table.states), what="the push")


def test_an_emergency_stop_at_rest_is_told_at_once_and_the_run_goes_on_after_it(ros, controller, tmp_path):
    table = Table(ros, tmp_path, start=3, obedient=False)
    table.wait_for_message("push 3 of 3: place the object at")
    controller.hold_in_reset(True)
    assert table.wait_for_message(ALARM).phase == PlanProgress.PHASE_ALARM
    table.call("actuator/reset")
    ros.wait_for(lambda: "release it, then reset" in str(table.actuator._problem), 60.0, "the refusal of the reset")
    controller.hold_in_reset(False)
    ros.wait_for(lambda: table.call("actuator/reset"), 60.0, "the reset")
    table.wait_for_message("push 3 of 3: place the object at")
    table.object = table.wanted[-1]
    assert table.wait_for_end().completed == 1


def test_few_frames_show_that_the_object_lies_still(ros, controller, tmp_path):
    """No two of them are as far apart as `still` and within it."""
    Table(ros, tmp_path, period=0.7 * STILL).wait_for_message("the pusher moves")


def test_a_plan_continues_where_it_was_interrupted(ros, controller, tmp_path):
    """The earlier run left the pusher within its stroke: it is brought back before the operator is asked for anything."""
    controller._carriage, controller._offset = 25.0, 0.0
    table = Table(ros, tmp_path, start=3)
    table.wait_for_message("bringing the pusher back")
    assert not table.wanted
    table.ends_with([2], completed=1)
    assert controller.position() == pytest.approx(0.0)


def test_a_person_goes_on_to_the_next_push_while_placing_and_while_pushing(ros, controller, tmp_path, capfd):
    table = Table(ros, tmp_path, speed=0.02, obedient=False)
    table.wait_for_message("push 1 of 3: place the object at")
    assert table.call("experiment/skip")
    table.wait_for_message("push 2 of 3: place the object at")
    table.obedient, table.object = True, table.wanted[-1]
    table.wait_for_message("push 2 of 3")
    ros.wait_for(lambda: any(state.push_id == 1 and state.position > 0.002 for state in table.states), what="a stroke")
    assert table.call("experiment/skip")
    table.wait_for_message("bringing the pusher back")
    assert table.ends_with([1, 2], completed=1, skipped=2).message == "1 of 3 pushes done, 2 skipped"
    assert capfd.readouterr().err.count("a person skipped it") == 2


@pytest.mark.parametrize("fault", ["alarm", "unplugged"])
def test_a_fault_during_a_push_waits_for_the_operator_and_costs_one_push(ros, controller, tmp_path, fault):
    table = Table(ros, tmp_path, start=2)
    ros.wait_for(lambda: controller.position() > 0.01, what="the push")
    {"alarm": controller.hit_limit, "unplugged": controller.close}[fault]()
    if fault == "unplugged":
        table.wait_for_message("no controller answers: is it switched on, and plugged in?")
        controller.start()
        (tmp_path / "port").unlink()
        (tmp_path / "port").symlink_to(controller.port)
    waiting = table.wait_for_message(ALARM)
    assert waiting.phase == PlanProgress.PHASE_ALARM
    assert "actuator/reset" in waiting.details
    assert controller.position() > 0.005
    assert table.call("actuator/reset")
    table.choose("skip")
    table.ends_with([1, 2], completed=1, skipped=1)
    if fault == "alarm":
        assert controller.position() == pytest.approx(0.0, abs=1e-4)


def test_an_alarm_ends_a_run_that_nobody_attends(ros, controller, tmp_path, monkeypatch):
    monkeypatch.setattr(experiment.operator, "ALARM_PATIENCE", 0.5)
    Table(ros, tmp_path, attended=False)
    ros.wait_for(lambda: controller.position() > 0.01, what="the push")
    controller.hit_limit()
    with pytest.raises(SystemExit, match=f"waiting for the pusher: {ALARM}; nobody is here to do that"):
        ros.wait_for(lambda: False, 60.0, what="the end")


@pytest.mark.parametrize("until", ["it is seen", "a person says so"])
def test_an_object_lost_in_mid_push_stops_the_pusher_which_stays(ros, controller, tmp_path, capfd, until):
    table = Table(ros, tmp_path, speed=0.01, lost_object=0.5)
    ros.wait_for(lambda: controller.position() > 0.002, what="the push")
    table.visible = False
    table.choose("skip")
    table.wait_for_message("the pusher stays where it is: the object is not seen")
    assert max(state.position for state in table.states) < 0.029  # short of the push's end
    assert re.search(r"push 1 aborted: the object was not seen for \d+\.\d\d s; lost_object is 0\.5 s", capfd.readouterr().err)
    rest = controller.position()
    table.states.clear()
    ros.wait_for(lambda: len(table.states) > 20, what="more states")
    assert controller.position() == rest
    if until == "it is seen":
        table.visible = True
    else:
        assert table.call("experiment/withdraw")
    table.wait_for_message("bringing the pusher back")
    table.wait_for_message("push 2 of 3: place the object")
    assert min(state.speed for state in table.states) >= -0.0101  # no faster than asked
    table.visible = True
    ros.wait_for(lambda: 1 in pushed(table.states), what="the next push")


class DeafPusher:
    """An actuator that reports that it is idle, whatever it is asked to do."""

    def __init__(self, ros, accept: bool) -> None:
        self._node = ros.node("actuator", namespace="/cell")
        self._state_out = self._node.create_publisher(PusherState, "pusher_state", RELIABLE)
        answer = GoalResponse.ACCEPT if accept else GoalResponse.REJECT
        self._server = ActionServer(
            self._node, Push, "push", pytest.fail, goal_callback=lambda _: answer,
            handle_accepted_callback=lambda goal: None,
        )  # fmt: skip
        self._node.create_timer(0.02, self._report)

    def _report(self) -> None:
        msg = PusherState(mode=PusherState.MODE_IDLE, push_id=PusherState.NO_PUSH, tip_radius=0.003)
        msg.header.stamp = self._node.get_clock().now().to_msg()
        msg.direction.y = 1.0
        self._state_out.publish(msg)


def test_no_push_is_made_while_another_cell_has_the_same_name(ros, controller, tmp_path):
    """On this machine a lock prevents it; on another machine, its pusher would carry out this cell's goals."""
    other = ros.node("another_experiment", namespace="/cell")
    other.create_publisher(PlanProgress, "plan_progress", LATCHED)
    table = Table(ros, tmp_path)
    table.wait_for_message("another cell named /cell is running on this ROS domain: end it")
    assert all(state.push_id == PusherState.NO_PUSH for state in table.states)
    ros.end(other)
    assert table.wait_for_end().completed == 3


@pytest.mark.parametrize(
    ("accept", "why"),
    [
        (False, "the pusher refused it"),
        (True, r"the pusher forgot it: it has reported for \d+\.\d s that it idles; lost_result is 0\.3 s"),
    ],
)
def test_a_push_that_is_refused_or_forgotten_is_counted_and_the_plan_continues(ros, tmp_path, capfd, accept, why):
    DeafPusher(ros, accept)
    last = Table(ros, tmp_path, actuator="deaf", lost_result=0.3, attended=False, start=2).wait_for_end()
    assert (last.completed, last.aborted) == (0, 2)
    assert len(re.findall(f"aborted: {why}", capfd.readouterr().err)) == 2


def test_a_foreign_clock_is_named_before_the_first_push(ros, controller, tmp_path):
    table = Table(ros, tmp_path)
    table.now = lambda: time.time_ns() + 3600 * 10**9
    table.settled = (2**31 - 1) * 10**9
    told = table.wait_for_message("no push can be measured: the clock of the camera is 3600 s ahead of this computer's: set it")
    assert told.phase == PlanProgress.PHASE_WAITING
    assert pushed(table.states) == []
    table.now = None  # someone has set it
    ros.wait_for(lambda: 0 in pushed(table.states), 60.0, what="the push")


def test_a_push_is_stopped_when_what_is_seen_does_not_follow_it(ros, controller, tmp_path, capfd):
    """For example, an image that is not new although its noise is; test_trajectory.py has others."""
    table = Table(ros, tmp_path, speed=0.02)
    seen: list[Pose] = []

    def shown(pose: Pose) -> Pose:
        if controller.position() < 0.01:
            seen.append(pose)
        return seen[-1]

    table.shown = shown
    ros.wait_for(lambda: table.node._operator._asked, 60.0, what="the aborted push")
    assert max(state.position for state in table.states) < 0.025  # of 0.03: it was stopped
    said = capfd.readouterr().err
    assert "push 1 aborted: the object does not follow the pusher" in said
    assert "check that the camera gives new images" in said


def test_a_stopped_push_is_repeated_under_a_number_of_its_own(ros, controller, tmp_path):
    table = Table(ros, tmp_path, speed=0.02)
    ros.wait_for(lambda: any(state.push_id == 0 and state.position > 0.002 for state in table.states), 60.0, "a push")
    assert table.call("actuator/stop")
    waiting = table.wait_for_message("it was stopped: press Reset")
    assert (waiting.phase, waiting.details) == (PlanProgress.PHASE_WAITING, "services: actuator/reset; fault: stopped")
    assert not table.call("experiment/withdraw")
    assert table.call("actuator/reset")
    table.choose("repeat")
    assert table.wait_for_message("push 1 (again) of 3: place the object at").push_id == 3
    assert table.ends_with([0, 3, 1, 2], completed=3).message == "3 of 3 pushes done"
    assert table.left_out == [0]


def test_a_push_that_a_pause_ended_is_repeated_without_a_person(ros, controller, tmp_path, capfd):
    table = Table(ros, tmp_path, speed=0.01)  # slow: on a busy machine an object that goes fast seems to leap
    ros.wait_for(lambda: any(state.push_id == 0 and state.position > 0.002 for state in table.states), 60.0, "a push")
    table.actuator._pusher._polled -= STAGE["silence"] + 0.5  # as if the process had stood still
    table.ends_with([0, 3, 1, 2], completed=3)
    assert "push 1 is repeated: the pusher rests where it should" in capfd.readouterr().err


@pytest.mark.parametrize("why", ["it moved nothing", "the tracker stood still"])
def test_a_push_that_gave_no_observation_is_named_at_once_and_can_be_repeated(ros, controller, tmp_path, capfd, why):
    table = Table(ros, tmp_path, lost_object=2.0, start=2, observed=False)
    if why == "the tracker stood still":
        table.settled = 0
        ros.wait_for(lambda: controller.position() > 0.01, 60.0, "the push")
        table.visible = False  # for less than lost_object before its end
    asked = table.wait_for_message("push 2 of 3 was given up: no observation came from it")
    assert ("the object is not seen" in asked.message) == (not table.visible)
    assert table.states[-1].position == pytest.approx(0.0, abs=1e-3)  # nothing stopped it
    table.observed = table.visible = True
    table.settled = (2**31 - 1) * 10**9
    assert table.call("experiment/repeat")
    table.ends_with([1, 4, 2], completed=2)


def test_a_push_that_was_half_seen_can_be_repeated_too(ros, controller, tmp_path):
    table = Table(ros, tmp_path, start=2, observed=False)
    ros.wait_for(table._observation_out.get_subscription_count, 60.0, "the subscription to observations")
    for push_id, count in ((0, 5), (1, 2), (4, 3), (2, 5)):
        for second in range(count):
            observation = Observation(push_id=push_id)
            observation.header.stamp.sec = second
            table._observation_out.publish(observation)
    table.wait_for_message("push 2 of 3 was given up: only 2 observations came from it, up to 5 from others")
    assert table.call("actuator/stop")  # while a person chooses
    table.wait_for_message("it was stopped: press Reset")
    assert table.call("actuator/reset")
    table.choose("repeat")
    table.ends_with([1, 4, 2], completed=2)
    assert table.left_out == [1]


@pytest.mark.parametrize("estimator", [True, False])
def test_a_push_without_observations_counts_as_lost_where_nobody_attends(ros, controller, tmp_path, monkeypatch, estimator):
    """The estimator is told to leave it out, if there is one; else the run ends all the same, after LAST_WORDS."""
    table = Table(ros, tmp_path, attended=False, start=3, observed=False)
    if not estimator:
        table._node.destroy_service(table._estimator)
        monkeypatch.setattr(experiment, "LAST_WORDS", 0.5)
    last = table.wait_for_end()
    assert (last.completed, last.aborted, table.left_out) == (0, 1, [2] * estimator)


def test_an_estimator_that_is_behind_is_awaited_after_a_push(ros, controller, tmp_path):
    table = Table(ros, tmp_path, start=3, observed=False)
    table.settled = 0
    assert table.wait_for_message("push 3 of 3: waiting for its observations").phase == PlanProgress.PHASE_PUSHING
    table._observation_out.publish(Observation(push_id=2))
    table.settled = (2**31 - 1) * 10**9
    assert table.wait_for_end().completed == 1


def test_an_observation_that_comes_after_the_word_of_it_is_awaited(ros, controller, tmp_path, monkeypatch):
    monkeypatch.setattr(experiment, "LATE", 1000.0)
    table = Table(ros, tmp_path, start=3, observed=False)
    table.wait_for_message("push 3 of 3: place the object at")
    table.newest = 1
    table.wait_for_message("push 3 of 3: waiting for its observations")
    observation = Observation(push_id=2)
    observation.header.stamp.nanosec = 1
    table._observation_out.publish(observation)
    assert table.wait_for_end().completed == 1


def test_a_plan_has_not_ended_before_the_estimator_leaves_out_what_it_must(ros, controller, tmp_path):
    """What it says after the end is its last word."""
    table = Table(ros, tmp_path, attended=False, start=3, observed=False)
    table._node.destroy_service(table._estimator)
    assert table.wait_for_message("waiting for the estimator").phase == PlanProgress.PHASE_WAITING
    table._node.create_service(SelectPush, "estimator/exclude_push", table._on_exclude)
    table.wait_for_message("pushes done")
    assert table.left_out == [2]


def test_an_estimator_that_died_before_it_answered_is_asked_again(ros, controller, tmp_path, monkeypatch):
    monkeypatch.setattr(others, "ASK_AGAIN", 0.2)
    table = Table(ros, tmp_path, attended=False, start=3, observed=False)
    table._node.destroy_service(table._estimator)
    with visit("dies") as dies:  # it is never spun, so it takes the request with it
        dies.node.create_service(SelectPush, "/cell/estimator/exclude_push", table._on_exclude)
        ros.wait_for(lambda: table.node._estimator._answer, 120.0, "the request")
    table._node.create_service(SelectPush, "estimator/exclude_push", table._on_exclude)
    table.wait_for_end()
    assert set(table.left_out) == {2}


def test_an_estimator_that_still_reads_its_bag_is_asked_again(ros, controller, tmp_path, monkeypatch):
    monkeypatch.setattr(others, "ASK_AGAIN", 0.2)
    table = Table(ros, tmp_path, attended=False, start=3)
    account, table.refuses = table.node._estimator, 2
    ros.wait_for(lambda: account.heard and account._observed[2], 120.0, "an observation")
    account.unwanted.append(2)
    table.wait_for_end()
    assert table.left_out == [2, 2, 2]


def test_a_standstill_of_the_node_counts_as_silence_of_nobody(monkeypatch):
    pusher, seen = ReportedPusher(3.0, lambda: True), SeenObject(TABLE_1["wood_rect4"].outline, PlanConfig(lost_object=1.0))
    clock = SimpleNamespace(monotonic=lambda: 100.0)
    monkeypatch.setattr(reports, "time", clock)
    pusher.report(PusherState(mode=PusherState.MODE_IDLE, push_id=PusherState.NO_PUSH))
    seen.report(PoseSample(0, AWAY))
    clock.monotonic = lambda: 110.0
    assert (pusher.hindrance(), seen.unseen) == ("it does not report", True)
    pusher.excuse(9.5)
    seen.excuse(9.5)
    assert (pusher.hindrance(), pusher.forgotten(), seen.unseen) == (None, "", False)
    pusher.excuse(9.5)  # nothing was heard later than now
    clock.monotonic = lambda: 113.5
    assert pusher.forgotten() == "its last report came 3.5 s ago; lost_result is 3 s"


def test_a_distance_to_go_is_not_told_for_longer_than_it_is_known(monkeypatch):
    """Also where a push goes on without a pose for long, as on a busy machine with a simulated cell."""
    seen = SeenObject(TABLE_1["wood_rect4"].outline, PlanConfig(lost_object=10.0))
    wanted = Pose(AWAY.x + 0.03, AWAY.y, AWAY.theta)
    clock = SimpleNamespace(monotonic=lambda: 100.0)
    monkeypatch.setattr(reports, "time", clock)
    seen.report(PoseSample(0, AWAY))
    assert seen.misplaced(wanted, "") == "move it by about 30 mm"
    clock.monotonic = lambda: 102.0
    assert (seen.misplaced(wanted, ""), seen.misplaced(wanted, "too dark")) == ("it is not seen", "it is not seen: too dark")


def test_the_operator_is_told_of_a_lost_object_though_simulated_time_stands_still(ros, controller, tmp_path):
    clock = ros.node("clock").create_publisher(ClockMsg, "/clock", RELIABLE)
    table = Table(ros, tmp_path, use_sim_time=True)
    table.obedient, table.object = False, Pose(0.5, 0.5, 0.0)
    now = itertools.count(10**18, 10**8)
    running = table._node.create_timer(0.02, lambda: clock.publish(ClockMsg(clock=stamp_to_msg(next(now)))))
    table.wait_for_message("move it by about")
    running.cancel()
    table.visible = False
    table.wait_for_message("it is not seen")


def test_a_person_ends_the_run_while_it_is_stopped(ros, controller, tmp_path):
    """Nothing moves: the pusher stays where it is, and needs no reset."""
    table = Table(ros, tmp_path, speed=0.02)
    ros.wait_for(lambda: any(state.push_id == 0 and state.position > 0.002 for state in table.states), 60.0, "a push")
    assert not table.call("experiment/repeat")  # nothing was aborted yet
    assert table.call("actuator/stop")
    table.wait_for_message("it was stopped: press Reset")
    assert not table.call("experiment/withdraw")
    assert table.call("experiment/end")
    last = table.wait_for_message("0 of 3 pushes done; ended by a person")
    assert (last.phase, last.completed, last.aborted) == (PlanProgress.PHASE_FINISHED, 0, 0)
