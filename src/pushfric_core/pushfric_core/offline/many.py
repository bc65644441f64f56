"""Estimates from many bags and CSVs: a bad input does not stop the others, and an interrupted run goes on where it stopped.

Every finished input adds one line of JSON to `results.jsonl`, from which the table follows, and a model.
"""

import csv
import dataclasses
import hashlib
import io
import json
import multiprocessing
import os
import pathlib
import signal
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from typing import Any, TypeVar

from pushfric_core import __version__
from pushfric_core.bags.recorded import bags_in, beside, is_bag, is_csv
from pushfric_core.errors import InvalidInput, PushfricError, blaming
from pushfric_core.files.disk import write_whole, writing
from pushfric_core.files.model_file import save_model
from pushfric_core.files.object_file import OBJECT_FILE, PRIOR_FILE
from pushfric_core.offline.estimation import Choices, estimate_from
from pushfric_core.records import to_json

RESULTS, MODELS, TABLE = "results.jsonl", "models", "table.csv"
"""Names in the folder of the results."""

Line = dict[str, Any]
"""Keys of an input's result: `input`, `fingerprint`, `warnings`; then `error`, or the keys of `estimate --json`, `doubts` and
`model`; at last `checksum`."""

FORMAT = 4
"""Lines of another format are made again."""


COLUMNS = (
    "input", "object", "status", "use", "error", "reasons", "p_cf_x", "p_cf_y", "var_x", "var_y", "cov_xy",
    "mu_c", "mu_c_low", "mu_c_high", "mu_c_kind", "mu_c_p90", "mu_c_max", "total_friction", "objective", "gap",
    "data_points", "pushes", "warnings", "model",
)  # fmt: skip
"""Those of the table; SI units, object frame."""


def inputs_of(sources: Iterable[pathlib.Path]) -> list[pathlib.Path]:
    """Bags and CSVs, with all bags and CSVs of a folder in place of the folder; absolute paths, each once, in order."""
    return list(dict.fromkeys(found.absolute() for source in sources for found in (_content_of(source) or [source])))


def _content_of(folder: pathlib.Path) -> list[pathlib.Path]:
    return sorted([*bags_in(folder), *filter(is_csv, folder.iterdir())]) if folder.is_dir() and not is_bag(folder) else []


def estimate_many(
    inputs: Sequence[pathlib.Path],
    choices: Choices,
    out: pathlib.Path,
    jobs: int,
    dask: str | None,
    finished: Callable[[Line], None],
) -> list[Line]:
    """The lines of all inputs, in order; inputs whose lines are already in `results.jsonl` are not estimated again.

    Args:
        inputs: bags and CSVs.
        choices: what the caller chose, the same for every input, but a bag with an object of its own keeps that; paths in it
            are absolute.
        out: folder for the lines and models; created if it does not exist.
        jobs: processes on this machine; -1: one for each core.
        dask: address of the scheduler of a Dask cluster, whose workers see the same files; None: this machine.
        finished: called with each line as it comes, first with those of an earlier run.
    Raises:
        InvalidInput: the folder cannot be written, or no cluster answers.
        WorkerKilled: a process was killed; the lines up to then are in the folder.
    """
    with writing(out):
        (out / MODELS).mkdir(parents=True, exist_ok=True)
        lines = _earlier(out / RESULTS, {str(path): fingerprint(path, choices) for path in inputs})
        for line in lines.values():
            finished(line)
        missing = [path for path in inputs if str(path) not in lines]
        work = partial(_line_of, choices=choices, out=out.absolute())
        with (out / RESULTS).open("a", encoding="utf-8") as stream:
            if (out / RESULTS).read_bytes()[-1:] not in (b"", b"\n"):  # an interrupted run leaves half a line
                stream.write("\n")
            for text in results(work, missing, jobs, dask):
                stream.write(f"{text}\n")
                stream.flush()
                line = json.loads(text)
                lines[line["input"]] = line
                finished(line)
    return [lines[str(path)] for path in inputs]


