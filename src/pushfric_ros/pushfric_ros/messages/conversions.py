"""Conversions between core types and ROS messages, without rclpy."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Point32, Vector3, Wrench
from geometry_msgs.msg import Pose as PoseMsg
from geometry_msgs.msg import Twist as TwistMsg
from std_msgs.msg import Header

from pushfric_core.bags import samples
from pushfric_core.bags.samples import stamp_from_msg
from pushfric_core.belief.doubts import Change, Rejected
from pushfric_core.estimation.estimate import Estimate
from pushfric_core.estimation.estimate_report import BIN_WIDTH, EstimateReport, FrictionReport, SpreadReport
from pushfric_core.estimation.push_choice import RankedPush
from pushfric_core.estimation.push_plan import PlannedPush
from pushfric_core.estimation.recognition import Ranking
from pushfric_core.estimation.region import Region
from pushfric_core.estimation.verdict import Verdict
from pushfric_core.geometry.contact import PushingLine
from pushfric_core.geometry.frames import OBJECT
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Pose
from pushfric_core.mechanics.prediction import FrictionModel, Kind, MotionCone, MuC, Predictions, Stability
from pushfric_core.mechanics.simulation import ContactMode
from pushfric_core.mechanics.strokes import Strokes
from pushfric_core.mechanics.surface_models import (
    convex_quartic,
    ellipsoid_error,
    named_ellipsoid,
    quartic_error,
    surface_samples,
)
from pushfric_core.plausible import FARTHEST, FARTHEST_TURN_CENTER, FASTEST, LARGEST, check_within
from pushfric_core.program.contact_friction import Slip
from pushfric_core.reasons import Reason, ReasonCode
from pushfric_core.solvers.program import Status
from pushfric_core.trajectories.observation import UNIT, Observation
from pushfric_msgs.msg import (
    Basis,
    CenterOfFrictionRegion,
    ContactFriction,
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
    FrictionModel as FrictionModelMsg,
)
from pushfric_msgs.msg import (
    Observation as ObservationMsg,
)
from pushfric_msgs.msg import (
    Reason as ReasonMsg,
)
from pushfric_msgs.srv import MotionCone as MotionConeSrv
from pushfric_msgs.srv import PredictPush, PredictStroke, StablePushes
from pushfric_ros.messages.types import message_class

STATUS_TO_MSG = {
    Status.OPTIMAL: FrictionEstimate.STATUS_OPTIMAL,
    Status.UNCERTIFIED: FrictionEstimate.STATUS_UNCERTIFIED,
    Status.INFEASIBLE: FrictionEstimate.STATUS_INFEASIBLE,
}

STATUS_FROM_MSG = {number: status for status, number in STATUS_TO_MSG.items()}

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


KIND_TO_MSG = {
    None: ContactFriction.KIND_UNKNOWN,
    Kind.BOUND: ContactFriction.KIND_BOUND,
    Kind.SLIP: ContactFriction.KIND_SLIP,
    Kind.FORCE: ContactFriction.KIND_FORCE,
}

KIND_FROM_MSG = {number: kind for kind, number in KIND_TO_MSG.items()}

CODE_FROM_MSG = {getattr(ReasonMsg, code.name): code for code in ReasonCode}

MODEL_TOPIC = "friction_model"
"""Topic of the friction model that planner nodes need."""

NOWHERE = (math.nan, math.nan)

SLIP_FROM_MSG = {number: slip for slip, number in SLIP_TO_MSG.items()}


def pose_to_msg(pose: Pose) -> PoseMsg:
    """A planar pose as a message, at z = 0."""
    return samples.pose_to_msg(pose, _new)


def observation_to_msg(observation: Observation, object_name: str) -> ObservationMsg:
    """An observation as a message for the topic `observation`."""
    return samples.observation_to_msg(observation, object_name, _new)


def stamp_to_msg(nanoseconds: int) -> Time:
    """A time [ns], since the epoch or of the simulation, as a message."""
    seconds, rest = divmod(nanoseconds, 10**9)
    return Time(sec=seconds, nanosec=rest)


def estimate_to_msg(report: EstimateReport) -> FrictionEstimate:
    """The report on an estimate as a message."""
    msg = FrictionEstimate(object=report.object_name)
    msg.header.stamp, msg.header.frame_id = stamp_to_msg(report.stamp), OBJECT
    msg.status = STATUS_TO_MSG[report.status]
    msg.data_points, msg.pushes = report.data_points, report.pushes
    points = [_point(point) for point in report.support_points]
    msg.support_friction = SupportFriction(
        header=msg.header,
        object=report.object_name,
        support_points=points,
        weights=report.w,
        total_friction=_number(report.total_friction),
    )
    msg.center_of_friction = _point(report.center_of_friction)
    msg.objective, msg.lower_bound, msg.gap = report.objective, report.lower_bound, report.gap
    msg.confidence, msg.change = _number(report.confidence), _change(report.change)
    msg.spread = _spread(report.spread, report.support_points, report.believed)
    msg.reasons, msg.notes = _reasons(report.reasons), _reasons(report.notes)
    msg.rejected = [RejectedPush(push_id=one.push_id, reason=_reason(one.reason)) for one in report.rejected]
    friction, mu_c = report.friction, report.friction.mu_c
    kind, value, low, high = 4 * (None,) if mu_c is None else (mu_c.kind, mu_c.value, mu_c.low, mu_c.high)
    msg.contact_friction = ContactFriction(
        header=msg.header if friction.data_points == report.believed == report.data_points else Header(),
        object=report.object_name,
        kind=KIND_TO_MSG[kind],
        value=_number(value),
        low=_number(low),
        high=_number(high),
        p90=friction.p90,
        max=friction.most,
        bin_width=BIN_WIDTH,
        histogram=friction.counts,
        slipping=friction.slipping or (),
        slips=friction.slips,
        slip=SLIP_TO_MSG[friction.slip],
    )
    return msg


def report_from_msg(msg: FrictionEstimate) -> EstimateReport:
    """The report in a message that has observations."""
    support, friction, spread = msg.support_friction, msg.contact_friction, msg.spread
    kind = KIND_FROM_MSG[friction.kind]
    return EstimateReport(
        object_name=msg.object,
        stamp=stamp_from_msg(msg.header.stamp),
        status=STATUS_FROM_MSG[msg.status],
        data_points=msg.data_points,
        pushes=msg.pushes,
        support_points=np.array([(point.x, point.y) for point in support.support_points]),
        w=np.array(support.weights),
        center_of_friction=np.array((msg.center_of_friction.x, msg.center_of_friction.y)),
        objective=msg.objective,
        lower_bound=msg.lower_bound,
        gap=msg.gap,
        total_friction=_known(support.total_friction),
        friction=FrictionReport(
            sum(friction.histogram),
            friction.p90,
            friction.max,
            list(friction.histogram),
            (friction.slipping[0], friction.slipping[1]) if len(friction.slipping) else None,
            list(friction.slips),
            SLIP_FROM_MSG[friction.slip],
            None if kind is None else MuC(_known(friction.value), friction.low, friction.high, kind),
        ),
        believed=spread.data_points,
        spread=SpreadReport(
            np.array(spread.covariance).reshape(2, 2), np.array(spread.middle), np.column_stack((spread.low, spread.high))
        )
        if len(spread.middle)
        else None,
        confidence=_known(msg.confidence),
        reasons=[_reason_from(one) for one in msg.reasons],
        notes=[_reason_from(one) for one in msg.notes],
        rejected=[Rejected(one.push_id, _reason_from(one.reason)) for one in msg.rejected],
        change=None
        if msg.change.since_push == ObjectChange.NO_PUSH
        else Change(msg.change.since_push, (msg.change.shift.x, msg.change.shift.y)),
    )


def nothing_known(object_name: str) -> FrictionEstimate:
    """The message while there is no estimate: no weights, and NaN for every number."""
    msg = FrictionEstimate(object=object_name, status=FrictionEstimate.STATUS_NO_DATA)
    msg.header.frame_id = OBJECT
    msg.support_friction = SupportFriction(header=msg.header, object=object_name, total_friction=math.nan)
    msg.center_of_friction = _point(NOWHERE)
    mu_c = dict.fromkeys(("value", "low", "high", "p90", "max"), math.nan)
    msg.contact_friction = ContactFriction(header=msg.header, object=object_name, **mu_c)
    msg.objective = msg.lower_bound = msg.gap = msg.confidence = math.nan
    msg.spread, msg.change = _spread(None, np.empty((0, 2)), 0), _change(None)
    return msg


def recognition_to_msg(ranking: Ranking) -> Recognition:
    """A ranking, from at least one observation, as a message."""
    msg = Recognition(best=ranking.best or "")
    msg.header.stamp, msg.header.frame_id = stamp_to_msg(ranking.stamp), OBJECT
    msg.hypotheses = [
        Hypothesis(name=ranked.name, fit_error=ranked.fit_error, ratio=ranked.ratio, feasible=ranked.feasible)
        for ranked in ranking.hypotheses
    ]
    return msg


def region_to_msg(
    region: Region, next_pushes: Sequence[RankedPush], slip_pushes: Sequence[PlannedPush], stamp: int, object_name: str
) -> CenterOfFrictionRegion:
    """The region in which p_CF can lie, as a message.

    Args:
        region: after some observations, or before the first one.
        next_pushes: pushes that shrink it, best first; empty once it has collapsed.
        slip_pushes: pushes that slip, best first.
        stamp: of the newest observation [ns]; 0 before the first one.
        object_name: name of the object.
    """
    msg = CenterOfFrictionRegion(object=object_name, area=region.area, collapsed=region.collapsed, violation=region.violation)
    msg.header.stamp, msg.header.frame_id = stamp_to_msg(stamp), OBJECT
    msg.polygon.header = msg.header
    msg.polygon.polygon.points = [Point32(x=float(x), y=float(y)) for x, y in region.corners]
    msg.center_of_friction = _point(region.center)
    msg.next_pushes = [TestPush(expected_area=area, **push._asdict()) for push, area in next_pushes]
    msg.slip_pushes = [TestPush(expected_area=region.area, **push._asdict()) for push in slip_pushes]
    return msg


def friction_model_to_msg(
    object_name: str, outline: Outline, estimate: Estimate | None, model: FrictionModel | None, verdict: Verdict
) -> FrictionModelMsg:
    """A friction model, as a message.

    Args:
        object_name: name of the object.
        outline: of the object.
        estimate: the present one; None: there is none.
        model: made from it; None: none can be made.
        verdict: on the estimate.
    """
    basis = Basis(object=object_name, has_model=model is not None)
    basis.header.frame_id = OBJECT
    msg = FrictionModelMsg(basis=basis, outline=[_point(corner) for corner in outline.vertices])
    msg.misfit = msg.stroke_misfit = msg.total_friction = math.nan
    msg.center_of_friction, msg.covariance = _point(NOWHERE), np.full(4, math.nan)
    if estimate is None:
        return msg
    basis.header.stamp = stamp_to_msg(estimate.stamp)
    basis.data_points, basis.pushes = estimate.data_points, estimate.pushes
    basis.reasons, basis.notes = _reasons(verdict.reasons), _reasons(verdict.notes)
    if model is not None:
        msg.support_points = [_point(point) for point in model.support_points]
        msg.w, msg.mu_c, msg.weights = model.w.ravel(), model.mu_c, model.share
        msg.misfit, msg.stroke_misfit = model.misfit, model.stroke_misfit
        msg.center_of_friction, msg.total_friction = _point(model.center_of_friction), _number(estimate.total_friction)
        if model.covariance is not None:
            msg.covariance = model.covariance.ravel()
    return msg


def friction_model_from_msg(msg: FrictionModelMsg) -> tuple[FrictionModel, Outline]:
    """The model in a message that has one, and the outline of its object.

    Raises:
        ValueError: the numbers make no sense.
    """
    w, mu_c = np.array(msg.w), np.array(msg.mu_c)
    points = np.array([(point.x, point.y) for point in msg.support_points]).reshape(-1, 2)
    if len(w) != len(points) * len(mu_c):
        raise ValueError(f"w must have {len(mu_c)} x {len(points)} numbers, got {len(w)}")
    covariance = np.array(msg.covariance).reshape(2, 2)
    known = covariance if np.isfinite(covariance).all() else None
    model = FrictionModel(points, w.reshape(-1, len(points)), mu_c, np.array(msg.weights), msg.misfit, msg.stroke_misfit, known)
    return model, Outline(np.array([(corner.x, corner.y) for corner in msg.outline]))


def pushes_from_msg(request: PredictPush.Request) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Contact points, normals and tip velocities (k, 2) each.

    Raises:
        ValueError: their numbers differ, there are none, or a normal is not unit.
    """
    velocities = _planar(request.tip_velocities, "tip_velocities", FASTEST, "m/s")
    parts = _planar(request.contact_points), _units("contact_normals", request.contact_normals), velocities
    _as_many("contact_points, contact_normals and tip_velocities", *parts)
    return parts


