"""Conversions between core types and ROS messages, without rclpy.

Most are field by field: by the record's annotations (pushfric_core.records) and the message's fields. What is None in a record
is NaN in a message; where no number can be, it is what the message has by itself. A word, also that of an enum, is the constant
of that name.
"""

import array
import functools
import math
import operator
from collections.abc import Callable, Sequence
from enum import Enum
from typing import Any, NamedTuple, get_args, get_origin

import numpy as np
import numpy.typing as npt
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Point32, Vector3, Wrench
from geometry_msgs.msg import Pose as PoseMsg
from geometry_msgs.msg import Twist as TwistMsg
from std_msgs.msg import Header

from pushfric_core.bags import samples
from pushfric_core.bags.samples import stamp_from_msg
from pushfric_core.estimation.estimate import Estimate
from pushfric_core.estimation.estimate_report import BIN_WIDTH, EstimateReport, VerdictReport
from pushfric_core.estimation.push_choice import RankedPush
from pushfric_core.estimation.push_plan import PlannedPush
from pushfric_core.estimation.recognition import Ranking
from pushfric_core.estimation.region import Region
from pushfric_core.estimation.verdict import Verdict
from pushfric_core.geometry.contact import PushingLine
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import CAMERA, OBJECT, Pose, check_unit
from pushfric_core.mechanics.limit_surface import ellipsoid_error, named_ellipsoid, surface_samples
from pushfric_core.mechanics.prediction import FrictionModel
from pushfric_core.mechanics.quasi_static import ContactMode
from pushfric_core.plausible import FARTHEST, FARTHEST_TURN_CENTER, FASTEST, LARGEST, check_within
from pushfric_core.records import fields_of, is_record
from pushfric_core.trajectories.observation import Observation
from pushfric_msgs.msg import (
    Basis,
    CenterOfFrictionRegion,
    FrictionEstimate,
    Hypothesis,
    LimitSurface,
    PusherState,
    Recognition,
    TestPush,
)
from pushfric_msgs.msg import FrictionModel as FrictionModelMsg
from pushfric_msgs.msg import Observation as ObservationMsg
from pushfric_msgs.srv import PredictPush, PredictStroke
from pushfric_ros.messages.types import message_class


class _Part(NamedTuple):
    """A field of a record, in a message."""

    name: str
    holder: Callable[[Any], Any]  # gives the part of the message that has it
    names: tuple[str, ...]  # there: of its columns, if it has some
    kind: Any  # class of the value, or of each of several records
    is_record: bool  # it is one
    needed: bool  # it cannot be None


@functools.cache
def _parts(record: type) -> tuple[_Part, ...]:
    found = []
    for field in fields_of(record):
        path = field.name if field.place.message is None else field.place.message
        holders, names = zip(*(one.rpartition(".")[::2] for one in path.split()), strict=True) if path else (("",), ())
        kind, *none = [one for one in get_args(field.hint) if type(None) in get_args(field.hint)] or [field.hint]
        many = get_origin(kind) is tuple and get_args(kind)[-1] is Ellipsis
        holder = operator.attrgetter(holders[0]) if holders[0] else lambda msg: msg
        if names or is_record(kind):
            found.append(_Part(field.name, holder, names, get_args(kind)[0] if many else kind, is_record(kind), not none))
    return tuple(found)


@functools.cache
def _numbers(message: type, name: str) -> dict[str, int]:
    """The constants of a message, without the field's name in front of theirs."""
    prefix = f"{name.upper()}_"
    return {one.removeprefix(prefix).lower(): getattr(message, one) for one in dir(message) if one.isupper()}


def _word(value: str | Enum) -> str:
    """The word of a constant."""
    return value.name.lower() if isinstance(value, Enum) else value


@functools.cache
def _element(message: type[Any], name: str) -> type[Any]:
    """The class of the messages in a field."""
    package, element = message.get_fields_and_field_types()[name].removeprefix("sequence<").rstrip(">").split("/")
    return message_class(f"{package}/msg/{element}")


