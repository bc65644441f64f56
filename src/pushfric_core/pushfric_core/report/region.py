"""Where p_CF can lie according to the data points of a file, without support points, and which pushes narrow it down."""

from collections.abc import Iterable, Sequence
from typing import Any

from pushfric_core.estimation.batch import Warn, taken
from pushfric_core.estimation.push_choice import RankedPush
from pushfric_core.estimation.push_plan import PlannedPush
from pushfric_core.estimation.region import HalfPlanes, Region, line_of_motion
from pushfric_core.geometry.outline import Outline
from pushfric_core.trajectories.observation import Observation


def narrowed(outline: Outline, data: Iterable[Observation], margin: float, warn: Warn) -> HalfPlanes:
    """The half-planes in which the data points leave p_CF, from their lines of motion, as in a live estimator.

    Args:
        outline: of the object.
        data: the data points.
        margin: by how much the half-planes are widened, as for `HalfPlanes` [m].
        warn: called with a line of text for each data point left out.
    """
    half_planes = HalfPlanes(outline, margin)
    for _ in taken(lambda observation: half_planes.add(line_of_motion(observation)), data, warn):
        pass
    return half_planes


def region_report(region: Region, next_pushes: Sequence[RankedPush], slip_pushes: Sequence[PlannedPush]) -> dict[str, Any]:
    """A region and the next pushes as the command line's JSON names them; SI units, object frame."""
    return {
        "area": region.area,
        "polygon": region.corners.tolist(),
        "collapsed": region.collapsed,
        "center_of_friction": region.center.tolist(),
        "violation": region.violation,
        "next_pushes": [{**push._asdict(), "expected_area": area} for push, area in next_pushes],
        "slip_pushes": [push._asdict() for push in slip_pushes],
    }