def add_predictions(predictions: Predictions, response: PredictPush.Response, with_samples: bool) -> None:
    """Add predicted motions of pushes to an answer."""
    response.twists.extend(predictions.twists.ravel().tolist())
    response.modes.extend(MODE_TO_MSG[mode] for mode in predictions.modes)
    response.spreads.extend(predictions.spread.tolist())
    response.forces.extend(predictions.forces.ravel().tolist())
    response.covariances.extend(predictions.covariance.ravel().tolist())
    if with_samples:
        response.sample_twists.extend(predictions.samples.twists.ravel().tolist())


def strokes_from_msg(request: PredictStroke.Request) -> tuple[list[Pose], list[PushingLine], np.ndarray]:
    """Poses before the strokes, the lines of the tip, and where it stops (k,) [m].

    Raises:
        ValueError: their numbers differ, there are none, a direction is not unit, or a number makes no sense.
    """
    starts = _rows("starts", request.starts, 3)
    _within("starts", starts, FARTHEST, "m")
    origins, directions = _planar(request.origins, "origins"), _units("directions", request.directions)
    radii, positions = np.array(request.tip_radii, dtype=float), np.array(request.positions, dtype=float)
    _within("positions", positions[:, None], FARTHEST, "m")
    _within("tip_radii", radii[:, None], LARGEST, "m")
    if not (radii >= 0).all():
        raise ValueError(f"tip_radii must be at least 0, got {radii.min():g}")
    _as_many("starts, origins, directions, tip_radii and positions", starts, origins, directions, radii, positions)
    lines = [
        PushingLine(*line)
        for line in zip(map(tuple, origins.tolist()), map(tuple, directions.tolist()), radii.tolist(), strict=True)
    ]
    return [Pose(*start) for start in starts.tolist()], lines, positions