def write(value: Any, record: type, msg: Any) -> None:
    """Set the fields of a message.

    Args:
        value: the record; None: nothing is known.
        record: its class.
        msg: as it is made, or a part of it.
    """
    for part in _parts(record):
        one, holder = getattr(value, part.name, None), part.holder(msg)
        if part.is_record:
            write(one, part.kind, getattr(holder, part.names[0]) if part.names else holder)
        elif len(part.names) == 1:
            _set(holder, part.names[0], one, part.kind)
        else:
            columns = part.names if one is None else np.asarray(one).T
            for name, column in zip(part.names, columns, strict=True):
                _set(holder, name, None if one is None else column, part.kind)


def _set(msg: Any, name: str, value: Any, kind: Any) -> None:
    message: Any = type(msg)
    there = getattr(msg, name)
    if type(value) is type(there) is not np.ndarray:
        setattr(msg, name, value)
    elif hasattr(there, "x"):
        there.x, there.y = (math.nan, math.nan) if value is None else map(float, value)
    elif hasattr(there, "sec"):
        there.sec, there.nanosec = divmod(value or 0, 10**9)
    elif value is None:
        if isinstance(there, float | np.ndarray):
            setattr(msg, name, math.nan if isinstance(there, float) else np.full_like(there, math.nan))
    elif isinstance(value, str | Enum):
        setattr(msg, name, _numbers(message, name)[_word(value)])
    elif isinstance(there, list) and isinstance(value, np.ndarray):
        point = _element(message, name)
        setattr(msg, name, [point(x=x, y=y) for x, y in value.tolist()])
    elif isinstance(there, list) and is_record(kind):
        there.extend(_element(message, name)() for _ in value)
        for one, entry in zip(value, there, strict=True):
            write(one, kind, entry)
    else:
        setattr(msg, name, value.ravel() if isinstance(value, np.ndarray) else value)


def read(record: type, msg: Any, **given: Any) -> Any:
    """The record in a message, apart from the fields that are given; None: one that it needs is not known."""
    found = given
    for part in _parts(record):
        if part.name in given:
            continue
        holder = part.holder(msg)
        if part.is_record:
            value = read(part.kind, getattr(holder, part.names[0]) if part.names else holder)
        else:
            columns = [_get(holder, name, part.kind) for name in part.names]
            value = columns[0]
            if len(columns) > 1 and value is not None:
                value = tuple(columns) if isinstance(value, float) else np.column_stack(columns)
        if value is None and part.needed:
            return None
        found[part.name] = None if not part.needed and isinstance(value, np.ndarray) and not value.size else value
    return record(**found)


def _get(msg: Any, name: str, kind: Any) -> Any:
    message: Any = type(msg)
    there = getattr(msg, name)
    if isinstance(there, float):
        return None if math.isnan(there) else there
    if hasattr(there, "x"):
        at = there.x, there.y
        return None if math.isnan(there.x) else np.array(at) if get_origin(kind) is np.ndarray else at
    if hasattr(there, "sec"):
        return stamp_from_msg(there)
    if isinstance(kind, type) and issubclass(kind, str | Enum) and isinstance(there, int):
        numbers = _numbers(message, name)
        words: Any = kind if issubclass(kind, Enum) else numbers
        return next((one for one in words if numbers.get(_word(one)) == there), None)
    if isinstance(there, np.ndarray):  # the rows of a square matrix
        return None if not np.isfinite(there).all() else there.reshape(2 * (math.isqrt(len(there)),))
    if isinstance(there, list):
        return np.array([(one.x, one.y) for one in there]) if not is_record(kind) else tuple(read(kind, one) for one in there)
    if get_origin(kind) is np.ndarray:
        return np.array(there)
    if get_origin(kind) is tuple:
        return tuple(there) or None
    return there if isinstance(there, int | str) else list(there)


MODE_TO_MSG = {mode: getattr(PredictPush.Response, mode.name) for mode in ContactMode}

