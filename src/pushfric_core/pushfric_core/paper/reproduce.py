"""`pushfric reproduce`: runs the paper's experiments for many seeds in parallel, and writes tables.json and an HTML report."""

import json
import pathlib
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_core.files.whole_file import make_folder, write_whole
from pushfric_core.offline import workers
from pushfric_core.paper.claims import claims
from pushfric_core.paper.experiments import CODE, rods, run_seed
from pushfric_core.paper.figures import figures
from pushfric_core.paper.html_report import html_report
from pushfric_core.paper.tables import Nested, tables
from pushfric_core.report.report import to_json


class WorkerDiffers(PushfricError):
    """A worker of the cluster runs another version of the code than this machine."""


def reproduce(out: pathlib.Path, seeds: int, jobs: int, dask: str | None, console: Console) -> tuple[Nested, pathlib.Path]:
    """Run the experiments of the seeds 0, 1 ... that `out` does not hold yet, and write the report on all seeds.

    Args:
        out: folder; its `seeds` keeps the result of each seed, to be used again while the code is the same.
        seeds: number of seeds.
        jobs: processes on this machine; -1: one for each core.
        dask: address of the scheduler of a Dask cluster to use instead; None: this machine.
        console: for the progress bar.
    Returns:
        The tables, and the path of the report.
    Raises:
        InvalidInput: the folder cannot be written, an earlier result in it cannot be read, or no cluster answers.
        WorkerDiffers: a worker of the cluster runs other code than this machine.
    """
    for folder in (out, out / "seeds", out / "figures"):
        make_folder(folder)
    kept = {seed: found for seed in range(seeds) if (found := _kept(out, seed))}
    results = {seed: found for seed, found in kept.items() if found["code"] == CODE}
    if len(results) < len(kept):
        console.print(f"{out}: seeds from other code, computed again: {len(kept) - len(results)}", markup=False)
    missing = [seed for seed in range(seeds) if seed not in results]
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("seeds", total=seeds, completed=len(results))
        for result in workers.results(run_seed, missing, jobs, dask):
            if result["code"] != CODE:
                raise WorkerDiffers(f"the worker of seed {result['seed']} runs another version of pushfric; update it")
            _keep(out, result)
            results[result["seed"]] = result
            progress.advance(task)
    rod_numbers, rod_drawings = rods()
    numbers = [{**results[seed]["numbers"], "figure12": rod_numbers} for seed in range(seeds)]
    claimed = claims(numbers)
    summary = {"seeds": seeds, "code": CODE, "claims": [claim._asdict() for claim in claimed], **tables(numbers)}
    write_whole(out / "tables.json", f"{to_json(summary)}\n")
    drawn = figures(summary, [results[seed] for seed in range(seeds)], rod_drawings)
    for name, content in drawn.items():
        write_whole(out / "figures" / name, content)
    report = out / "report.html"
    shown = {name.removesuffix(".svg"): content.decode() for name, content in drawn.items() if name.endswith(".svg")}
    write_whole(report, html_report(summary, claimed, shown))
    return summary, report


def _path(out: pathlib.Path, seed: int) -> pathlib.Path:
    return out / "seeds" / f"{seed:04}.json"


def _kept(out: pathlib.Path, seed: int) -> dict[str, Any] | None:
    """The result of a seed from an earlier call, with any version of the code; None if there is no result."""
    path = _path(out, seed)
    if not path.exists():
        return None
    try:
        result: dict[str, Any] = json.loads(path.read_text())
        if (result["seed"], type(result["code"])) != (seed, str):
            raise ValueError(f"it is not the result of seed {seed}")
    except OSError as error:
        raise InvalidInput(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise InvalidInput(f"{path}: cannot be read: {error}; remove it to have it computed again") from error
    return result


def _keep(out: pathlib.Path, result: dict[str, Any]) -> None:
    # json.dumps keeps infinite numbers; to_json, which is for readers in any language, turns them into strings
    write_whole(_path(out, result["seed"]), json.dumps(result))
