"""The command `region`."""

import math
import pathlib
import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import Annotated, Any

import typer

from pushfric_core.bags.recorded import Recorded
from pushfric_core.commands.application import Application
from pushfric_core.commands.console import say, warn
from pushfric_core.commands.options import CellOption, ForceFlag, JsonOption, ObjectOption, PartialFlag, permit
from pushfric_core.commands.result import answer
from pushfric_core.commands.settings_options import option_as_recorded
from pushfric_core.errors import InvalidInput, blaming
from pushfric_core.estimation.estimator import Warn, taken
from pushfric_core.estimation.push_choice import RankedPush, next_pushes, planned_pushes, slip_pushes
from pushfric_core.estimation.push_plan import PlannedPush
from pushfric_core.estimation.region import HalfPlanes, Region, RegionConfig, line_of_motion
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.object_file import load_object
from pushfric_core.files.plan_file import save_plan
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.table_1 import TABLE_1
from pushfric_core.offline.inputs import object_of
from pushfric_core.trajectories.observation import Observation
from pushfric_core.wording import counted, data_of

SLIPS = 3
"""Number of pushes for mu_c that are printed: so many have to slip."""

app = Application()


@app.command()
def region(
    source: Annotated[
        pathlib.Path | None, typer.Argument(help="Bag (folder or .mcap), or CSV of observations; if none, before any push.")
    ] = None,
    object_name: ObjectOption = "",
    region_margin: Annotated[float | None, option_as_recorded(RegionConfig, "region_margin")] = None,
    exclude_push: Annotated[list[int] | None, typer.Option(help="Leave out this push; repeatable.")] = None,
    plan: Annotated[
        pathlib.Path | None, typer.Option(help="Write the push plan that shrinks the region fastest to this file.")
    ] = None,
    pushes: Annotated[int, typer.Option(help="Number of pushes in that plan.", min=1, max=20)] = 10,
    force: ForceFlag = False,
    partial: PartialFlag = False,
    namespace: CellOption = None,
    json: JsonOption = None,
) -> None:
    if source is None and not object_name:
        raise InvalidInput(f"give a bag, or --object OBJ.yaml or one of {', '.join(TABLE_1)}")
    if source is None and (exclude_push or partial or namespace is not None):
        raise InvalidInput("--exclude-push, --partial and --namespace are for a bag or a CSV: give one, too")
    if plan is not None:
        permit(plan, force, "Overwrite it?", "another FILE")
    model = load_object(object_name) if source is None else object_of(source, object_name, warn)[0]
    recorded = None if source is None else Recorded(source, namespace)
    settings = EstimatorSettings() if recorded is None else recorded.settings
    with blaming():
        config = settings.region if region_margin is None else RegionConfig(region_margin)
    settings = settings.without(exclude_push or ())
    reading = None if recorded is None else recorded.read(model, settings, warn, partial)
    data = settings.relied_on([] if reading is None else reading.observations, model.support_points, warn)
    half_planes = narrowed(model.outline, data, config.region_margin, warn)
    planned = planned_pushes(half_planes, pushes) if plan is not None else []
    if plan is not None and not planned:
        raise InvalidInput("the observations contradict each other: no push is worth planning; try a larger --region-margin")
    if plan is not None:
        save_plan([push for push, _ in planned], plan)
    left = half_planes.region()
    figures = region_report(left, next_pushes(half_planes), slip_pushes(model.outline, left.center))
    figures |= {"object": model.name, "data_points": len(data), "pushes": len({one.push_id for one in data})}
    answer(figures, json, _lines(figures))
    if plan is not None:
        area = f"{planned[-1].expected_area * 1e4:.3g} cm^2"
        say(f"plan: {plan}, {counted(len(planned), 'push', 'pushes')}; expected to leave {area}")
    if reading is not None and reading.ledger.doubts and not partial:
        sys.exit(1)


def narrowed(outline: Outline, data: Iterable[Observation], margin: float, warn: Warn) -> HalfPlanes:
    """The half-planes in which the observations leave p_CF, from their lines of motion, as in a live estimator.

    Args:
        outline: of the object.
        data: the observations.
        margin: by how much the half-planes are widened, as for `HalfPlanes` [m].
        warn: called with a line of text for each observation left out.
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


def _lines(figures: dict[str, Any]) -> Iterator[str]:
    x, y = (1e3 * value for value in figures["center_of_friction"])
    size = f"{figures['area'] * 1e4:.3g} cm^2"
    contradicted = f"collapsed: the observations contradict each other, by {figures['violation'] * 1e3:.2f} mm in all"
    yield f"region {contradicted if figures['collapsed'] else size}"
    yield f"p_CF   ({x:z.2f}, {y:z.2f}) mm, {'contradicted least' if figures['collapsed'] else 'its middle'}"
    for push in figures["next_pushes"]:
        where = f"edge {push['edge']}, {push['offset'] * 1e3:z.1f} mm from its middle"
        yield f"next   {where}: expected to leave {push['expected_area'] * 1e4:.3g} cm^2"
    for push in figures["slip_pushes"][:SLIPS]:
        where = f"edge {push['edge']}, {push['offset'] * 1e3:z.1f} mm from its middle"
        yield f"slip   {where}, at {math.degrees(push['angle']):.0f} degrees: for mu_c"
    yield f"from   {data_of(figures['data_points'], figures['pushes'])}"
