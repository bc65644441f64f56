import math
import pathlib
import re

import pytest
from geometry_msgs.msg import Pose as PoseMsg
from geometry_msgs.msg import Quaternion
from problems import four_feet
from rclpy.serialization import deserialize_message, serialize_message

from pushfric_core import Estimator, Observation, Pose, Twist
from pushfric_core.bags import constants, message_types, samples
from pushfric_core.belief.doubts import Change, Rejected
from pushfric_core.belief.mistakes import LINEAR
from pushfric_core.estimation.estimate_report import EstimateReport
from pushfric_core.estimation.verdict import Verdict
from pushfric_core.wording import Reason
from pushfric_msgs.msg import ContactFriction, FrictionEstimate, ObjectChange, PlanProgress, PusherState
from pushfric_ros.messages import conversions, types

CORE = pathlib.Path(__file__).parents[3] / "src/pushfric_core/pushfric_core"


def test_poses_survive_the_message(rng):
    for _ in range(50):
        pose = Pose(*rng.normal(size=2), rng.uniform(-math.pi, math.pi))
        assert samples.pose_from_msg(conversions.pose_to_msg(pose)) == pytest.approx(pose)


def test_impossible_poses_are_refused():
    with pytest.raises(ValueError, match="must be finite"):
        samples.pose_from_msg(conversions.pose_to_msg(Pose(math.nan, 0, 0)))
    with pytest.raises(ValueError, match="quaternion of length 1"):
        samples.pose_from_msg(PoseMsg(orientation=Quaternion(w=0.0)))


@pytest.mark.parametrize(
    ("force", "pose", "duration", "depth"), [(None, Pose(0.25, 0.5, 0.0), None, 0.0), ((1.5, -0.5), None, 1 / 7, None)]
)
def test_observations_survive_message_and_wire_bit_for_bit(force, pose, duration, depth):
    observation = Observation(
        contact_point=(0.1, 1 / 3),
        contact_normal=(0.6, -0.8),
        twist=Twist(0.01, 1e-9, -0.3),
        push_id=7,
        half_width=0.002,
        duration=duration,
        stamp=123456789123456789,
        pose=pose,
        force=force,
        depth=depth,
    )
    wire = serialize_message(conversions.observation_to_msg(observation, "box"))
    msg = deserialize_message(wire, type(conversions.observation_to_msg(observation, "box")))
    assert msg.object == "box"
    assert samples.observation_from_msg(msg) == observation


def state(position=0.02, **changes):
    msg = PusherState(position=position, speed=0.02, tip_radius=0.003, push_id=4)
    msg.direction.x, msg.direction.y = 0.6, 0.8
    msg.tip.x, msg.tip.y = 0.1 + 0.6 * position, -0.2 + 0.8 * position
    for name, value in changes.items():
        setattr(msg, name, value)
    return msg


def test_no_push_becomes_none():
    assert samples.pusher_sample_from_msg(state(push_id=PusherState.NO_PUSH)).push_id is None
    assert samples.pusher_sample_from_msg(state()).push_id == 4


def test_impossible_pusher_states_are_refused():
    with pytest.raises(ValueError, match="pusher state must be finite"):
        samples.pusher_sample_from_msg(state(speed=math.nan))
    bent = state()
    bent.direction.x = 1.0
    with pytest.raises(ValueError, match="direction of the pushing line must have length 1"):
        samples.pusher_sample_from_msg(bent)


@pytest.mark.parametrize("pushes", [1, 9])  # without a spread, and with one
def test_a_report_survives_the_message(pushes):
    problem = four_feet()
    estimate = Estimator(problem.truth.points).add(problem.observations[:pushes])
    assert (estimate.confidence is None) == (pushes == 1)
    reasons = tuple(Reason(code, f"because of {code}") for code in map(str.lower, constants.constants("Reason")))
    verdict = Verdict(reasons, (Rejected(3, reasons[-1]),), Change(7, (0.01, -0.02)), reasons[:1])
    for judged in (verdict, Verdict()):
        report = EstimateReport.of(estimate, "box", estimate.belief, verdict=judged)
        wire = serialize_message(conversions.estimate_to_msg(report))
        assert conversions.report_from_msg(deserialize_message(wire, FrictionEstimate)).to_dict() == report.to_dict()


def test_every_reason_has_its_constant():
    numbers = constants.constants("Reason")
    sources = [path.read_text() for path in CORE.rglob("*.py")]
    given = {code for text in sources for code in re.findall(r'\bReason\(\s*"(\w+)"', text)} | {code for code, *_ in LINEAR}
    assert {code.upper() for code in given} == numbers.keys()
    assert len(set(numbers.values())) == len(numbers)


def test_without_data_no_number_is_known():
    msg = conversions.nothing_known("box")
    friction = msg.contact_friction
    numbers = (msg.objective, msg.lower_bound, msg.gap, msg.confidence, msg.support_friction.total_friction, friction.p90)
    assert all(map(math.isnan, (*numbers, friction.max, friction.value, friction.low, friction.high, *msg.spread.covariance)))
    assert (friction.kind, msg.change.since_push) == (ContactFriction.KIND_UNKNOWN, ObjectChange.NO_PUSH)


def test_pushfric_core_knows_every_type_of_the_cell_as_it_is_installed():
    """Bags that pushfric_core writes are played where the types are installed."""
    used = {name for name in message_types.known_types().types if name.startswith("pushfric_msgs/msg/")}
    assert used == {f"pushfric_msgs/msg/{path.stem}" for path in constants.FOLDER.glob("*.msg")}
    others = ("geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/WrenchStamped", "std_msgs/msg/String")
    for name in (*used, *others):
        assert message_types.type_hash(name) == types.type_hash(name)
    assert constants.constants("PusherState")["NO_PUSH"] == PusherState.NO_PUSH
    assert constants.constants("PlanProgress")["PHASE_FINISHED"] == PlanProgress.PHASE_FINISHED
