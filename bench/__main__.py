"""The command line of the benchmarks: runs the sections one after another and shows their figures."""

import importlib.metadata
import json as jsons
import pathlib
import platform
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Annotated, Any, NamedTuple

import typer
from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))  # started as `python bench`, from any folder

from bench import (
    costs,
    footprint,
    pipeline,
    planning,
    public_pushes,
    services,
    simulators,
    soak,
    updates,
)
from bench.display import Verdict, plain_tables, verdict_table
from bench.observations import GRIDS
from bench.program import start
from pushfric_core.commands.application import STDOUT, Application, PlainCommand, spelled_out
from pushfric_core.commands.console import write_json
from pushfric_core.commands.options import RUNS, JsonOption
from pushfric_core.files.figure_file import check_image_name

POINTS, SUPPORTS, UPDATES, BUDGET, HELD = (50, 100, 1000, 10_000, 100_000), tuple(GRIDS), 200, 2.0, 10_000
QUICK_POINTS, QUICK_SUPPORTS, QUICK_UPDATES, QUICK_BUDGET, QUICK_HELD = (50, 100, 1000), (24,), 40, 1.0, 1000

LIBRARIES = ("numpy", "scipy", "osqp", "highspy", "cvxpy", "clarabel")

COLUMNS = (TextColumn("{task.description}"), MofNCompleteColumn(), TimeElapsedColumn())

app = Application(pretty_exceptions_enable=False)


class Section(NamedTuple):
    """A part of the benchmarks."""

    name: str  # of its figures in the JSON
    steps: int | None  # how often `measure` says what comes next; None: unknown
    measure: Callable[[Callable[[str], None]], Any]
    tables: Callable[[Any], Iterable[Table]]
    verdicts: Callable[[Any], Iterable[Verdict]] = lambda figures: ()
    failures: Callable[[Any], Sequence[str]] = lambda figures: ()  # a line for each; any is exit code 1

    @classmethod
    def of(cls, name: str, module: Any, *arguments: Any) -> "Section":
        """The section of a module: its STEPS and measure, and what it has of tables, verdicts and failures."""
        section = cls(name, getattr(module, "STEPS", None), partial(module.measure, *arguments), partial(plain_tables, name))
        return section._replace(**{key: getattr(module, key) for key in cls._fields[3:] if hasattr(module, key)})


COSTS, FOOTPRINT, PLANNING = (costs,), (footprint,), (planning, services, simulators)
"""What is measured instead of all else."""


class Bench(PlainCommand):
    """Takes `--json` with or without a file."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, _each_named(spelled_out(args)))


def _each_named(arguments: Sequence[str], option: str = "--public") -> list[str]:
    """Arguments in which this option stands before each of the values that follow it."""
    named: list[str] = []
    listing = False
    for one in arguments:
        if one == option or one.startswith("-"):
            listing = one == option
        named += [option, one] if listing and one != option else [] if listing else [one]
    return named


@app.command(cls=Bench)
def bench(
    points: Annotated[
        list[int] | None,
        typer.Option(help="Number of earlier observations (M); repeatable.", min=1, max=1_000_000, show_default="50 to 100000"),
    ] = None,
    supports: Annotated[
        list[int] | None,
        typer.Option(
            help=f"Number of support points (N), one of {', '.join(map(str, GRIDS))}; repeatable.", show_default="all"
        ),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Measure only a small part, in less than a minute.")] = False,
    plot: Annotated[pathlib.Path, typer.Option(help="With --public: write the figure to this file.")] = RUNS / "bench.png",
    public: Annotated[
        list[pathlib.Path] | None,
        typer.Option(
            help="Measure only what the estimates are worth on public pushes: folders that `import` wrote. The figure"
            " goes to --plot, the table next to it.",
            metavar="FOLDER...",
            show_default=False,
        ),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="Also measure image to estimate in the live graph, in real time: 2 minutes.")
    ] = False,
    footprint_only: Annotated[
        bool,
        typer.Option(
            "--footprint", help="Measure only memory, start and end of the processes, next to a bare rclpy node: 2 minutes."
        ),
    ] = False,
    costs_only: Annotated[
        bool,
        typer.Option(
            "--costs",
            help="Measure only where the milliseconds and the megabytes go, and write the tables of docs/graph.md and"
            " docs/estimation.md: 2 minutes.",
        ),
    ] = False,
    planning_only: Annotated[
        bool,
        typer.Option(
            "--planning",
            help="Measure only what planners get: strokes, predictions, answers of the planner node, MuJoCo: 10 minutes.",
        ),
    ] = False,
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
    """Measure the CPU time of one new observation, in pushfric and in other solvers of the same program.

    Everything runs on one thread. A solver is left out ("-") if one solve takes more than 20 s of CPU time, or is expected to
    after its last M. All solvers take each observation in turn, so that a disturbance, even of the caches, affects all alike.
    """
    if soaking is not None:
        return _run([Section.of("soak", soak, soaking)], json)
    points = sorted(set(points or (QUICK_POINTS if quick else POINTS)))
    supports = sorted(set(supports or (QUICK_SUPPORTS if quick else SUPPORTS)))
    if unknown := set(supports) - set(GRIDS):
        raise typer.BadParameter(f"must be of {', '.join(map(str, GRIDS))}, got {min(unknown)}", param_hint="--supports")
    if public:
        check_image_name(plot)
        sets = [one for folder in public for one in public_pushes.sets_in(folder)]
        return _run([Section.of("public_pushes", public_pushes, sets, plot)], json)
    for alone, asked in ((COSTS, costs_only), (FOOTPRINT, footprint_only), (PLANNING, planning_only)):
        if asked:
            return _run([Section.of(module.__name__.rpartition(".")[2], module) for module in alone], json)
    count, budget, held = (QUICK_UPDATES, QUICK_BUDGET, QUICK_HELD) if quick else (UPDATES, BUDGET, HELD)
    cost = Section.of("", updates, points, supports, count, budget, held)
    sections = [cost._replace(steps=len(supports) * (len(points) + 1))]
    return _run(sections + [Section.of("pipeline", pipeline)] * live, json)


def _run(sections: Sequence[Section], json: str | None) -> int:
    """Measure the sections one after another, show their figures, and write them."""
    start = time.monotonic()
    steps = None if any(section.steps is None for section in sections) else sum(section.steps or 0 for section in sections)
    report: dict[str, Any] = {}
    tables: list[Table] = []
    targets: list[Verdict] = []
    failures: list[str] = []
    # without a thread that refreshes the bar: its CPU time would be counted for a contender
    with Progress(*COLUMNS, console=Console(stderr=True), auto_refresh=False) as bar:
        task = bar.add_task("", total=steps, completed=-1)
        for section in sections:
            figures = section.measure(lambda what: bar.update(task, description=what, advance=1, refresh=True))
            report |= {section.name: figures} if section.name else figures
            tables += section.tables(figures)
            targets += section.verdicts(figures)
            failures += section.failures(figures)
        bar.update(task, description="done", advance=1, refresh=True)
    if targets:
        tables.append(verdict_table(targets))
    Console(stderr=json == STDOUT).print(*tables, sep="\n")
    if json is not None:
        report |= {
            "targets": [target._asdict() for target in targets],
            "seconds": time.monotonic() - start,
            "versions": {"python": platform.python_version()} | {name: importlib.metadata.version(name) for name in LIBRARIES},
        }
        write_json(jsons.dumps(report, indent=1), json)
    for line in failures:
        print(f"error: {line}", file=sys.stderr)
    return int(bool(failures))


if __name__ == "__main__":
    start(app, "./pushfric bench")
