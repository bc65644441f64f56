"""The drivers of arms, over the real middleware, against the simulated arm of examples/arm.py: its joints are the truth."""

import contextlib
import math
import signal
import sys
import time

import arm as example
import numpy as np
import pytest
from calls import killed_at_the_end
from geometry_msgs.msg import PoseStamped, TwistStamped
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from pushfric_core.geometry.planar import Pose, inverse, transform
from pushfric_core.pushers.clock import suspended
from pushfric_core.pushers.pusher import Grade, LeftTheWay, Mode, NotConnected, NotReady, PusherConfig, Suspended, Timeout
from pushfric_ros.arms import arm as arms
from pushfric_ros.arms.trajectory import JointTrajectoryConfig
from pushfric_ros.arms.twist import TwistConfig
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE

STAGE = PusherConfig((0.0, 0.0), (0.0, 1.0), 0.003, 0.06, 0.1)
POSES = {"source": "pose_stamped", "topic": "/tool_pose", "origin": (0.0, 0.0, 0.12), "table": (0.5, 0.1, 0.3)}
PATIENT = 30.0  # silence, for a busy machine [s]
DRIVERS = {"twist": TwistConfig, "trajectory": JointTrajectoryConfig}


@pytest.fixture
def device(ros):
    """The simulated arm."""
    return ros.compose(example.Arm())


@pytest.fixture(params=DRIVERS)
def kind(request):
    return DRIVERS[request.param]


@contextlib.contextmanager
def connected(kind=TwistConfig, stage=STAGE, **settings):
    with contextlib.closing(kind(**{**POSES, "silence": PATIENT, **settings}).open_pusher(stage)) as pusher:
        carry_out(pusher, pusher.connect)
        yield pusher


def until(pusher, condition):
    """Poll until a condition holds for the last report; return all reports."""
    reports, deadline = [], time.monotonic() + 60.0
    while not (reports and condition(reports[-1])):
        assert time.monotonic() < deadline, reports[-3:]
        pusher.ask(0)
        if (report := pusher.poll()) is not None:
            reports.append(report)
        time.sleep(0.002)
    return reports


def carry_out(pusher, command):
    """Give a command, poll until the pusher rests, and return the reports."""
    command()
    return until(pusher, lambda _: not pusher.busy)


def fails(pusher, error, text):
    """Poll until an error is raised, and expect it to be this one."""
    with pytest.raises(error, match=text):
        until(pusher, lambda _: False)


def start_a_stroke(pusher):
    """Start a slow stroke, and wait until it is well under way."""
    pusher.move_to(0.05, 0.01)
    until(pusher, lambda report: report.position > 0.005)


def tip(device) -> np.ndarray:
    """Where the tip of the simulated arm is: (2,) on the table, and how high [m]."""
    place, axes, _ = example.forward(device.joints)
    x, y, z = place + axes @ (0.0, 0.0, example.TOOL)
    return np.array((*transform(inverse(Pose(*example.TABLE)), (x, y)), z))


def at_rest(ros, device) -> np.ndarray:
    ros.wait_for(lambda: np.abs(device._speeds).max() < 1e-7, what="an arm at rest")
    return tip(device)


def test_a_stroke_ends_where_it_was_sent_and_stays_on_its_line(ros, device, kind):
    with connected(kind) as pusher:
        assert (pusher.mode, pusher.doubt) == (Mode.IDLE, None)
        height = tip(device)[2]
        pusher.move_to(0.03, 0.03)
        assert pusher.mode is Mode.RUNNING
        way = []

        def note(report):
            way.append(tip(device))
            return report.mode is Mode.IDLE

        reports = until(pusher, note)
        way = np.array(way)
        assert way[-1] == pytest.approx((0.0, 0.03, height), abs=2e-4)
        assert way[:, 1].max() < 0.03 + 1e-4
        assert np.abs(way[:, (0, 2)] - (0.0, height)).max() < 5e-4
        assert reports[-1].position == pytest.approx(0.03, abs=1e-4)
        assert (reports[-1].mode, reports[-1].speed) == (Mode.IDLE, 0.0)
        assert np.all(np.diff([report.stamp for report in reports]) > 0)
        carry_out(pusher, lambda: pusher.move_to(0.0, 0.05))
        assert at_rest(ros, device) == pytest.approx((0.0, 0.0, height), abs=2e-4)


def test_a_line_anywhere_on_the_table(ros, device):
    """The line is that of the cell's file, in the table frame."""
    with connected(stage=PusherConfig((-0.02, 0.01), (2.0, -1.0), 0.003, 0.1, 0.1)) as pusher:
        begin = until(pusher, lambda _: True)[-1].position
        assert begin == pytest.approx(math.sqrt(0.02**2 + 0.01**2), abs=1e-4)
        carry_out(pusher, lambda: pusher.move_to(begin + 0.02, 0.05))
        assert at_rest(ros, device)[:2] == pytest.approx(0.02 * np.array((2, -1)) / math.sqrt(5), abs=2e-4)


