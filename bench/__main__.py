"""The command line of the benchmarks: runs the sections one after another and shows their figures."""

import importlib.metadata
import json as jsons
import pathlib
import platform
import sys
import time
from collections.abc import Callable
from typing import Annotated, Any

import typer
import typer.core
from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))  # started as `python bench`, from any folder

from bench import (
    display,
    footprint,
    fuzz,
    growth,
    pipeline,
    planning,
    prediction,
    real_pushes,
    recording,
    services,
    soak,
    tracker,
    updates,
    view_cost,
)
from bench.data_points import GRIDS
from bench.verdict import verdicts, with_best_of_highs
from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_ros.commands.json_option import STDOUT, JsonOption, spelled_out, write_json

POINTS, SUPPORTS, UPDATES, BUDGET, HELD = (50, 100, 1000, 10_000, 100_000), tuple(GRIDS), 200, 2.0, 10_000
QUICK_POINTS, QUICK_SUPPORTS, QUICK_UPDATES, QUICK_BUDGET, QUICK_HELD = (50, 100, 1000), (24,), 40, 1.0, 1000

DEFAULT_PLOT = pathlib.Path("runs/bench.png")

LIBRARIES = ("numpy", "scipy", "osqp", "highspy", "cvxpy", "clarabel")

HIGHS_WARM = "highs_warm: HiGHS kept warm, the better of its primal and dual form."

COLUMNS = (TextColumn("{task.description}"), MofNCompleteColumn(), TimeElapsedColumn())

app = typer.Typer(pretty_exceptions_enable=False, add_completion=False)
UsageError: type[Exception] = typer.BadParameter.__bases__[0]  # typer does not export it


