import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from composition import made
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped, WrenchStamped
from problems import observations_of
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from pushfric_core import TABLE_1, Estimator, HalfPlanes, InvalidInput, Pose, PushedObject, PushingLine
from pushfric_core.bags.samples import observation_from_msg, stamp_from_msg
from pushfric_core.estimation.region import line_of_motion
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.object_file import load_object
from pushfric_msgs.msg import (
    CenterOfFrictionRegion,
    ContactFriction,
    EstimatorProgress,
    FrictionEstimate,
    Observation,
    PusherState,
    SupportFriction,
)
from pushfric_msgs.srv import SelectObject, SelectPush
from pushfric_ros.messages.conversions import observation_to_msg, pose_to_msg, stamp_to_msg
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE, SENSOR_DATA
from pushfric_ros.nodes.estimator import EstimatorNode

NAME = "rubber_rect4"
FRAME = round(1e9 / 14)
DATA = observations_of(TABLE_1[NAME].outline, TABLE_1[NAME].support, 0.5, 5, np.random.default_rng(5))


def estimator_of_observations(ros, **parameters):
    """A node next to a running estimator, its publisher of observations, and the list of estimates it receives."""
    node = ros.node("peer", namespace="/cell")
    ros.compose(made(EstimatorNode, object=NAME, source="observations", **parameters))
    estimates = ros.heard(node, FrictionEstimate, "friction_estimate", RELIABLE)
    out = ros.publisher(node, Observation, "observation", RELIABLE)
    ros.wait_for(lambda: node.count_publishers("friction_estimate"), what="the estimator")
    return node, out, estimates


def estimator_of_samples(ros, **parameters):
    """A node next to an estimator, a function that sends that one messages, and its observations and estimates from them."""
    node = ros.node("peer", namespace="/cell")
    ros.compose(made(EstimatorNode, object=NAME, **parameters))
    observations = ros.heard(node, Observation, "observation", RELIABLE)
    estimates = ros.heard(node, FrictionEstimate, "friction_estimate", RELIABLE)
    poses = ros.publisher(node, PoseWithCovarianceStamped, "object_pose", SENSOR_DATA)
    states = ros.publisher(node, PusherState, "pusher_state", RELIABLE)
    ros.wait_for(lambda: all(map(node.count_publishers, ("observation", "friction_estimate"))), what="the estimator")
    return node, lambda msg: (states if isinstance(msg, PusherState) else poses).publish(msg), observations, estimates


def pose_msg(stamp, pose):
    msg = PoseWithCovarianceStamped()
    msg.header.stamp, msg.pose.pose = stamp_to_msg(stamp), pose_to_msg(pose)
    return msg


def pusher_msg(stamp, position, push_id):
    msg = PusherState(position=position, speed=0.02, tip_radius=0.003, push_id=push_id, mode=PusherState.MODE_RUNNING)
    msg.header.stamp = stamp_to_msg(stamp)
    msg.direction.y, msg.tip.y = 1.0, position
    return msg


@functools.cache
def motion(push_id):
    """Position of the pusher and pose of the object in each frame of a push."""
    known = TABLE_1[NAME]
    pushed = PushedObject(known.outline, known.support, known.mu_c, Pose(0.03 - 0.02 * push_id, 0.04, 0.0))
    line = PushingLine((0.0, 0.0), (0.0, 1.0), 0.003)
    frames = []
    for position in np.arange(38) * 0.02 / 14:
        pushed.push(line, position)
        frames.append((float(position), pushed.pose))
    return frames


def push(push_id, start):
    """The messages of the cell about one push, in order of time."""
    for frame, (position, pose) in enumerate(motion(push_id)):
        stamp = start + frame * FRAME
        yield pose_msg(stamp, pose)
        yield pusher_msg(stamp + 1, position, push_id)