def objections(line: Line) -> list[dict[str, Any]]:
    """Reasons why the estimate of a line is not to be used, with codes and texts, and what does not add up in its input."""
    return [*line["belief"]["verdict"]["reasons"], *line["doubts"]]


def counts(lines: Sequence[Line]) -> dict[str, int]:
    """How many inputs there are, and what became of them."""
    use = Counter(None if "error" in line else not objections(line) for line in lines)
    return {"inputs": len(lines), "usable": use[True], "not_usable": use[False], "broken": use[None]}


def write_table(lines: Sequence[Line], folder: pathlib.Path) -> pathlib.Path:
    """Write the table of many estimates; return the file."""
    table = csv.DictWriter(content := io.StringIO(), COLUMNS)
    table.writeheader()
    table.writerows(map(_table_row, lines))
    write_whole(folder / TABLE, content.getvalue().encode(errors="backslashreplace"))
    return folder / TABLE


def _table_row(line: Line) -> Line:
    row = {name: line[name] for name in COLUMNS if name in line}
    row["warnings"] = len(line["warnings"])
    if "belief" in line:
        row["use"], row["reasons"] = not objections(line), " ".join(one["code"] for one in objections(line))
        # p_CF is the program's if the pushes do not show how far it is off
        row["p_cf_x"], row["p_cf_y"] = line["belief"].get("center_of_friction", line["center_of_friction"])
        mu_c, bounds, unknown = line["belief"].get("mu_c", {}), line["mu_c"], (None, None)
        (row["var_x"], row["cov_xy"]), (_, row["var_y"]) = line["belief"].get("covariance", (unknown, unknown))
        row["mu_c"], (row["mu_c_low"], row["mu_c_high"]) = mu_c.get("value"), mu_c.get("interval", unknown)
        row |= {"mu_c_kind": mu_c.get("kind"), "mu_c_p90": bounds["p90"], "mu_c_max": bounds["max"]}
    return row


def model_of(path: pathlib.Path) -> pathlib.Path:
    """Where the model of an input goes, in the folder of the results: its name, and a few digits of its absolute path."""
    return pathlib.Path(MODELS, f"{path.name}-{hashlib.sha256(os.fsencode(path)).hexdigest()[:8]}.yaml")


def fingerprint(path: pathlib.Path, choices: Choices) -> str:
    """Changes with the input, with what was chosen for it, and with the version of pushfric."""
    named = [pathlib.Path(choices.object_name), choices.support_points, beside(path, OBJECT_FILE), beside(path, PRIOR_FILE)]
    files = [file for file in named if file is not None and file.is_file()]
    files += sorted(path.rglob("*")) if path.is_dir() else [path]
    parts: list[Any] = [__version__, FORMAT, dataclasses.asdict(choices)]
    for file in files:
        if file.is_file():
            stat = file.stat()
            parts.append((str(file), stat.st_size, stat.st_mtime_ns))
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:16]


def _earlier(file: pathlib.Path, wanted: dict[str, str]) -> dict[str, Line]:
    """The lines of an earlier run that are still valid, by input; the last one of each counts.

    What failed is tried again: the reason may have been the disk, the memory or a package, and lie in no input.
    """
    lines: dict[str, Line] = {}
    written = file.read_text(encoding="utf-8", errors="replace") if file.exists() else ""
    for text in written.splitlines():
        try:
            line = json.loads(text)
        except (ValueError, RecursionError):
            continue  # an interrupted run leaves half a line
        usable = isinstance(line, dict) and isinstance(line.get("input"), str) and "error" not in line
        usable = usable and wanted.get(line["input"], "") == line.get("fingerprint") and line.get("checksum") == _checksum(line)
        if usable and (file.parent / line.get("model", "")).exists():
            lines[line["input"]] = line
    return lines


def _checksum(line: Line) -> str:
    """Checksum of all that a line says besides; it shows whether somebody, or a failing disk, has changed it."""
    said = {key: value for key, value in line.items() if key != "checksum"}
    return hashlib.sha256(to_json(said).encode()).hexdigest()[:16]


