"""Conversions between core types and ROS messages, without rclpy."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Point32, PoseWithCovarianceStamped, Quaternion, Vector3, Wrench, WrenchStamped
from geometry_msgs.msg import Pose as PoseMsg
from geometry_msgs.msg import Twist as TwistMsg

from pushfric_core.contact import PushingLine
from pushfric_core.contact_friction import Slip
from pushfric_core.estimate import Estimate
from pushfric_core.observation import STRONGEST, UNIT, Observation
from pushfric_core.planar import FARTHEST, Pose, Twist
from pushfric_core.prediction import FrictionModel, Predictions, Stability
from pushfric_core.push_choice import RankedPush
from pushfric_core.recognition import Ranking
from pushfric_core.region import Region
from pushfric_core.sensed_force import ForceSample
from pushfric_core.simulation import ContactMode
from pushfric_core.solvers.program import Status
from pushfric_core.surface_models import convex_quartic, ellipsoid_error, named_ellipsoid, quartic_error, surface_samples
from pushfric_core.trajectory import PoseSample, PusherSample
from pushfric_core.verdict import Verdict
from pushfric_msgs.msg import (
    CenterOfFrictionRegion,
    ContactFriction,
    FrictionCoefficient,
    FrictionEstimate,
    Hypothesis,
    LimitSurface,
    ObjectChange,
    PusherState,
    Recognition,
    RejectedPush,
    Spread,
    SupportFriction,
    TestPush,
)
from pushfric_msgs.msg import (
    Observation as ObservationMsg,
)
from pushfric_msgs.srv import PredictPush, StablePushes
from pushfric_ros.messages.frames import OBJECT, TABLE, is_frame

QUATERNION_LENGTHS = (1e-3, 1e3)
"""A quaternion should have length 1. One with a length in this range is taken for one of length 1; any other is refused."""

BIN_WIDTH = 0.05
"""Width of the bins of the histogram of lower bounds on mu_c, about that of Figures 7 and 8."""

BINS = 41
"""Number of bins; the last one counts all bounds beyond 2."""

STATUS_TO_MSG = {
    Status.OPTIMAL: FrictionEstimate.STATUS_OPTIMAL,
    Status.UNCERTIFIED: FrictionEstimate.STATUS_UNCERTIFIED,
    Status.INFEASIBLE: FrictionEstimate.STATUS_INFEASIBLE,
}

MODE_TO_MSG = {
    ContactMode.FREE: PredictPush.Response.FREE,
    ContactMode.STICKING: PredictPush.Response.STICKING,
    ContactMode.SLIDING: PredictPush.Response.SLIDING,
}

MODE_NAMES = {getattr(PusherState, name): name[5:].lower() for name in dir(PusherState) if name.startswith("MODE_")}
"""The modes of a pusher, in words."""


SLIP_TO_MSG = {
    Slip.UNKNOWN: ContactFriction.SLIP_UNKNOWN,
    Slip.STICKING: ContactFriction.SLIP_STICKING,
    Slip.LEFT: ContactFriction.SLIP_LEFT,
    Slip.RIGHT: ContactFriction.SLIP_RIGHT,
}


def stamp_to_msg(nanoseconds: int) -> Time:
    """A time [ns], since the epoch or of the simulation, as a message."""
    seconds, rest = divmod(nanoseconds, 10**9)
    return Time(sec=seconds, nanosec=rest)


def stamp_from_msg(stamp: Time) -> int:
    """The time of a message [ns]."""
    return int(stamp.sec * 10**9 + stamp.nanosec)


def pose_to_msg(pose: Pose) -> PoseMsg:
    """A planar pose as a message, at z = 0."""
    half = pose.theta / 2
    return PoseMsg(position=Point(x=pose.x, y=pose.y), orientation=Quaternion(z=math.sin(half), w=math.cos(half)))


def quaternion_length(position: Sequence[float], q: Quaternion) -> float:
    """The length of a pose's quaternion, which should be 1: whoever needs it to be divides by this.

    Raises:
        ValueError: a coordinate of the position or the quaternion is not finite, or the length is not in QUATERNION_LENGTHS.
    """
    values = (*position, q.x, q.y, q.z, q.w)
    if not all(math.isfinite(value) for value in values):
        raise ValueError(f"a pose must be finite, got {values}")
    length = math.hypot(q.x, q.y, q.z, q.w)
    if not QUATERNION_LENGTHS[0] <= length <= QUATERNION_LENGTHS[1]:
        raise ValueError(f"a pose needs a quaternion of length 1, got length {length:g}")
    return length


def pose_from_msg(msg: PoseMsg) -> Pose:
    """The planar part of a pose: its position and its rotation about z, with theta in (-pi, pi].

    Raises:
        ValueError: a value is not finite, a position is beyond FARTHEST, or the quaternion's length is far from 1.
    """
    q, at = msg.orientation, (msg.position.x, msg.position.y)
    quaternion_length(at, q)
    _check_size("a position", at, FARTHEST, "m")
    theta = math.atan2(2 * (q.w * q.z + q.x * q.y), q.w**2 + q.x**2 - q.y**2 - q.z**2)
    return Pose(msg.position.x, msg.position.y, theta)


def pose_sample_from_msg(msg: PoseWithCovarianceStamped) -> PoseSample:
    """The stamp [ns] and the planar pose in a message.

    Raises:
        ValueError: as for `pose_from_msg`.
    """
    return PoseSample(stamp_from_msg(msg.header.stamp), pose_from_msg(msg.pose.pose))


def pusher_sample_from_msg(msg: PusherState) -> PusherSample:
    """The state of a pusher; its line runs through the reported tip, and its origin is at stroke position 0.

    Raises:
        ValueError: a value is not finite, or the direction is not a unit vector.
    """
    direction = (msg.direction.x, msg.direction.y)
    numbers = (msg.position, msg.speed, msg.tip.x, msg.tip.y, *direction, msg.tip_radius)
    if not all(math.isfinite(number) for number in numbers):
        raise ValueError(f"a pusher state must be finite, got {numbers}")
    _check_size("a pusher's position, speed, tip and tip radius", numbers, FARTHEST, "m or m/s")
    if msg.tip_radius < 0:
        raise ValueError(f"a pusher's tip radius must be at least 0, got {msg.tip_radius}")
    if msg.push_id < PusherState.NO_PUSH:
        raise ValueError(f"a push id must be at least 0, got {msg.push_id}")
    if abs(math.hypot(*direction) - 1) > 1e-6:
        raise ValueError(f"the direction of the pushing line must have length 1, got {direction}")
    # rounded to a nanometre, so that the line is the same in every state, whatever the position
    origin = tuple(round(tip - msg.position * along, 9) for tip, along in zip((msg.tip.x, msg.tip.y), direction, strict=True))
    line = PushingLine((origin[0], origin[1]), direction, msg.tip_radius)
    push_id = None if msg.push_id == PusherState.NO_PUSH else msg.push_id
    return PusherSample(stamp_from_msg(msg.header.stamp), msg.position, msg.speed, line, push_id)


def force_sample_from_msg(msg: WrenchStamped) -> ForceSample:
    """The planar part of the pusher's force on the object.

    Raises:
        ValueError: the force is not finite, or not in the table frame.
    """
    if not is_frame(msg.header.frame_id, TABLE):
        raise ValueError(f"a wrench must have frame_id {TABLE!r}, got {msg.header.frame_id!r}")
    force = (msg.wrench.force.x, msg.wrench.force.y)
    if not all(math.isfinite(component) for component in force):
        raise ValueError(f"a wrench must be finite, got a force of {force}")
    _check_size("a force", force, STRONGEST, "N")
    return ForceSample(stamp_from_msg(msg.header.stamp), force)


def observation_to_msg(observation: Observation, object_name: str) -> ObservationMsg:
    """A data point as a message for the topic `observation`."""
    msg = ObservationMsg(object=object_name, push_id=observation.push_id)
    msg.header.stamp, msg.header.frame_id = stamp_to_msg(observation.stamp), OBJECT
    msg.contact_point = _point(observation.contact_point)
    msg.contact_normal = _vector(observation.contact_normal)
    msg.half_width, msg.duration = observation.half_width, observation.duration
    msg.twist.linear.x, msg.twist.linear.y, msg.twist.angular.z = observation.twist
    if observation.pose is not None:
        msg.pose = [pose_to_msg(observation.pose)]
    if observation.force is not None:
        msg.force = [_vector(observation.force)]
    if observation.tip_velocity is not None:
        msg.tip_velocity = [_vector(observation.tip_velocity)]
    if observation.depth is not None:
        msg.depth = observation.depth
    return msg


def observation_from_msg(msg: ObservationMsg) -> Observation:
    """A data point; bags from before tip_velocity and depth were recorded have no such fields.

    Raises:
        ValueError, UninformativePush: the message is not a data point, as for `Observation`.
    """
    tip_velocity = getattr(msg, "tip_velocity", None)
    return Observation(
        contact_point=(msg.contact_point.x, msg.contact_point.y),
        contact_normal=(msg.contact_normal.x, msg.contact_normal.y),
        twist=Twist(msg.twist.linear.x, msg.twist.linear.y, msg.twist.angular.z),
        push_id=msg.push_id,
        half_width=msg.half_width,
        duration=msg.duration,
        stamp=stamp_from_msg(msg.header.stamp),
        pose=pose_from_msg(msg.pose[0]) if msg.pose else None,
        force=(msg.force[0].x, msg.force[0].y) if msg.force else None,
        tip_velocity=(tip_velocity[0].x, tip_velocity[0].y) if tip_velocity else None,
        depth=getattr(msg, "depth", 0.0) or None,
    )


def histogram(lower_bounds: npt.ArrayLike) -> np.ndarray:
    """Number of lower bounds on mu_c (m,) in each bin: (BINS,)."""
    bins = np.minimum(np.asarray(lower_bounds, dtype=float) / BIN_WIDTH, BINS - 1)
    return np.bincount(bins.astype(int), minlength=BINS)


class FrictionParts(NamedTuple):
    """The parts of a message about mu_c, which take every data point into account."""

    data_points: int
    bounds: ContactFriction
    coefficient: list[FrictionCoefficient]


def friction_to_msg(estimate: Estimate, object_name: str, slipping: Sequence[bool] = ()) -> FrictionParts:
    """The parts of an estimate about mu_c; O(M) for M data points. For the arguments see `estimate_to_msg`."""
    bounds = ContactFriction(
        object=object_name,
        p90=estimate.mu_c_p90,
        max=estimate.mu_c_max,
        bin_width=BIN_WIDTH,
        histogram=histogram(estimate.contact_friction).tolist(),
    )
    if any(slipping):
        slid = estimate.contact_friction[np.asarray(slipping)]
        bounds.slipping = [slid.min(), slid.max()]
    if estimate.tip is not None:
        slips = estimate.tip.slips
        bounds.slips = [slips.count(state) for state in Slip]
        bounds.slip = [SLIP_TO_MSG[slips[-1]]] if slips else []
    coefficient = []
    if (mu_c := estimate.mu_c) is not None:
        value = math.nan if mu_c.value is None else mu_c.value
        coefficient = [FrictionCoefficient(value=value, low=mu_c.low, high=mu_c.high, kind=mu_c.kind.value)]
    return FrictionParts(estimate.data_points, bounds, coefficient)


def estimate_to_msg(
    estimate: Estimate,
    object_name: str,
    slipping: Sequence[bool] = (),
    verdict: Verdict | None = None,
    friction: FrictionParts | None = None,
) -> FrictionEstimate:
    """An estimate as a message.

    Args:
        estimate: from at least one data point.
        object_name: name of the object.
        slipping: for each data point, whether its contact is known to have slipped; empty: for none.
        verdict: on its input; None: not judged.
        friction: what is said of mu_c; None: what this estimate says.
    """
    friction = friction or friction_to_msg(estimate, object_name, slipping)
    msg = FrictionEstimate(object=object_name)
    msg.header.stamp, msg.header.frame_id = stamp_to_msg(estimate.stamp), OBJECT
    msg.status = STATUS_TO_MSG[estimate.status]
    msg.data_points, msg.pushes = estimate.data_points, estimate.pushes
    points = [_point(point) for point in estimate.support_points]
    msg.support_friction = SupportFriction(header=msg.header, object=object_name, support_points=points, weights=estimate.w)
    if estimate.total_friction is not None:
        msg.support_friction.total_friction = [estimate.total_friction]
    msg.center_of_friction = _point(estimate.center_of_friction)
    msg.contact_friction, msg.mu_c = friction.bounds, friction.coefficient
    if friction.data_points == estimate.data_points:
        friction.bounds.header = msg.header  # one for all parts, so that whoever publishes them puts its prefix there once
    msg.objective, msg.lower_bound, msg.gap = estimate.solution.objective, estimate.solution.lower_bound, estimate.solution.gap
    if estimate.confidence is not None:
        msg.confidence = [estimate.confidence]
    if estimate.spread is not None:
        spread = estimate.spread
        low, high = spread.intervals.T
        msg.spread = [Spread(covariance=spread.covariance.ravel(), middle=spread.middle, low=low, high=high)]
    if verdict is not None:
        msg.reasons, msg.notes = list(verdict.reasons), list(verdict.notes)
        msg.rejected = [RejectedPush(push_id=one.push_id, reason=one.reason) for one in verdict.rejected]
        if verdict.change is not None:
            msg.change = [ObjectChange(since_push=verdict.change.since, shift=_vector(verdict.change.shift))]
    return msg


def nothing_known(object_name: str) -> FrictionEstimate:
    """The message while there is no estimate: no weights, and NaN for every number."""
    msg = FrictionEstimate(object=object_name, status=FrictionEstimate.STATUS_NO_DATA)
    msg.header.frame_id = OBJECT
    msg.support_friction = SupportFriction(header=msg.header, object=object_name)
    msg.center_of_friction = _point((math.nan, math.nan))
    msg.contact_friction = ContactFriction(header=msg.header, object=object_name, p90=math.nan, max=math.nan)
    return msg


def recognition_to_msg(ranking: Ranking) -> Recognition:
    """A ranking, from at least one data point, as a message."""
    msg = Recognition(best=ranking.best or "")
    msg.header.stamp, msg.header.frame_id = stamp_to_msg(ranking.stamp), OBJECT
    msg.hypotheses = [
        Hypothesis(name=ranked.name, fit_error=ranked.fit_error, ratio=ranked.ratio, feasible=ranked.feasible)
        for ranked in ranking.hypotheses
    ]
    return msg


def region_to_msg(region: Region, next_pushes: Sequence[RankedPush], stamp: int, object_name: str) -> CenterOfFrictionRegion:
    """The region in which p_CF can lie, as a message.

    Args:
        region: after some data points, or before the first one.
        next_pushes: pushes that shrink it, best first; empty once it has collapsed.
        stamp: of the newest data point [ns]; 0 before the first one.
        object_name: name of the object.
    """
    msg = CenterOfFrictionRegion(object=object_name, area=region.area, collapsed=region.collapsed, violation=region.violation)
    msg.header.stamp, msg.header.frame_id = stamp_to_msg(stamp), OBJECT
    msg.polygon.header = msg.header
    msg.polygon.polygon.points = [Point32(x=float(x), y=float(y)) for x, y in region.corners]
    msg.center_of_friction = _point(region.center)
    msg.next_pushes = [TestPush(expected_area=area, **push._asdict()) for push, area in next_pushes]
    return msg


def pushes_from_msg(request: PredictPush.Request) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Contact points, normals and tip velocities (k, 2) each.

    Raises:
        ValueError: their numbers differ, there are none, or a normal is not unit.
    """
    parts = _planar(request.contact_points), _normals(request.contact_normals), _planar(request.tip_velocities)
    _as_many("contact_points, contact_normals and tip_velocities", *parts)
    return parts