class Bench(typer.core.TyperCommand):
    """Takes `--json` with or without a file."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, spelled_out(args))


@app.command(cls=Bench)
def bench(
    points: Annotated[
        list[int] | None,
        typer.Option(help="Number of earlier data points (M); repeatable.", min=1, max=1_000_000, show_default="50 to 100000"),
    ] = None,
    supports: Annotated[
        list[int] | None,
        typer.Option(
            help=f"Number of support points (N), one of {', '.join(map(str, GRIDS))}; repeatable.", show_default="all"
        ),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Measure only a small part, in less than a minute.")] = False,
    plot: Annotated[pathlib.Path, typer.Option(help="Write the plot of cost against M to this file.")] = DEFAULT_PLOT,
    pushes: Annotated[
        pathlib.Path | None,
        typer.Option(
            "--real-pushes", help="Also measure the accuracy on real pushes: push_points.csv of zhou2015.", show_default=False
        ),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="Also measure the live graph and the recorder, in real time: 3 minutes.")
    ] = False,
    footprint_only: Annotated[
        bool,
        typer.Option(
            "--footprint", help="Measure only memory, start and end of the processes, next to a bare rclpy node: 2 minutes."
        ),
    ] = False,
    growing: Annotated[
        bool,
        typer.Option(
            "--growth",
            help="Measure only the cost of a data point in the estimator when there are up to a million: 20 minutes.",
        ),
    ] = False,
    view_only: Annotated[
        bool,
        typer.Option(
            "--view",
            help="Measure only image to estimate, without a live view, with one that nobody looks at, and with a visitor:"
            " 8 minutes.",
        ),
    ] = False,
    planning_only: Annotated[
        bool,
        typer.Option(
            "--planning", help="Measure only what planners get: strokes, predictions, answers of the services: 4 minutes."
        ),
    ] = False,
    fuzzing: Annotated[
        float | None,
        typer.Option(
            "--fuzz",
            help="Measure nothing; give mutated input to every parser for this long.",
            metavar="MINUTES",
            min=0,
            show_default=False,
        ),
    ] = None,
    soaking: Annotated[
        float | None,
        typer.Option(
            "--soak",
            help="Measure only whether the memory, threads and files of a running cell's nodes grow, for this long.",
            metavar="MINUTES",
            min=0,
            show_default=False,
        ),
    ] = None,
    json: JsonOption = None,
) -> int:
    """Measure the CPU time of one new data point, in pushfric and in other solvers of the same program, and of one frame.

    Everything runs on one thread. A solver is left out ("-") if one solve takes more than 20 s of CPU time, or is expected to
    after its last M. All solvers take each data point in turn, so that a disturbance, even of the caches, affects all alike.
    highs_warm is HiGHS kept warm: at each M and N the better of its primal and dual form.
    """
    if fuzzing is not None:
        seed = time.time_ns() % 2**32
        return int(fuzz.campaign(60 * fuzzing, print, seed) > 0)
    if soaking is not None:
        return _soak(soaking)
    if growing:
        return _measure_growth(json)
    points = sorted(set(points or (QUICK_POINTS if quick else POINTS)))
    supports = sorted(set(supports or (QUICK_SUPPORTS if quick else SUPPORTS)))
    if unknown := set(supports) - set(GRIDS):
        raise typer.BadParameter(f"must be of {', '.join(map(str, GRIDS))}, got {min(unknown)}", param_hint="--supports")
    if plot.is_dir():
        raise typer.BadParameter(f"{plot}: is a folder; expected the name of a file to write")
    if not plot.parent.is_dir() and plot != DEFAULT_PLOT:
        raise typer.BadParameter(f"{plot}: its folder does not exist")
    if footprint_only:
        return _measure_alone("footprint", footprint, display.footprint_table, json)
    if view_only:
        return _measure_alone("view", view_cost, display.view_table, json)
    if planning_only:
        return _measure_planning(json)
    plot.parent.mkdir(exist_ok=True)
    start = time.monotonic()
    # without a thread that refreshes the bar: its CPU time would be counted for a contender
    with Progress(*COLUMNS, console=Console(stderr=True), auto_refresh=False) as bar:
        steps = (
            len(supports) * (len(points) + 1)
            + tracker.ROUNDS
            + (real_pushes.STEPS + prediction.STEPS) * (pushes is not None)
            + 4 * live
        )
        task = bar.add_task("", total=steps, completed=-1)

        def progress(what: str) -> None:
            bar.update(task, description=what, advance=1, refresh=True)

        measured = updates.measure(
            points, supports, QUICK_UPDATES if quick else UPDATES, QUICK_BUDGET if quick else BUDGET, progress
        )
        held = updates.memory(supports, QUICK_HELD if quick else HELD, progress)
        frames = tracker.measure(progress)
        accuracy = real_pushes.measure(pushes, progress) if pushes is not None else None
        predicted = prediction.measure(pushes, progress) if pushes is not None else None
        graph = {"pipeline": pipeline.measure(progress), "recording": recording.measure(progress)} if live else {}
        progress("done")
    rows = with_best_of_highs(measured["updates"])
    targets = list(verdicts(rows))
    console = Console(stderr=json == STDOUT)
    console.print(
        display.updates_table(rows),
        display.memory_table(held),
        display.verdict_table(targets, HIGHS_WARM),
        display.tracker_table(frames),
        *([display.accuracy_table(accuracy), display.learning_table(accuracy)] if accuracy is not None else []),
        *([display.prediction_table(predicted), display.stability_table(predicted)] if predicted is not None else []),
        *([display.live_table(graph)] if live else []),
        f"plot: {plot}",
        sep="\n",
    )
    display.plot(rows, plot)
    if json is not None:
        report = {
            "updates": rows,
            "bytes_per_data_point": held,
            "tracker": frames,
            **graph,
            **({"real_pushes": accuracy} if accuracy is not None else {}),
            **({"prediction": predicted} if predicted is not None else {}),
            "targets": [target._asdict() for target in targets],
            "disagreements": measured["disagreements"],
            "seconds": time.monotonic() - start,
            "versions": {"python": platform.python_version()} | {name: importlib.metadata.version(name) for name in LIBRARIES},
        }
        write_json(jsons.dumps(report, indent=1), json)
    for line in measured["disagreements"]:
        print(f"error: {line}", file=sys.stderr)
    return int(bool(measured["disagreements"]))


def _soak(minutes: float) -> int:
    with Progress(*COLUMNS, console=Console(stderr=True)) as bar:
        task = bar.add_task("", total=None)
        figures = soak.measure(minutes, lambda what: bar.update(task, description=what))
    Console().print(display.soak_table(figures))
    return int(not all(one.flat for one in figures["growth"]))


def _measure_growth(json: str | None) -> int:
    with Progress(*COLUMNS, console=Console(stderr=True)) as bar:
        task = bar.add_task("1 data point", total=len(growth.MARKS))
        rows = growth.measure(lambda what: bar.update(task, description=what, advance=1))
    Console(stderr=json == STDOUT).print(display.growth_table(rows))
    if json is not None:
        write_json(jsons.dumps({"growth": rows}, indent=1), json)
    return 0


def _measure_alone(name: str, section: Any, table: Callable[[Any], Table], json: str | None) -> int:
    """One section with targets of its own."""
    with Progress(*COLUMNS, console=Console(stderr=True)) as bar:
        task = bar.add_task("", total=section.STEPS, completed=-1)
        figures = section.measure(lambda what: bar.update(task, description=what, advance=1))
        bar.update(task, description="done", advance=1)
    targets = list(section.verdicts(figures))
    Console(stderr=json == STDOUT).print(table(figures), display.verdict_table(targets), sep="\n")
    if json is not None:
        report = {name: figures, "targets": [target._asdict() for target in targets]}
        write_json(jsons.dumps(report, indent=1), json)
    return 0


def _measure_planning(json: str | None) -> int:
    with Progress(*COLUMNS, console=Console(stderr=True)) as bar:
        task = bar.add_task("", total=planning.STEPS + 1, completed=-1)

        def progress(what: str) -> None:
            bar.update(task, description=what, advance=1)

        figures = planning.measure(progress) | {"services": services.measure(progress)}
        progress("done")
    targets = [*planning.verdicts(figures), *services.verdicts(figures["services"])]
    console = Console(stderr=json == STDOUT)
    tables = (display.strokes_table(figures), display.services_table(figures["services"]), display.verdict_table(targets))
    console.print(*tables, sep="\n")
    if json is not None:
        report = {"planning": figures, "targets": [target._asdict() for target in targets]}
        write_json(jsons.dumps(report, indent=1), json)
    return 0


def main() -> None:
    """Unusable input ends with one line and exit code 2. Contenders that disagree end with a line each and exit code 1."""
    try:
        sys.exit(app(prog_name="pushfric bench", standalone_mode=False))
    except InvalidInput as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except PushfricError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)
    except UsageError as error:
        print(f"error: {error.format_message().rstrip('.')}", file=sys.stderr)  # type: ignore[attr-defined]
        sys.exit(2)
    except (KeyboardInterrupt, typer.Abort):
        sys.exit(130)


if __name__ == "__main__":
    main()