def test_a_stop_ends_the_motion(ros, device, kind):
    with connected(kind) as pusher:
        pusher.move_to(0.05, 0.02)
        until(pusher, lambda report: report.position > 0.01)
        carry_out(pusher, pusher.stop)
        assert 0.01 < at_rest(ros, device)[1] < 0.03
        assert (pusher.mode, pusher.doubt) == (Mode.IDLE, None)


def test_an_arm_whose_driver_is_not_polled_stops_by_itself(ros, device, kind):
    with connected(kind, silence=1.0) as pusher:
        start_a_stroke(pusher)
        time.sleep(1.1)  # what is tested: nobody polls
        rest = at_rest(ros, device)
        with pytest.raises(Timeout, match=r"this process stood still for 1\.\d\d s"):
            pusher.poll()
        until(pusher, lambda _: not pusher.busy)
        assert at_rest(ros, device) == pytest.approx(rest, abs=1e-4)


def test_an_arm_that_is_not_seen_is_stopped(ros, device):
    with connected(silence=0.5) as pusher:
        start_a_stroke(pusher)
        device._count = -(10**9) * example.POSES + 1  # no more poses
        device._publish = lambda *_: None
        fails(pusher, Timeout, r"no report of /base_link/tool0 for 0\.\d\d s in mid-stroke")
        fails(pusher, NotConnected, r"no report of /base_link/tool0 for 1\.\d s, the limit is 1 s")
        assert (pusher.mode, pusher.busy) == (Mode.DISCONNECTED, False)
        at_rest(ros, device)
        del device._publish
        assert carry_out(pusher, pusher.connect)[-1].mode is Mode.IDLE
        assert pusher.doubt is None


def test_an_arm_that_stood_still_is_not_pulled_after(ros, kind, monkeypatch):
    """It would have to catch up, faster than the stroke, with what was sent while it was not seen."""
    monkeypatch.setattr(arms, "CONNECT", 60.0)  # its process starts meanwhile
    with killed_at_the_end([sys.executable, example.__file__]) as process, connected(kind) as pusher:
        pusher.move_to(0.03, 0.008)
        for place in (0.005, 0.015):
            until(pusher, lambda report, place=place: report.position > place)
            process.send_signal(signal.SIGSTOP)
            goes_on = time.monotonic() + 0.6  # longer than all that it was sent
            while time.monotonic() < goes_on:
                pusher.poll()
            process.send_signal(signal.SIGCONT)
        assert until(pusher, lambda _: not pusher.busy)[-1].position == pytest.approx(0.03, abs=2e-4)


def test_a_pose_that_is_none_ends_the_motion(ros, device):
    with connected() as pusher:
        start_a_stroke(pusher)
        nowhere = PoseStamped()
        nowhere.pose.position.x = math.nan
        device._pose_out.publish(nowhere)
        fails(pusher, NotConnected, "no pose of the arm: ")
        assert (pusher.mode, pusher.busy) == (Mode.DISCONNECTED, False)
        assert at_rest(ros, device)[1] < 0.03


def test_a_tip_that_is_pushed_off_its_line_needs_a_person(ros, device):
    with connected() as pusher:
        start_a_stroke(pusher)
        before = device.joints.copy()
        # 4 mm higher
        device.joints = example.backward(example.forward(before)[0] + (0.0, 0.0, 0.004), example.DOWN, before)
        fails(pusher, LeftTheWay, r"the tip is \d\.\d mm beside its line")
        until(pusher, lambda _: not pusher.busy)
        with pytest.raises(NotReady, match="beside its line"):
            pusher.move_to(0.05, 0.01)
        carry_out(pusher, pusher.recover)
        carry_out(pusher, lambda: pusher.move_to(0.02, 0.05))
        assert at_rest(ros, device)[1] == pytest.approx(0.02, abs=2e-4)


def test_a_tip_beside_its_line_is_not_moved(device):
    with connected(stage=PusherConfig((0.003, 0.0), (0.0, 1.0), 0.003, 0.06, 0.1)) as pusher:
        for ask in (pusher.recover, lambda: pusher.move_to(0.01, 0.01)):
            with pytest.raises(NotReady, match=r"the tip is 3\.0 mm beside its line, expected 2 mm at most"):
                ask()


def test_an_arm_that_moves_when_it_is_found_needs_a_person(ros, device):
    with connected() as first:
        first.move_to(0.05, 0.005)
        until(first, lambda report: report.position > 0.001)
        second = TwistConfig(**POSES, silence=PATIENT).open_pusher(STAGE)
        second.connect()
        deadline = time.monotonic() + 60.0
        while second.busy:
            assert time.monotonic() < deadline
            first.poll()
            second.poll()
        assert second.doubt == "the arm moved when it was found"
        assert second.mode is Mode.RUNNING
        second._visit.close()
        second._visit = None


def test_after_a_suspension_a_person_is_asked(ros, device, monkeypatch):
    with connected() as pusher:
        start_a_stroke(pusher)
        slept = suspended() + 4.0
        monkeypatch.setattr("pushfric_core.pushers.clock.suspended", lambda: slept)
        fails(pusher, Suspended, r"this computer was suspended for 4\.\d s")
        until(pusher, lambda _: not pusher.busy)
        with pytest.raises(NotReady, match="suspended"):
            pusher.move_to(0.05, 0.01)