def predictions_to_msg(predictions: Predictions, response: PredictPush.Response) -> PredictPush.Response:
    """The predicted motions of pushes, as the answer to a request."""
    response.success = True
    response.twists = [_twist(twist) for twist in predictions.twists]
    response.modes = [MODE_TO_MSG[mode] for mode in predictions.modes]
    response.spreads = predictions.spread.tolist()
    response.forces = [_vector(force) for force in predictions.forces]
    return response


def turns_from_msg(
    request: StablePushes.Request,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Contact points (k, 2), normals (k, 2), half-widths (k,), centres of rotation (k, 2) and turns (k,).

    Raises:
        ValueError: their numbers differ, there are none, or a normal is not unit.
    """
    points, normals = _planar(request.contact_points), _normals(request.contact_normals)
    half_widths, turns = _bounded(np.array(request.half_widths)), _bounded(np.array(request.turns, dtype=float))
    centers = _planar(request.centers_of_rotation)
    names = "contact_points, contact_normals, half_widths, centers_of_rotation and turns"
    _as_many(names, points, normals, half_widths, centers, turns)
    return points, normals, half_widths, centers, turns


def stability_to_msg(stability: Stability, response: StablePushes.Response) -> StablePushes.Response:
    """Which pushes hold the object, as the answer to a request."""
    response.success = True
    response.stable, response.margins = stability.stable.tolist(), stability.margins.tolist()
    response.probabilities = stability.probabilities.tolist()
    return response


def limit_surface_to_msg(estimate: Estimate, model: FrictionModel, object_name: str) -> LimitSurface:
    """The limit surface of an estimate in the forms that planners use.

    Raises:
        ValueError: a single point bears all the weight: its surface encloses no volume.
    """
    msg = LimitSurface(object=object_name, contact_friction=model.mean_mu_c)
    msg.header.stamp, msg.header.frame_id = stamp_to_msg(estimate.stamp), OBJECT
    if estimate.total_friction is not None:
        msg.total_friction = [estimate.total_friction]
    ellipsoid, quartic = named_ellipsoid(model.support), convex_quartic(model.support)
    msg.f_max, msg.m_max, msg.center = ellipsoid.f_max, ellipsoid.m_max, _point(ellipsoid.center)
    msg.ellipsoid_load_error, msg.ellipsoid_twist_error = ellipsoid_error(ellipsoid.form(), model.support)
    msg.quartic = quartic.coefficients
    msg.quartic_load_error, msg.quartic_twist_error = quartic_error(quartic, model.support)
    wrenches, twists = surface_samples(model.support)
    msg.wrenches = [Wrench(force=_vector(row[:2]), torque=Vector3(z=float(row[2]))) for row in wrenches]
    msg.twists = [_twist(row) for row in twists]
    return msg


def _planar(vectors: Sequence[Point] | Sequence[Vector3]) -> np.ndarray:
    return _bounded(np.array([(vector.x, vector.y) for vector in vectors]).reshape(-1, 2))


def _bounded(values: np.ndarray) -> np.ndarray:
    if not (np.abs(values) <= FARTHEST).all():  # nor is a NaN
        raise ValueError(f"positions, lengths, angles and speeds must be finite and lie within {FARTHEST:g}")
    return values


def _normals(vectors: Sequence[Vector3]) -> np.ndarray:
    normals = _planar(vectors)
    lengths = np.linalg.norm(normals, axis=1)
    wrong = ~(np.abs(lengths - 1) <= UNIT)
    if wrong.any():
        raise ValueError(f"contact_normals must have length 1, got {lengths[wrong][0]:g}")
    return normals


def _as_many(names: str, *arrays: np.ndarray) -> None:
    counts = [len(array) for array in arrays]
    if len(set(counts)) > 1 or not counts[0]:
        raise ValueError(f"{names} must have the same length, at least 1, got {', '.join(map(str, counts))}")


def _twist(row: np.ndarray) -> TwistMsg:
    return TwistMsg(linear=_vector(row[:2]), angular=Vector3(z=float(row[2])))


def _check_size(what: str, values: Sequence[float], limit: float, unit: str) -> None:
    if max(map(abs, values)) > limit:
        raise ValueError(f"{what} must lie within {limit:g} {unit}, got {tuple(map(float, values))}")


def _point(xy: tuple[float, float] | np.ndarray) -> Point:
    return Point(x=float(xy[0]), y=float(xy[1]))


def _vector(xy: tuple[float, float] | np.ndarray) -> Vector3:
    return Vector3(x=float(xy[0]), y=float(xy[1]))
