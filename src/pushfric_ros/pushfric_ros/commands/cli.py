"""The command line: one function for each command, which does nothing but connect the rooms of this package."""

import contextlib
import os
import pathlib
import sys
import time
from collections import deque
from collections.abc import Iterator
from typing import Annotated, Any

import typer
from rich.console import Console

from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_core.estimator import Estimator, EstimatorConfig
from pushfric_core.recognition import Recognizer
from pushfric_core.region import RegionConfig
from pushfric_core.solvers.program import Loss
from pushfric_core.table_1 import TABLE_1
from pushfric_core.test_pushes import next_pushes, planned_pushes
from pushfric_ros.bags import data_points, zhou2015
from pushfric_ros.bags.bag import Bag
from pushfric_ros.bags.recovery import recover
from pushfric_ros.commands import calibrate as calibrate_cli
from pushfric_ros.commands import demo as demonstration
from pushfric_ros.commands.doctor import examine, findings, passed, table
from pushfric_ros.commands.settings_options import with_settings
from pushfric_ros.files.cell_file import load_cell
from pushfric_ros.files.estimator_settings import EstimatorSettings
from pushfric_ros.files.node_settings import PlanConfig
from pushfric_ros.files.object_file import ObjectModel, SupportFile, load_object, make_object, read_points
from pushfric_ros.files.plan_file import load_plan, save_plan
from pushfric_ros.graph import graph
from pushfric_ros.messages.conversions import estimate_to_msg, recognition_to_msg
from pushfric_ros.paper.reproduce import reproduce
from pushfric_ros.report.condition import condition
from pushfric_ros.report.figures import summary_figure
from pushfric_ros.report.region import narrowed, region_report
from pushfric_ros.report.report import recognition_report, report, to_json, truth

RUNS = pathlib.Path("runs")
"""Bags go there where nothing else is said."""

app = typer.Typer(
    pretty_exceptions_enable=False,
    add_completion=False,
    help="Push an object a few times; learn its support friction, its centre of friction and the pusher's contact friction.",
)
bag_app = typer.Typer(help="Look after bags.")
app.add_typer(bag_app, name="bag")
app.add_typer(calibrate_cli.app, name="calibrate")
console = Console(stderr=True, soft_wrap=True)

Input = Annotated[pathlib.Path, typer.Argument(help="Bag (folder or .mcap), or CSV of observations.", show_default=False)]
ObjectOption = Annotated[
    str,
    typer.Option(
        "--object",
        help=f"Object YAML, or one of {', '.join(TABLE_1)}. A bag may bring its own as object.yaml.",
        show_default=False,
    ),
]
GridOption = Annotated[
    tuple[int, int] | None,
    typer.Option("--grid", help="Support points: a grid of NX by NY over the object.", metavar="NX NY", show_default=False),
]
SupportPointsOption = Annotated[
    pathlib.Path | None,
    typer.Option("--support-points", help="Support points: a CSV with columns x,y (m).", show_default=False),
]
JsonFlag = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else there.")]
PartialFlag = Annotated[bool, typer.Option("--partial", help="Make do with a damaged bag, of which messages are missing.")]
HeadlessFlag = Annotated[bool, typer.Option("--headless", help="No live display: a line for each push.")]