MODE_NAMES = {getattr(PusherState, name): name[5:].lower() for name in dir(PusherState) if name.startswith("MODE_")}
"""The modes of a pusher, in words."""

MODEL_TOPIC = "friction_model"
"""Topic of the friction model that planner nodes need."""


def pose_to_msg(pose: Pose) -> PoseMsg:
    """A planar pose as a message, at z = 0."""
    return samples.pose_to_msg(pose, _new)


def observation_to_msg(observation: Observation, object_name: str) -> ObservationMsg:
    """An observation as a message for the topic `observation`."""
    return samples.observation_to_msg(observation, object_name, _new)


def image_to_msg(picture: np.ndarray, stamp: int) -> Any:
    """A picture (height, width) in grey levels that the camera took at a time [ns], as sensor_msgs/Image."""
    height, width = picture.shape
    msg = _new("sensor_msgs/msg/Image", height=height, width=width, encoding="mono8", step=width)
    msg.header.frame_id, msg.header.stamp = CAMERA, stamp_to_msg(stamp)
    msg.data = array.array("B", picture.tobytes())
    return msg


def stamp_to_msg(nanoseconds: int) -> Time:
    """A time [ns], since the epoch or of the simulation, as a message."""
    seconds, rest = divmod(nanoseconds, 10**9)
    return Time(sec=seconds, nanosec=rest)


def estimate_to_msg(report: EstimateReport) -> FrictionEstimate:
    """The report on an estimate as a message."""
    msg = _estimate(report, report.object)
    friction = msg.contact_friction
    friction.bin_width = BIN_WIDTH
    if not report.mu_c.data_points == report.belief.data_points == report.data_points:
        friction.header = Header()
    return msg


def report_from_msg(msg: FrictionEstimate) -> EstimateReport:
    """The report in a message that has observations."""
    report: EstimateReport = read(EstimateReport, msg)
    return report


def nothing_known(object_name: str) -> FrictionEstimate:
    """The message while there is no estimate: no weights, and NaN for every number."""
    return _estimate(None, object_name)


def _estimate(report: EstimateReport | None, object_name: str) -> FrictionEstimate:
    msg = FrictionEstimate()
    write(report, EstimateReport, msg)
    msg.header.frame_id = OBJECT
    for part in (msg, msg.support_friction, msg.contact_friction):
        part.header, part.object = msg.header, object_name
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
    write(model, FrictionModel, msg)
    msg.center_of_friction, msg.total_friction = _point((math.nan, math.nan)), math.nan
    if estimate is None:
        return msg
    basis.header.stamp = stamp_to_msg(estimate.stamp)
    basis.data_points, basis.pushes = estimate.data_points, estimate.pushes
    write(VerdictReport(verdict.reasons, verdict.notes), VerdictReport, basis)
    if model is not None:
        msg.center_of_friction = _point(model.center_of_friction)
        msg.total_friction = math.nan if estimate.total_friction is None else estimate.total_friction
    return msg


def friction_model_from_msg(msg: FrictionModelMsg) -> tuple[FrictionModel, Outline]:
    """The model in a message that has one, and the outline of its object.

    Raises:
        ValueError: the numbers make no sense.
    """
    samples_of_w = len(msg.mu_c), len(msg.support_points)
    if len(msg.w) != math.prod(samples_of_w):
        raise ValueError(f"w must have {samples_of_w[0]} x {samples_of_w[1]} numbers, got {len(msg.w)}")
    model = read(FrictionModel, msg, w=np.reshape(msg.w, samples_of_w))
    if model is None:
        raise ValueError("a misfit is missing")
    return model, Outline(np.array([(corner.x, corner.y) for corner in msg.outline]))


