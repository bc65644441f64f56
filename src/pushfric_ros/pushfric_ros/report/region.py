"""Where p_CF can lie by the data points of a file, without support points, and which pushes would narrow it down."""

from collections.abc import Iterable, Sequence
from typing import Any

from pushfric_core.observation import Observation
from pushfric_core.outline import Outline
from pushfric_core.region import HalfPlanes, RankedPush, Region, line_of_motion
from pushfric_ros.bags.data_points import Warn, taken


def narrowed(outline: Outline, data: Iterable[Observation], margin: float, warn: Warn) -> HalfPlanes:
    """The half-planes of the data points' lines of motion, as a live estimator takes them; `warn` is told of those refused."""
    half_planes = HalfPlanes(outline, margin)
    for _ in taken(lambda observation: half_planes.add(line_of_motion(observation)), data, warn):
        pass
    return half_planes


def region_report(region: Region, next_pushes: Sequence[RankedPush]) -> dict[str, Any]:
    """A region under the names of the command line's JSON; SI units, object frame."""
    return {
        "area": region.area,
        "polygon": region.corners.tolist(),
        "collapsed": region.collapsed,
        "center_of_friction": region.center.tolist(),
        "violation": region.violation,
        "next_pushes": [{**push._asdict(), "expected_area": area} for push, area in next_pushes],
    }