def add_strokes(strokes: Strokes, response: PredictStroke.Response, with_samples: bool) -> None:
    """Add the ends of strokes to an answer."""
    response.ends.extend(strokes.means.ravel().tolist())
    response.covariances.extend(strokes.covariance.ravel().tolist())
    if with_samples:
        response.sample_ends.extend(strokes.poses.ravel().tolist())


def contacts_from_msg(request: MotionConeSrv.Request) -> tuple[np.ndarray, np.ndarray]:
    """Contact points and normals (k, 2) each. Raises ValueError as `pushes_from_msg`."""
    parts = _planar(request.contact_points), _units("contact_normals", request.contact_normals)
    _as_many("contact_points and contact_normals", *parts)
    return parts


def add_cones(cones: MotionCone, response: MotionConeSrv.Response) -> None:
    """Add motion cones to an answer."""
    response.right.extend(cones.right.ravel().tolist())
    response.left.extend(cones.left.ravel().tolist())


def turns_from_msg(
    request: StablePushes.Request,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Contact points (k, 2), normals (k, 2), half-widths (k,), centres of rotation (k, 2) and turns (k,).

    Raises:
        ValueError: their numbers differ, there are none, or a normal is not unit.
    """
    points, normals = _planar(request.contact_points), _units("contact_normals", request.contact_normals)
    half_widths, turns = np.array(request.half_widths, dtype=float), np.array(request.turns, dtype=float)
    centers = _planar(request.centers_of_rotation, "centers_of_rotation", FARTHEST_TURN_CENTER)
    names = "contact_points, contact_normals, half_widths, centers_of_rotation and turns"
    _as_many(names, points, normals, half_widths, centers, turns)
    return points, normals, half_widths, centers, turns


def add_stability(stability: Stability, response: StablePushes.Response) -> None:
    """Add to an answer which pushes hold the object."""
    response.stable.extend(stability.stable.tolist())
    response.margins.extend(stability.margins.tolist())
    response.probabilities.extend(stability.probabilities.tolist())


def limit_surface_to_msg(basis: Basis, total_friction: float, model: FrictionModel) -> LimitSurface:
    """The limit surface of a model in the forms that planners use.

    Args:
        basis: what the model rests on.
        total_friction: support friction of the translating object [N]; NaN: not known.
        model: of the object.
    Raises:
        ValueError: a single point bears all the weight: its surface encloses no volume.
    """
    msg = LimitSurface(header=basis.header, object=basis.object)
    msg.contact_friction, msg.total_friction = model.mean_mu_c, total_friction
    ellipsoid, quartic = named_ellipsoid(model.support), convex_quartic(model.support)
    msg.f_max, msg.m_max, msg.center = ellipsoid.f_max, ellipsoid.m_max, _point(ellipsoid.center)
    msg.ellipsoid_load_error, msg.ellipsoid_twist_error = ellipsoid_error(ellipsoid.form(), model.support)
    msg.quartic = quartic.coefficients
    msg.quartic_load_error, msg.quartic_twist_error = quartic_error(quartic, model.support)
    wrenches, twists = surface_samples(model.support)
    msg.wrenches = [Wrench(force=_vector(row[:2]), torque=Vector3(z=row[2])) for row in wrenches.tolist()]
    msg.twists = [_twist(row) for row in twists.tolist()]
    return msg


def _planar(numbers: Sequence[float], what: str = "contact_points", most: float = FARTHEST, unit: str = "m") -> np.ndarray:
    found = _rows(what, numbers, 2)
    _within(what, found, most, unit)
    return found


def _rows(what: str, numbers: Sequence[float], width: int) -> np.ndarray:
    if len(numbers) % width:
        raise ValueError(f"{what} must have {width} numbers each, got {len(numbers)} in all")
    return np.array(numbers, dtype=float).reshape(-1, width)


def _within(what: str, rows: np.ndarray, most: float, unit: str) -> None:
    if not (np.abs(rows) <= most).all():
        for row in rows.tolist():
            check_within(what, row, most, unit)


def _units(what: str, numbers: Sequence[float]) -> np.ndarray:
    found = _planar(numbers, what)
    lengths = np.linalg.norm(found, axis=1)
    wrong = ~(np.abs(lengths - 1) <= UNIT)
    if wrong.any():
        raise ValueError(f"{what} must have length 1, got {lengths[wrong][0]:g}")
    return found


def _as_many(names: str, *arrays: np.ndarray) -> None:
    counts = [len(array) for array in arrays]
    if len(set(counts)) > 1 or not counts[0]:
        raise ValueError(f"{names} must have the same length, at least 1, got {', '.join(map(str, counts))}")


def _twist(row: Sequence[float]) -> TwistMsg:
    twist = TwistMsg()  # as with arguments, in half the time
    twist.linear.x, twist.linear.y, twist.angular.z = row
    return twist


def _point(xy: Sequence[float] | np.ndarray) -> Point:
    return Point(x=float(xy[0]), y=float(xy[1]))


def _vector(xy: Sequence[float] | np.ndarray) -> Vector3:
    return Vector3(x=float(xy[0]), y=float(xy[1]))


def _new(type_name: str, **fields: Any) -> Any:
    return message_class(type_name)(**fields)


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _known(number: float) -> float | None:
    return None if math.isnan(number) else number


def _spread(spread: SpreadReport | None, points: np.ndarray, believed: int) -> Spread:
    if spread is None:
        return Spread(covariance=np.full(4, math.nan), center_of_friction=_point(NOWHERE), data_points=believed)
    low, high = spread.intervals.T
    return Spread(
        center_of_friction=_point(spread.middle @ points),
        covariance=spread.covariance.ravel(),
        middle=spread.middle,
        low=low,
        high=high,
        data_points=believed,
    )


def _change(change: Change | None) -> ObjectChange:
    since, shift = (ObjectChange.NO_PUSH, NOWHERE) if change is None else change
    return ObjectChange(since_push=since, shift=_vector(shift))


def _reason(reason: Reason) -> ReasonMsg:
    return ReasonMsg(code=getattr(ReasonMsg, reason.code.name), text=reason.text)


def _reasons(reasons: Sequence[Reason]) -> list[ReasonMsg]:
    return [_reason(one) for one in reasons]


def _reason_from(msg: ReasonMsg) -> Reason:
    return Reason(CODE_FROM_MSG[msg.code], msg.text)