REQUESTED: dict[str, tuple[int, float | None, str]] = {
    "contact_points": (2, FARTHEST, "m"),
    "contact_normals": (2, FARTHEST, ""),
    "tip_velocities": (2, FASTEST, "m/s"),
    "half_widths": (1, None, "m"),
    "centers_of_rotation": (2, FARTHEST_TURN_CENTER, "m"),
    "turns": (1, None, ""),
    "starts": (3, FARTHEST, "m and rad"),
    "origins": (2, FARTHEST, "m"),
    "directions": (2, FARTHEST, ""),
    "tip_radii": (1, LARGEST, "m"),
    "positions": (1, FARTHEST, "m"),
}
"""The fields of requests that have something of each push: how many numbers, at most how large, unless None, and their unit."""

UNIT_VECTORS = ("contact_normals", "directions")


def arrays_from_msg(request: Any) -> list[np.ndarray]:
    """The fields of a request that are among REQUESTED, in its order: (k,) each, or (k, n) for n numbers of each push.

    Raises:
        ValueError: their lengths k differ, there is nothing, a vector is not unit, or a number makes no sense.
    """
    names = [name for name in request.get_fields_and_field_types() if name in REQUESTED]
    arrays = [_rows(name, getattr(request, name)) for name in names]
    counts = [len(array) for array in arrays]
    if len(set(counts)) > 1 or not counts[0]:
        what = f"{', '.join(names[:-1])} and {names[-1]}"
        raise ValueError(f"{what} must have the same length, at least 1, got {', '.join(map(str, counts))}")
    return [array if REQUESTED[name][0] > 1 else array[:, 0] for name, array in zip(names, arrays, strict=True)]


def strokes_from_msg(request: PredictStroke.Request) -> tuple[list[Pose], list[PushingLine], np.ndarray]:
    """Poses before the strokes, the lines of the tip, and where it stops (k,) [m].

    Raises:
        ValueError: as `arrays_from_msg`, or as for `PushingLine`.
    """
    starts, origins, directions, radii, positions = arrays_from_msg(request)
    lines = zip(map(tuple, origins.tolist()), map(tuple, directions.tolist()), radii.tolist(), strict=True)
    return [Pose(*start) for start in starts.tolist()], [PushingLine(*line) for line in lines], positions


def add(response: Any, **found: npt.ArrayLike) -> None:
    """Add numbers, in arrays of any shape, to the fields of an answer that have these names."""
    for name, values in found.items():
        getattr(response, name).extend(np.ravel(values).tolist())


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
    msg.contact_friction, msg.total_friction = model.median_mu_c, total_friction
    ellipsoid = named_ellipsoid(model.support)
    msg.f_max, msg.m_max, msg.center = ellipsoid.f_max, ellipsoid.m_max, _point(ellipsoid.center)
    msg.ellipsoid_load_error, msg.ellipsoid_twist_error = ellipsoid_error(ellipsoid, model.support)
    wrenches, twists = surface_samples(model.support)
    msg.wrenches = [Wrench(force=Vector3(x=x, y=y), torque=Vector3(z=m)) for x, y, m in wrenches.tolist()]
    msg.twists = [_twist(row) for row in twists.tolist()]
    return msg


def _rows(name: str, numbers: Sequence[float]) -> np.ndarray:
    width, most, unit = REQUESTED[name]
    if len(numbers) % width:
        raise ValueError(f"{name} must have {width} numbers each, got {len(numbers)} in all")
    rows = np.array(numbers, dtype=float).reshape(-1, width)
    if most is not None and not (np.abs(rows) <= most).all():
        for row in rows.tolist():
            check_within(name, row, most, unit)
    if name in UNIT_VECTORS:
        check_unit(name, rows)
    return rows


def _twist(row: Sequence[float]) -> TwistMsg:
    twist = TwistMsg()  # as with arguments, in half the time
    twist.linear.x, twist.linear.y, twist.angular.z = row
    return twist


def _point(xy: Sequence[float] | np.ndarray) -> Point:
    return Point(x=float(xy[0]), y=float(xy[1]))


def _new(type_name: str, **fields: Any) -> Any:
    return message_class(type_name)(**fields)