def _line_of(path: pathlib.Path, choices: Choices, out: pathlib.Path) -> str:
    """Estimate one input and write its model; return its line as JSON, which holds whatever went wrong."""
    warnings: list[str] = []
    line: Line = {"input": str(path), "fingerprint": fingerprint(path, choices), "warnings": warnings}
    try:
        if path.exists() and not path.is_file() and not path.is_dir():  # reading a pipe might never end
            raise InvalidInput(f"{path}: is a pipe or a device; expected a bag or a CSV of observations")
        own = beside(path, OBJECT_FILE) is not None
        estimation = estimate_from(path, dataclasses.replace(choices, object_name="") if own else choices, warnings.append)
        line |= estimation.figures()
        line["doubts"] = [] if choices.partial else [one._asdict() for one in estimation.ledger.doubts]
        if estimation.result.contradiction is None:
            save_model(estimation.to_model(), out / model_of(path))
            line["model"] = str(model_of(path))
    except PushfricError as error:
        line["error"] = str(error)
    except Exception as error:  # noqa: BLE001 - a fault of ours must not stop the other inputs; its traceback is reported
        line["error"] = f"{type(error).__name__}: {error}"
        line["traceback"] = traceback.format_exc()
    return to_json({**line, "checksum": _checksum(line)})


DASK_TIMEOUT = "10s"
"""How long the scheduler of a Dask cluster may take to answer (a duration in Dask's notation)."""

Argument = TypeVar("Argument")
Result = TypeVar("Result")


class WorkerKilled(PushfricError):
    """A worker process was killed."""


def results(work: Callable[[Argument], Result], arguments: Iterable[Argument], jobs: int, dask: str | None) -> Iterator[Result]:
    """The result of `work` for each argument, in order of completion.

    Args:
        work: the function.
        arguments: one for each call.
        jobs: processes on this machine; -1: one for each core.
        dask: address of the scheduler of a Dask cluster to use instead; None: this machine.
    Raises:
        InvalidInput: no cluster answers.
        WorkerKilled: a process of this machine was killed.
    """
    yield from _on_cluster(work, arguments, dask) if dask else _on_this_machine(work, arguments, jobs)


def _on_this_machine(work: Callable[[Argument], Result], arguments: Iterable[Argument], jobs: int) -> Iterator[Result]:
    if jobs == 1:
        yield from map(work, arguments)
        return
    processes = len(os.sched_getaffinity(0)) if jobs < 0 else jobs
    # started from nothing: a fork would copy locks that the threads of this process may hold
    pool = ProcessPoolExecutor(processes, multiprocessing.get_context("spawn"), _end_with, (os.getpid(),))
    try:
        # this process ends the workers on Ctrl-C; they inherit the mask of a thread, and only the main thread is interrupted
        with ThreadPoolExecutor(1, "starter", signal.pthread_sigmask, (signal.SIG_BLOCK, {signal.SIGINT})) as starter:
            futures = starter.submit(lambda: [pool.submit(work, argument) for argument in arguments]).result()
        for future in as_completed(futures):
            yield future.result()
    except BrokenProcessPool as error:
        raise WorkerKilled("a worker process was killed; perhaps memory ran out: try fewer --jobs") from error
    finally:
        pool.shutdown(cancel_futures=True)


def _end_with(parent: int) -> None:
    """Let this worker process end with its parent, even if the parent is killed."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1)
        os._exit(1)

    threading.Thread(target=watch, name="end with the parent", daemon=True).start()


def _on_cluster(work: Callable[[Argument], Result], arguments: Iterable[Argument], address: str) -> Iterator[Result]:
    # imported late: it takes a second, for which a run without a cluster should not wait
    import distributed

    with blaming(f"--dask: no scheduler answers at {address}", OSError, ValueError):
        client = distributed.Client(address, timeout=DASK_TIMEOUT)
    with client:
        futures = client.map(work, list(arguments), pure=False)
        for _, result in distributed.as_completed(futures, with_results=True):
            yield result