def test_every_data_point_gives_the_same_estimate_as_the_core(ros):
    node, send, observations, estimates = estimator_of_samples(ros)
    progress = ros.heard(node, EstimatorProgress, "estimator_progress", LATCHED)
    model = Estimator(load_object(NAME).support_points)
    for push_id in range(2):
        for msg in push(push_id, 10**18 + push_id * 10**10):
            send(msg)
        ros.wait_for(lambda wanted=4 * (push_id + 1): len(observations) >= wanted, what="the observations of a push")
    last = 10**18 + 10**10 + 37 * FRAME  # of the poses; the last state of the pusher comes 1 ns later
    ros.wait_for(
        lambda: progress and stamp_from_msg(progress[-1].settled_until) == last, what="the word that all poses are dealt with"
    )
    ros.wait_for(
        lambda: (
            observations
            and estimates
            and observations[-1].header.stamp == estimates[-1].header.stamp == progress[-1].header.stamp
        ),
        what="the estimate of the last observation",
    )
    expected = [model.add(observation_from_msg(msg)) for msg in observations]
    assert [msg.data_points for msg in estimates] == list(range(1, len(observations) + 1))
    for msg, estimate in zip(estimates, expected, strict=True):
        assert list(msg.support_friction.weights) == list(estimate.w)
        assert msg.objective == estimate.solution.objective
        assert msg.header.stamp == msg.support_friction.header.stamp
    assert progress[-1].header == estimates[-1].header


def test_the_belief_comes_when_a_push_is_over(ros, monkeypatch):
    """However short the pause before the next one is."""
    monkeypatch.setattr("pushfric_ros.nodes.estimator.rest.QUIET", 1e6)
    _, send, observations, estimates = estimator_of_samples(ros)
    for msg in push(0, 10**18):
        send(msg)
    ros.wait_for(lambda: len(observations) == len(estimates) == 4, what="the estimates of a push")
    assert estimates[-1].spread.data_points == 0
    send(pusher_msg(10**18 + 38 * FRAME, 0.05, PusherState.NO_PUSH))
    ros.wait_for(lambda: estimates[-1].spread.data_points == estimates[-1].data_points, what="the belief")


def test_a_pause_within_a_push_is_told_in_the_diagnostics(ros):
    node, send, observations, _ = estimator_of_samples(ros)
    reports = ros.heard(node, DiagnosticArray, "/diagnostics", RELIABLE)
    for number, msg in enumerate(push(0, 10**18)):
        if number % 2 or number not in range(40, 52):  # six poses in a row did not come
            send(msg)
    ros.wait_for(lambda: observations, what="an observation")
    said = "no pose came for 0.500 s of push 0"

    def told():
        warnings = [one for report in reports for one in report.status if one.level == DiagnosticStatus.WARN]
        return any(one.message == said and said in str(one.values) for one in warnings)

    ros.wait_for(told, what="the doubt")


def test_bad_messages_are_refused_and_change_nothing(ros):
    _, out, estimates = estimator_of_observations(ros)
    good = [observation_to_msg(observation, NAME) for observation in DATA[:3]]
    broken, still, far = (observation_to_msg(DATA[0], NAME) for _ in range(3))
    broken.contact_point.x = math.nan
    far.contact_point.x = 0.5
    still.twist.linear.x = still.twist.linear.y = still.twist.angular.z = 0.0
    for msg in (good[0], broken, good[1], still, far, good[2]):
        out.publish(msg)
    ros.wait_for(lambda: len(estimates) == 3, what="the good observations' estimates")
    assert estimates[-1].data_points == 3


def test_reset_and_select_object_restart_the_estimate(ros, tmp_path):
    node, out, estimates = estimator_of_observations(ros)
    first = observation_to_msg(DATA[0], NAME)
    for count in (1, 2):
        out.publish(first)
        ros.wait_for(lambda count=count: len(estimates) == count, what="an estimate")
    assert ros.call(node, Trigger, "estimator/reset").success
    out.publish(first)  # of a push that is left out
    out.publish(observation_to_msg(DATA[1], NAME))
    ros.wait_for(lambda: len(estimates) == 4, what="an estimate")
    assert [msg.data_points for msg in estimates] == [1, 2, 0, 1]
    assert ros.call(node, SelectObject, "estimator/select_object", object="wood_rect3").success
    refusal = ros.call(node, SelectObject, "estimator/select_object", object="brick")
    assert not refusal.success
    assert "no object 'brick'" in refusal.message
    bomb = tmp_path / "bomb.yaml"
    bomb.write_text("[" * 3000)
    for name in ("x" * 5000, "!!int ''", str(tmp_path), str(bomb)):
        refusal = ros.call(node, SelectObject, "estimator/select_object", object=name)
        assert not refusal.success
        assert len(refusal.message) < 1100
    broken = observation_to_msg(DATA[0], NAME)
    broken.half_width = 1e200
    out.publish(broken)
    out.publish(observation_to_msg(DATA[2], NAME))
    ros.wait_for(lambda: len(estimates) == 6, what="an estimate")
    assert [(msg.object, msg.data_points) for msg in estimates[4:]] == [("wood_rect3", 0), ("wood_rect3", 1)]


