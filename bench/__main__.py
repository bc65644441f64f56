"""The command line of the benchmarks: runs the sections one after another and shows their figures."""

import importlib.metadata
import json as jsons
import pathlib
import platform
import sys
import time
from collections.abc import Mapping
from functools import partial
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))  # started as `python bench`, from any folder

from bench import footprint, pipeline, public_pushes, services, soak, updates
from bench.display import Verdict, plain_tables
from bench.observations import GRIDS
from bench.program import start
from pushfric_core.commands.application import STDOUT, Application, PlainCommand, spelled_out
from pushfric_core.commands.console import write_json
from pushfric_core.commands.options import RUNS, JsonOption
from pushfric_core.files.figure_file import check_image_name

FULL = ((50, 100, 1000, 10_000, 100_000), tuple(GRIDS), 200, 2.0, 10_000)
QUICK = ((50, 100, 1000), (24,), 40, 1.0, 1000)
"""Numbers of observations (M) and of support points (N); updates, their CPU time [s], and observations held in each cell."""

LIBRARIES = ("numpy", "scipy", "highspy")

app = Application(pretty_exceptions_enable=False)


class Bench(PlainCommand):
    """Takes `--json` with or without a file."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, spelled_out(args))


def _flag(name: str, text: str) -> Any:
    return Annotated[bool, typer.Option(f"--{name}", help=text)]


FOLDERS = "With --public: what `import` wrote."
SOAK = "Measure only whether the memory, threads and files of a running cell's nodes grow, for this long."
PUBLIC = "Measure only what the estimates are worth on public pushes; the figure goes to --plot, the table next to it."
PLANNING = "Measure only the answers of the planner node."
FOOTPRINT = "Measure only memory, start and end of the processes, next to a bare rclpy node: 2 minutes."


@app.command(cls=Bench)
def bench(
    folders: Annotated[list[pathlib.Path] | None, typer.Argument(metavar="FOLDER", help=FOLDERS, show_default=False)] = None,
    quick: _flag("quick", "Measure only a small part, in less than a minute.") = False,
    plot: Annotated[pathlib.Path, typer.Option(help="With --public: write the figure to this file.")] = RUNS / "bench.png",
    public: _flag("public", PUBLIC) = False,
    live: _flag("live", "Also measure image to estimate in the live graph, in real time: 2 minutes.") = False,
    footprint_only: _flag("footprint", FOOTPRINT) = False,
    planning_only: _flag("planning", PLANNING) = False,
    minutes: Annotated[float | None, typer.Option("--soak", help=SOAK, metavar="MINUTES", min=0, show_default=False)] = None,
    json: JsonOption = None,
) -> int:
    """Measure the CPU time of one new observation, in pushfric and in other solvers of the same program.

    Everything runs on one thread. A solver is left out ("-") if one solve takes more than 20 s of CPU time, or is expected to
    after its last M. All solvers take each observation in turn, so that a disturbance, even of the caches, affects all alike.
    """
    if folders and not public:
        raise typer.BadParameter("is for --public", param_hint="FOLDER")
    sections: dict[str, tuple[Any, ...]] = {}
    if minutes is not None:
        sections["soak"] = soak, minutes
    elif public:
        check_image_name(plot)
        sets = [one for folder in folders or () for one in public_pushes.sets_in(folder)]
        sections["public_pushes"] = public_pushes, sets, plot
    elif footprint_only:
        sections["footprint"] = (footprint,)
    elif planning_only:
        sections["services"] = (services,)
    else:
        sections[""] = updates, *(QUICK if quick else FULL)
        sections |= {"pipeline": (pipeline,)} if live else {}
    return _run(sections, json)


def _run(sections: Mapping[str, tuple[Any, ...]], json: str | None) -> int:
    """Measure sections one after another, show their figures, and write them.

    Args:
        sections: by name: a module with `measure`, perhaps `tables`, `verdicts` and `failures`; and what `measure` takes first.
        json: where to write them.
    """
    start = time.monotonic()
    report: dict[str, Any] = {}
    tables: list[Table] = []
    targets: list[Verdict] = []
    failures: list[str] = []
    columns = TextColumn("{task.description}"), TimeElapsedColumn()
    # without a thread that refreshes the line: its CPU time would be counted for a contender
    with Progress(*columns, console=Console(stderr=True), auto_refresh=False) as bar:
        task = bar.add_task("")
        for name, (module, *given) in sections.items():
            figures = module.measure(*given, lambda what: bar.update(task, description=what, refresh=True))
            report |= {name: figures} if name else figures
            tables += getattr(module, "tables", partial(plain_tables, name))(figures)
            targets += getattr(module, "verdicts", lambda _: ())(figures)
            failures += getattr(module, "failures", lambda _: ())(figures)
    if targets:
        tables += plain_tables("Targets", [target.row() for target in targets])
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
