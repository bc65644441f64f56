"""The command `replay`."""

import pathlib
from typing import Annotated

import typer

from pushfric_core.bags.recorded import Recorded
from pushfric_core.bags.run_record import KEYFRAMES
from pushfric_core.cell.node_settings import PlannerConfig, PlayerConfig, ViewConfig
from pushfric_core.commands.application import Application
from pushfric_core.commands.cell_options import HeadlessFlag, PlannerFlag, ViewOption, view_to_serve
from pushfric_core.commands.console import console, fail, warn
from pushfric_core.commands.options import CellOption, JsonOption, ObjectOption, PartialFlag
from pushfric_core.commands.result import print_result
from pushfric_core.commands.settings_options import option
from pushfric_core.offline.inputs import object_of
from pushfric_msgs.msg import FrictionEstimate
from pushfric_ros.commands.watch import watch
from pushfric_ros.graph import graph
from pushfric_ros.messages.conversions import report_from_msg

app = Application()


@app.command()
def replay(
    bag: Annotated[pathlib.Path, typer.Argument(help="Bag: a folder or a .mcap.")],
    object_name: ObjectOption = "",
    rate: Annotated[float, option(PlayerConfig, "rate")] = PlayerConfig.rate,
    partial: PartialFlag = False,
    namespace: CellOption = None,
    json: JsonOption = None,
    headless: HeadlessFlag = False,
    view: ViewOption = "",
    planner: PlannerFlag = False,
    stay: Annotated[
        bool, typer.Option("--stay", help="Keep the last estimate on its topics, for late subscribers, until Ctrl-C.")
    ] = False,
) -> None:
    model, object_file = object_of(bag, object_name, warn)
    recorded = Recorded(bag, namespace)
    settings = recorded.settings
    reading = recorded.read(model, settings, warn, partial)
    data, doubts = reading.observations, "; ".join(one.text for one in reading.ledger.doubts)
    source = recorded.source(settings.with_forces)
    shown = view_to_serve(view, ViewConfig())
    played = recorded.holding(f"{source.namespace}/{KEYFRAMES}") if shown is not None else []
    specs = graph.replay(str(bag), object_file, source, rate, settings, paused=True, partial=partial, shown=played)
    specs = graph.with_parts(specs, object_file, shown, PlannerConfig() if planner else None)
    live = console.is_terminal and not headless

    def show(last: FrictionEstimate | None) -> None:
        expected = len(settings.relied_on(data, model.support_points, lambda _: None))
        if last is None or last.data_points < expected:
            arrived = 0 if last is None else last.data_points
            fail(f"the live graph made only {arrived} of the {expected} observations in the bag; try a lower --rate", 1)
        print_result(report_from_msg(last).to_dict(), json, settings.estimator.loss)

    def show_and_stay(last: FrictionEstimate | None) -> None:
        show(last)
        console.print(f"{source.namespace}/friction_estimate keeps this estimate until Ctrl-C", markup=False)

    name = f"replaying {bag.name}"
    ended, last = watch(console, specs, source.namespace, name, live, replayed=data, stay=show_and_stay if stay else None)
    if ended.code:
        fail(ended.reason, ended.code)
    if stay:
        return
    show(last)
    if doubts and not partial:
        fail(f"{bag}: does not add up: {doubts}", 1)