def test_parameters_reach_the_region_and_the_slipping_pushes(ros):
    node, out, _ = estimator_of_observations(ros, region_margin=0.01, slipping_pushes=[0, 2], exclude_pushes=[1])
    regions = ros.heard(node, CenterOfFrictionRegion, "center_of_friction_region", LATCHED)
    frictions = ros.heard(node, ContactFriction, "contact_friction", RELIABLE)
    ros.wait_for(lambda: node.count_publishers("contact_friction"), what="the estimator")
    core, half_planes = Estimator(load_object(NAME).support_points), HalfPlanes(TABLE_1[NAME].outline, 0.01)
    for observation in DATA[:4]:
        if observation.push_id != 1:
            estimate, region = core.add(observation), half_planes.add(line_of_motion(observation))
        out.publish(observation_to_msg(observation, NAME))
    ros.wait_for(lambda: len(frictions) == 3, what="mu_c")
    ros.wait_for(lambda: regions and regions[-1].area == region.area, what="the region")
    slipping = estimate.contact_friction[:2]  # of the pushes 0 and 2
    assert list(frictions[-1].slipping) == [slipping.min(), slipping.max()]
    assert sum(frictions[-1].histogram) == 3
    markers = ros.heard(node, MarkerArray, "markers", LATCHED)
    ros.wait_for(lambda: markers, what="the markers")
    assert {"center_of_friction_region", "next_push"} <= {marker.ns for marker in markers[-1].markers}


def wrench_msg(stamp, force):
    msg = WrenchStamped()
    msg.header.stamp, msg.header.frame_id = stamp_to_msg(stamp), "table"
    msg.wrench.force.x, msg.wrench.force.y = force
    return msg


def test_measured_forces_reach_the_estimate(ros):
    node, send, observations, estimates = estimator_of_samples(ros, terms=["moment", "force"])
    wrenches = ros.publisher(node, WrenchStamped, "wrench", RELIABLE)
    wrong = wrench_msg(10**18 - 1, (1.0, 0.0))
    wrong.header.frame_id = "sensor"
    wrenches.publish(wrong)  # refused, because it is in another frame
    for msg in push(0, 10**18):
        send(msg)
        if isinstance(msg, PusherState):
            wrenches.publish(wrench_msg(10**18 + round(msg.position / 0.02 * 1e9), (0.0, 2.0)))
    ros.wait_for(lambda: len(estimates) >= 4, what="the estimates of the push")
    assert len(observations) == len(estimates)
    for msg in observations:
        theta = 2 * math.atan2(msg.pose.orientation.z, msg.pose.orientation.w)
        assert (msg.force.x, msg.force.y) == pytest.approx((2 * math.sin(theta), 2 * math.cos(theta)), abs=1e-9)
    assert estimates[-1].support_friction.total_friction == pytest.approx(2.0, rel=0.2)


def test_a_clock_that_jumps_back_restarts_the_estimate(ros):
    node, out, estimates = estimator_of_observations(ros, use_sim_time=True)
    clock = ros.publisher(node, Clock, "/clock", RELIABLE)
    live = ros._nodes[-1]
    for count, seconds in ((1, 100), (2, 101), (4, 50)):
        clock.publish(Clock(clock=stamp_to_msg(seconds * 10**9)))
        ros.wait_for(lambda seconds=seconds: live.get_clock().now().nanoseconds == seconds * 10**9, what="the clock")
        out.publish(observation_to_msg(DATA[0], NAME))
        ros.wait_for(lambda count=count: len(estimates) == count, what="an estimate")
    assert [msg.data_points for msg in estimates] == [1, 2, 0, 1]


PARTS = {"support_friction": SupportFriction, "center_of_friction": PointStamped, "contact_friction": ContactFriction}


def nothing_is_known(parts):
    return (
        parts["support_friction"] is not None
        and not parts["support_friction"].weights
        and math.isnan(parts["center_of_friction"].point.x)
        and math.isnan(parts["contact_friction"].p90)
    )


def latest(ros, node):
    """The last message on each topic of the estimate."""
    parts = dict.fromkeys(PARTS)
    for topic, kind in PARTS.items():
        node.create_subscription(kind, topic, lambda msg, topic=topic: parts.update({topic: msg}), LATCHED)
    return parts