def test_without_an_arm_there_is_one_line(ros, monkeypatch):
    monkeypatch.setattr(arms, "CONNECT", 0.3)
    pusher = TwistConfig(**POSES).open_pusher(STAGE)
    for what in ("nobody listens to /servo_node/delta_twist_cmds", "no pose of /base_link/tool0"):
        pusher.connect()
        fails(pusher, NotConnected, f"{what}; expected within 0.3 s")
        ros.node("servo").create_subscription(TwistStamped, "/servo_node/delta_twist_cmds", lambda _: None, 10)
    pusher.close()


def test_a_trajectory_needs_the_joints_and_their_urdf(ros, monkeypatch):
    monkeypatch.setattr(arms, "CONNECT", 0.3)
    pusher = JointTrajectoryConfig(**POSES).open_pusher(STAGE)
    node = ros.node("controller")
    description = node.create_publisher(String, "/robot_description", LATCHED)

    def lacks(what):
        pusher.connect()
        fails(pusher, NotConnected, f"{what}; expected within 0.3 s")

    lacks("nobody listens to /joint_trajectory_controller/joint_trajectory")
    node.create_subscription(JointTrajectory, "/joint_trajectory_controller/joint_trajectory", lambda _: None, 10)
    lacks("no URDF on /robot_description")
    description.publish(String(data="<robot"))
    lacks("the URDF on /robot_description: is not XML: .*")
    description.publish(String(data=example.urdf()))
    lacks("no positions of joint_1, .*joint_6 on /joint_states")
    pusher.close()


def test_an_arm_that_is_held_back_is_not_pulled_ever_harder(ros, device):
    sent = ros.heard(ros.node("listener"), JointTrajectory, "/joint_trajectory_controller/joint_trajectory", RELIABLE)
    with connected(JointTrajectoryConfig) as pusher:
        go_on, here = device._go_on, device.joints

        def held(until: float) -> None:
            go_on(until)
            device.joints = here

        device._go_on = held
        pusher.move_to(0.05, 0.02)
        until(pusher, lambda _: len(sent) > 100)
        off = np.array([point.positions for msg in sent for point in msg.points]) - here
        speeds = np.linalg.solve(example.forward(here)[2], (*(0.02 * pusher._axes[0]), 0, 0, 0))
        assert 0.1 < np.linalg.norm(off, axis=1).max() / np.linalg.norm(speeds) < 2 * arms.DEAD_MAN


def test_the_doctor_looks_and_moves_nothing(ros, device, monkeypatch):
    before = device.joints.copy()
    checks = list(TwistConfig(**POSES).checks(STAGE, 0.05, 0.02))
    assert [(check.name, check.level) for check in checks] == [("arm", Grade.OK), ("dead-man", Grade.OK)]
    assert "the tip is 0.0 mm beside its line" in checks[0].finding
    aside = PusherConfig((0.003, 0.0), (0.0, 1.0), 0.003, 0.06, 0.1)
    assert next(TwistConfig(**POSES).checks(aside, 0.05, 0.02)).level is Grade.WARNING
    monkeypatch.setattr(arms, "CONNECT", 0.3)
    (failed,) = TwistConfig(**POSES | {"topic": "/elsewhere"}).checks(STAGE, 0.05, 0.02)
    assert (failed.level, failed.finding[:7]) == (Grade.FAILED, "no pose")
    assert (device.joints == before).all()


@pytest.mark.parametrize(
    ("settings", "stage", "error"),
    [
        ({"source": "odometry"}, STAGE, "source must be one of transforms, pose_stamped, got 'odometry'"),
        ({}, PusherConfig((0, 0), (0, 1), 0.003, 0.06, 0.1, home=True), "home must be false"),
        ({"rate": 1.0}, STAGE, r"rate must lie in \[10.0, 500.0\], got 1.0"),
        ({"origin": (1.0,)}, STAGE, "origin must be a list of 3 finite numbers"),
    ],
)
def test_settings_that_do_not_fit_are_refused(settings, stage, error):
    with pytest.raises(ValueError, match=error):
        TwistConfig(**settings).open_pusher(stage)


def test_the_tip_is_found_on_tf(ros, device):
    pytest.importorskip("tf2_msgs.msg", reason="tf2_msgs is not installed")
    with connected(source="transforms", frame="tool0", reference="base_link") as pusher:
        assert carry_out(pusher, lambda: pusher.move_to(0.02, 0.05))[-1].position == pytest.approx(0.02, abs=1e-4)


def test_a_missing_type_of_message_is_one_line():
    with contextlib.suppress(ImportError):
        import tf2_msgs.msg

        pytest.skip(f"{tf2_msgs.msg.__name__} is installed")
    assert "'tf2_msgs/msg/TFMessage' is not installed" in TwistConfig().absence()
    assert TwistConfig(**POSES).absence() is None