@app.command()
def demo(
    headless: HeadlessFlag = False,
    json: Annotated[
        pathlib.Path | None, typer.Option("--json", help="Write the result there as JSON.", show_default=False)
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the camera's noise and the operator's hand.", min=0, max=2**31)] = 0,
    object_name: Annotated[str, typer.Option("--object", help=f"One of {', '.join(TABLE_1)}.")] = "rubber_rect4",
    bag: Annotated[
        pathlib.Path | None, typer.Option(help="Folder of the bag to record.", show_default="runs/demo-DATE")
    ] = None,
    plan: Annotated[pathlib.Path | None, typer.Option(help="Push plan YAML.", show_default="the paper's pushes")] = None,
    choose: Annotated[
        int,
        typer.Option(help="Instead choose so many pushes one by one, to shrink the region of p_CF fastest.", min=0, max=1000),
    ] = 0,
) -> None:
    """Run the whole node graph on a simulated cell: camera frames, a GRBL controller on a pseudo-terminal, an operator."""
    if object_name not in TABLE_1:
        raise InvalidInput(f"no object {object_name!r} in the simulated cell; expected one of {', '.join(TABLE_1)}")
    bag = bag or RUNS / time.strftime("demo-%Y%m%d-%H%M%S")
    if json is not None and not json.parent.is_dir():
        raise InvalidInput(f"{json}: its folder does not exist")
    if json is not None and json.is_dir():
        raise InvalidInput(f"{json}: is a folder; expected the name of a file to write")
    if bag.exists() and (not bag.is_dir() or any(bag.iterdir())):
        raise InvalidInput(f"{bag}: exists; expected a new or empty folder for the bag")
    if plan is not None and choose:
        raise InvalidInput("give --plan or --choose, not both")
    pushes = PlanConfig(plan=str(plan) if plan is not None else "", choose=choose)
    load_plan(pushes.plan, load_object(object_name))  # what is wrong with it is said before all starts
    with _telling_what_is_left(bag):
        last, ended = demonstration.run_demo(console, object_name, seed, bag, console.is_terminal and not headless, pushes)
    if ended.code or last is None:
        raise RunFailed(ended.code or 1, ended.reason if ended.code else "the run ended without an estimate")
    demonstration.print_summary(console, object_name, last)
    if json is not None:
        json.write_text(to_json({**report(last), "truth": truth(object_name), "bag": str(bag)}) + "\n")
    figure = bag / demonstration.FIGURE
    summary_figure(figure, TABLE_1[object_name].outline, *demonstration.course_of(bag, _warn), TABLE_1[object_name])
    console.print(f"figure: {figure}\nbag:    {bag}", markup=False)


@app.command()
def run(
    cell: Annotated[pathlib.Path, typer.Argument(help="Cell YAML.", show_default=False)],
    bag: Annotated[
        pathlib.Path | None, typer.Option(help="Folder of the bag to record.", show_default="runs/NAME-DATE")
    ] = None,
    start: Annotated[int, typer.Option(help="Push of the plan to begin with, to go on with one.", min=1)] = 1,
    headless: HeadlessFlag = False,
) -> None:
    """Run the real cell: carry out its push plan, estimate, record."""
    file = load_cell(cell)
    model = load_object(file.object)
    bag = bag or RUNS / time.strftime(f"{model.name}-%Y%m%d-%H%M%S")
    if (absence := file.driver.absence()) is not None:
        raise InvalidInput(f"{cell}: pusher: {absence}")
    specs = graph.cell(file, str(bag), start)

    def go_on(push: int) -> None:
        console.print(f"the plan is not finished; go on with: ./pushfric run {cell} --start {push}", markup=False)

    live = console.is_terminal and not headless
    with _telling_what_is_left(bag):
        ended, last = demonstration.watch(console, specs, file.namespace, f"pushing {model.name}", live, unfinished=go_on)
    if ended.code:
        raise RunFailed(ended.code, ended.reason)
    console.print(f"bag: {bag}" if last is not None else f"bag: {bag}; no data point came of it", markup=False)


@app.command()
def replay(
    bag: Annotated[pathlib.Path, typer.Argument(help="Bag: a folder or a .mcap.", show_default=False)],
    object_name: ObjectOption = "",
    rate: Annotated[float, typer.Option(help="Multiple of the recorded speed.")] = 1.0,
    partial: PartialFlag = False,
    json: JsonFlag = False,
    headless: HeadlessFlag = False,
) -> None:
    """Play a bag through the live graph, with the settings it was recorded with: it ends with the estimate of the live run."""
    if not 0.01 <= rate <= 1000:
        raise InvalidInput(f"--rate must lie in [0.01, 1000], got {rate:g}")
    model, object_file = _object_of(bag, object_name)
    settings = data_points.recorded_settings(bag)
    data = data_points.observations(bag, model, settings, _warn, partial)
    source = data_points.source_of(bag, settings.with_forces)
    specs = graph.replay(str(bag), object_file, source, rate, settings, paused=True, partial=partial)
    live = console.is_terminal and not headless
    ended, last = demonstration.watch(console, specs, source.namespace, f"replaying {bag.name}", live, replayed=data)
    if ended.code:
        raise RunFailed(ended.code, ended.reason)
    if last is None or last.data_points < len(data):
        arrived = 0 if last is None else last.data_points
        raise RunFailed(1, f"the live graph made {arrived} data points of the {len(data)} in the bag; try a lower --rate")
    _print_result(report(last), json, settings.estimator.loss)


def estimate(
    source: Input,
    settings: EstimatorSettings,
    object_name: ObjectOption = "",
    grid: GridOption = None,
    support_points: SupportPointsOption = None,
    figure: Annotated[
        pathlib.Path | None, typer.Option(help="Draw pushes, w, mu_c and p_CF there (.png, .svg, .pdf).", show_default=False)
    ] = None,
    partial: PartialFlag = False,
    json: JsonFlag = False,
) -> None:
    """Estimate from a bag or a CSV, as fast as it goes."""
    model, _ = _object_of(source, object_name)
    model = _with_support(model, grid, support_points)
    data = data_points.observations(source, model, settings, _warn, partial)
    estimator = Estimator(model.support_points, settings.estimator)
    # only the figure shows how the last estimate came about
    course = deque(data_points.taken(estimator.add, data, _warn), maxlen=None if figure is not None else 1)
    result = data_points.last(course)
    if result.contradiction is not None:
        _warn(result.contradiction)
    if figure is not None:
        summary_figure(figure, model.outline, course, estimator.observations, None, settings.slipping)
    slipping = [observation.push_id in settings.slipping for observation in estimator.observations]
    _print_result(report(estimate_to_msg(result, model.name, slipping)), json, settings.estimator.loss)


app.command("estimate")(with_settings(estimate))


def recognize(
    source: Input,
    settings: EstimatorSettings,
    object_name: ObjectOption = "",
    grid: GridOption = None,
    support_points: SupportPointsOption = None,
    partial: PartialFlag = False,
    json: JsonFlag = False,
) -> None:
    """Rank the hypotheses in the object's file by how well they explain the data (section 5.2)."""
    model, where = _object_of(source, object_name)
    if not model.hypotheses:
        raise InvalidInput(f"{where} names no hypotheses; expected a list of them under hypotheses")
    model = _with_support(model, grid, support_points)
    data = data_points.observations(source, model, settings, _warn, partial)
    ranking = data_points.recognize(Recognizer(model.hypotheses, settings.estimator), data, _warn)
    for ranked in ranking.hypotheses:
        if ranked.contradiction is not None:
            _warn(f"{ranked.name}: {ranked.contradiction}")
    _print_ranking(recognition_report(recognition_to_msg(ranking)), json)


app.command("recognize")(with_settings(recognize, without=("tie_break",)))


@app.command()
def region(
    source: Annotated[
        pathlib.Path | None, typer.Argument(help="Bag (folder or .mcap), or CSV of observations; none: before any push.")
    ] = None,
    object_name: ObjectOption = "",
    region_margin: Annotated[
        float | None,
        typer.Option(
            help="How far data points may err (m); 0: not at all.",
            show_default=f"as recorded, or {RegionConfig().region_margin}",
        ),
    ] = None,
    exclude_push: Annotated[
        list[int] | None, typer.Option(help="Leave out this push; may be given again.", show_default=False)
    ] = None,
    plan: Annotated[
        pathlib.Path | None, typer.Option(help="Write a push plan there that shrinks the region fastest.", show_default=False)
    ] = None,
    pushes: Annotated[int, typer.Option(help="Of that plan.", min=1, max=20)] = 10,
    partial: PartialFlag = False,
    json: JsonFlag = False,
) -> None:
    """Where p_CF can lie, without support points (section 6.2), and which pushes would narrow that down."""
    if source is None and not object_name:
        raise InvalidInput(f"give a bag, or --object OBJ.yaml or one of {', '.join(TABLE_1)}")
    model = load_object(object_name) if source is None else _object_of(source, object_name)[0]
    settings = data_points.recorded_settings(source) if source is not None else EstimatorSettings()
    try:
        config = settings.region if region_margin is None else RegionConfig(region_margin)
    except ValueError as error:
        raise InvalidInput(str(error)) from error
    settings = settings.without(exclude_push or ())
    data = data_points.observations(source, model, settings, _warn, partial) if source is not None else []
    half_planes = narrowed(model.outline, data, config.region_margin, _warn)
    planned = planned_pushes(half_planes, pushes) if plan is not None else []
    if plan is not None and not planned:
        raise InvalidInput("the data points contradict each other: no push is worth planning; try a larger --region-margin")
    if plan is not None:
        save_plan([push for push, _ in planned], plan)
    figures = region_report(half_planes.region(), next_pushes(half_planes))
    figures |= {"object": model.name, "data_points": len(data), "pushes": len({one.push_id for one in data})}
    _print_region(figures, json)
    if plan is not None:
        area = f"{planned[-1].expected_area * 1e4:.3g} cm^2"
        console.print(f"plan: {plan}, {len(planned)} pushes; they leave {area}, by expectation", markup=False)


@app.command("reproduce")
def reproduce_(
    out: Annotated[pathlib.Path, typer.Option(help="Folder of the report; a second call goes on there.")] = RUNS / "reproduce",
    seeds: Annotated[int, typer.Option(help="Repetitions, each with its own noise.", min=1, max=10_000)] = 20,
    jobs: Annotated[int, typer.Option(help="Processes; -1: one for each core.", min=-1)] = -1,
    dask: Annotated[
        str | None,
        typer.Option("--dask", help="Scheduler of a Dask cluster to run on instead.", metavar="ADDRESS", show_default=False),
    ] = None,
) -> None:
    """The paper's tables and figures beside the paper's numbers, from simulated pushes; as report.html and tables.json."""
    if jobs == 0:
        raise InvalidInput("--jobs must be -1, or 1 or more, got 0")
    _, written = reproduce(out, seeds, jobs, dask, console)
    console.print(f"report: {written}", markup=False)


@app.command()
def doctor(
    cell: Annotated[
        pathlib.Path | None, typer.Argument(help="Cell YAML; without one, only this machine is looked at.", show_default=False)
    ] = None,
    json: JsonFlag = False,
) -> None:
    """Look at all that a cell needs, without moving anything, and say what to do about what is amiss.

    Exit code 0: nothing failed; 1: a check failed; 2: wrong input, such as a cell file that cannot be read or is no cell's.
    """
    with console.status("") as status:
        checks = list(examine(cell, RUNS, lambda what: status.update(f"looking at the {what}")))
    if json:
        print(to_json(findings(checks)))
    else:
        Console().print(table(checks))
    if not passed(checks):
        sys.exit(1)


@bag_app.command("recover")
def recover_(
    damaged: Annotated[
        pathlib.Path, typer.Argument(help="A bag, or one of its files, that was damaged or cut short.", show_default=False)
    ],
    out: Annotated[pathlib.Path, typer.Option(help="Folder of the new bag.", show_default=False)],
) -> None:
    """Save all that can be read of a damaged bag into a new one, and say what is lost."""
    bag = recover(damaged, out)
    _print_condition(bag, console)
    console.print(f"{out}: {bag.summary.message_count} messages saved", markup=False)


@bag_app.command()
def verify(
    bag: Annotated[pathlib.Path, typer.Argument(help="A bag, or one of its files.", show_default=False)], json: JsonFlag = False
) -> None:
    """Read every byte of a bag and say whether it is whole.

    Exit code 0: it is whole; 1: it is damaged; 2: it is not a bag.
    """
    checked = Bag(bag)
    if json:
        print(to_json(condition(checked)))
    else:
        _print_condition(checked, Console(highlight=False, soft_wrap=True))
    if checked.damage is not None:
        sys.exit(1)


@app.command("import")
def import_(
    dataset: Annotated[str, typer.Argument(help=f"Which public data set: {zhou2015.NAME}.", show_default=False)],
    source: Annotated[pathlib.Path, typer.Argument(help="A log of it, or push_points.csv.", show_default=False)],
    out: Annotated[pathlib.Path, typer.Option(help="Folder of the bag; of several logs, a bag each.", show_default=False)],
) -> None:
    """Turn a public data set of real pushes into bags of observations, each with its object.yaml."""
    if dataset != zhou2015.NAME:
        raise InvalidInput(f"unknown data set {dataset!r}; expected {zhou2015.NAME}")
    for written in zhou2015.import_pushes(source, out):
        console.print(f"{written.bag}: {written.observations} observations of {written.object}", markup=False)


class RunFailed(PushfricError):
    """A run of the graph came to a bad end."""

    def __init__(self, code: int, reason: str) -> None:
        super().__init__(reason)
        self.code = code


def _object_of(path: pathlib.Path, name: str) -> tuple[ObjectModel, str]:
    """The object given, or the one that lies beside the bag; and where it came from."""
    data_points.check_source(path)
    beside = data_points.object_beside(path)
    if not name and beside is None:
        raise InvalidInput(f"{path} does not say of what object it is; give --object OBJ.yaml or one of {', '.join(TABLE_1)}")
    where = name or str(beside)
    return load_object(where), where


def _with_support(model: ObjectModel, grid: tuple[int, int] | None, file: pathlib.Path | None) -> ObjectModel:
    """The object on other support points, where such are given; hypotheses that bring their own keep them."""
    if file is not None and grid is not None:
        raise InvalidInput("give --grid or --support-points, not both")
    if file is not None:
        support, where = SupportFile(points=[(x, y) for x, y in read_points(file).tolist()]), str(file)
    elif grid is not None:
        support, where = SupportFile(grid=grid, inset=model.file.support.inset), "--grid"
    else:
        return model
    return make_object(model.file.model_copy(update={"support": support}), where)


def _print_result(figures: dict[str, Any], as_json: bool, loss: Loss = EstimatorConfig.loss) -> None:
    if as_json:
        print(to_json(figures))
        return
    x, y = (1e3 * value for value in figures["center_of_friction"])
    output = Console(highlight=False)
    trust = f"; off by at most {figures['confidence'] * 1e3:.2f} mm with 90 %" if "confidence" in figures else ""
    output.print(f"p_CF   ({x:.2f}, {y:.2f}) mm{trust}")
    mu = figures["mu_c"]
    slipping = ", {:.3f} to {:.3f} (slipping)".format(*mu["slipping"]) if "slipping" in mu else ""
    output.print(f"mu_c   {mu['p90']:.3f} (90 %), {mu['max']:.3f} (100 %){slipping}")
    if "total_friction" in figures:
        output.print(f"total  {figures['total_friction']:.3f} N of support friction")
    squares = loss is Loss.L2
    scale, unit = (1e6, "mm^2") if squares else (1e3, "mm")
    output.print(
        f"fit    {figures['objective'] * scale:.4f} {unit}, {figures['status']}, gap {figures['gap'] * scale:.1e} {unit}"
    )
    output.print(f"from   {figures['data_points']} data points of {figures['pushes']} pushes")


def _print_ranking(figures: dict[str, Any], as_json: bool) -> None:
    if as_json:
        print(to_json(figures))
        return
    output = Console(highlight=False, markup=False)
    for hypothesis in figures["hypotheses"]:
        fit = f"fit {hypothesis['fit_error']:.4g}, ratio {hypothesis['ratio']:.3f}"
        output.print(f"{hypothesis['name']}: {fit if hypothesis['feasible'] else 'infeasible'}")
    output.print(f"best: {figures['best'] or 'none is feasible'}")


def _print_condition(bag: Bag, output: Console) -> None:
    if bag.damage is None:
        output.print(
            f"{bag.path}: whole, {bag.summary.message_count} messages of {len(bag.summary.topics)} topics", markup=False
        )
        return
    output.print(bag.what_is_missing(with_places=False), markup=False)
    for file, gap in bag.damage.gaps:
        output.print(f"{file.name}, bytes {gap.begin} to {gap.end}: {gap.reason}, {bag.when(gap)}", markup=False)
    for contradiction in bag.damage.contradictions:
        output.print(contradiction, markup=False)


def _print_region(figures: dict[str, Any], as_json: bool) -> None:
    if as_json:
        print(to_json(figures))
        return
    x, y = (1e3 * value for value in figures["center_of_friction"])
    size = f"{figures['area'] * 1e4:.3g} cm^2"
    contradicted = f"collapsed: the data points contradict each other, by {figures['violation'] * 1e3:.2f} mm in all"
    output = Console(highlight=False, markup=False)
    output.print(f"region {contradicted if figures['collapsed'] else size}")
    output.print(f"p_CF   ({x:.2f}, {y:.2f}) mm, {'contradicted least' if figures['collapsed'] else 'its middle'}")
    for push in figures["next_pushes"]:
        where = f"edge {push['edge']}, {push['offset'] * 1e3:.1f} mm from its middle"
        output.print(f"next   {where}: would leave {push['expected_area'] * 1e4:.3g} cm^2, by expectation")
    output.print(f"from   {figures['data_points']} data points of {figures['pushes']} pushes")


@contextlib.contextmanager
def _telling_what_is_left(bag: pathlib.Path) -> Iterator[None]:
    """A run that Ctrl-C may interrupt: the operator is told which bag it leaves."""
    try:
        yield
    except KeyboardInterrupt:
        console.print(demonstration.left_behind(bag, _warn), markup=False)
        raise


def _warn(line: str) -> None:
    console.print(f"warning: {line}", highlight=False, markup=False)


UsageError: type[Exception] = typer.BadParameter.__bases__[0]  # typer does not export it
"""A command line that names no known command or option, or gives a value of the wrong kind."""


def main() -> None:
    """The command line. Unusable input ends with one line and exit code 2."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        sys.exit(app(prog_name="pushfric", standalone_mode=False))
    except UsageError as error:
        _fail(f"{error.format_message().rstrip('.')}; see pushfric --help", 2)  # type: ignore[attr-defined]
    except InvalidInput as error:
        _fail(str(error), 2)
    except RunFailed as error:
        _fail(str(error), error.code)
    except PushfricError as error:
        _fail(str(error), 1)
    except (KeyboardInterrupt, typer.Abort):
        sys.exit(130)


def _fail(line: str, code: int) -> None:
    console.print(f"error: {line}", highlight=False, markup=False)
    sys.exit(code)