def test_an_excluded_push_stays_excluded_until_it_is_kept(ros):
    node, out, estimates = estimator_of_observations(ros)
    settings = ros.heard(node, String, "estimator_settings", LATCHED)
    parts = latest(ros, node)
    data = [observation_to_msg(replace(observation, push_id=7), NAME) for observation in DATA[:2]]
    out.publish(data[0])
    ros.wait_for(lambda: len(estimates) == 1, what="an estimate")
    for choice in ("exclude", "keep"):
        refusal = ros.call(node, SelectPush, f"estimator/{choice}_push", push_id=9)
        assert (refusal.success, refusal.message) == (False, "push_id must be one of 7, got 9")
    assert ros.call(node, SelectPush, "estimator/exclude_push", push_id=7).success
    ros.wait_for(lambda: nothing_is_known(parts), what="that what was published is taken back")
    ros.wait_for(lambda: len(estimates) == 2, what="the end of the estimate")
    assert estimates[-1].status == FrictionEstimate.STATUS_NO_DATA
    ros.wait_for(lambda: EstimatorSettings.from_text(settings[-1].data).excluded == (7,), what="the settings")
    out.publish(data[1])  # of the same push: left out
    out.publish(observation_to_msg(DATA[3], NAME))
    ros.wait_for(lambda: len(estimates) == 3, what="an estimate from another push")
    assert (estimates[-1].data_points, estimates[-1].pushes) == (1, 1)
    answer = ros.call(node, SelectPush, "estimator/keep_push", push_id=7)
    assert (answer.success, answer.message) == (True, "kept: 3 observations of 2 pushes are in")
    ros.wait_for(lambda: len(estimates) == 4, what="the estimate with the push")
    assert (estimates[-1].data_points, estimates[-1].pushes) == (3, 2)
    ros.wait_for(lambda: EstimatorSettings.from_text(settings[-1].data).kept == (7,), what="the settings")
    assert ros.call(node, Trigger, "estimator/reset").success
    out.publish(observation_to_msg(DATA[4], NAME))
    ros.wait_for(lambda: len(estimates) == 6, what="an estimate after the reset")
    assert (estimates[-1].data_points, estimates[-1].pushes) == (1, 1)
    assert EstimatorSettings.from_text(settings[-1].data).excluded == (DATA[3].push_id, 7)
    assert estimates[-1].spread.data_points == 0  # no belief of before the reset stays


def test_contradicting_data_give_a_status_and_no_values(ros):
    node, out, estimates = estimator_of_observations(ros)
    parts = latest(ros, node)
    reports = ros.heard(node, DiagnosticArray, "/diagnostics", RELIABLE)

    def said(level, words):
        return any(one.level == level and words in one.message for report in reports for one in report.status)

    out.publish(observation_to_msg(DATA[0], NAME))
    ros.wait_for(lambda: parts["support_friction"] is not None and parts["support_friction"].weights, what="w")
    ros.wait_for(lambda: said(DiagnosticStatus.OK, "p_CF rests on 1 push"), what="the word that one push tells nothing")
    pulled = observation_to_msg(DATA[1], NAME)
    pulled.contact_normal.x, pulled.contact_normal.y = -pulled.contact_normal.x, -pulled.contact_normal.y
    out.publish(pulled)  # no support friction lets the pusher pull
    ros.wait_for(lambda: len(estimates) == 2 and nothing_is_known(parts), what="that w, p_CF and mu_c are taken back")
    assert estimates[-1].status == FrictionEstimate.STATUS_INFEASIBLE
    ros.wait_for(lambda: said(DiagnosticStatus.ERROR, "the normals point inward in 1 of 2"), what="the cause")
    assert ros.call(node, SelectPush, "estimator/exclude_push", push_id=1).success
    ros.wait_for(lambda: parts["support_friction"].weights, what="w without the push that contradicts")


@pytest.mark.parametrize(
    ("parameters", "error"),
    [
        ({}, "object must be given: name of an object of Table 1, or path of an object YAML"),
        ({"object": NAME, "terms": ["moment", "cone"]}, "the term cone needs a mu_bound"),
    ],
)
def test_bad_parameters_are_refused_with_a_reason(ros, parameters, error):
    with pytest.raises(InvalidInput, match=error):
        made(EstimatorNode, **parameters)
