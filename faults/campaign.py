"""Runs cases, judges what follows, and writes the table."""

import json
import pathlib
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from docs.markdown import table as markdown
from faults.camera import PLAN
from faults.cases import NODES, Case
from faults.cell_run import CellRun, demo

NODES_END = 60.0
"""The nodes of a command line that was killed end within this time [s]."""


VARYING = re.compile(rf"\d+(\.\d+)?(?= s after| more)|\b({'|'.join(NODES)})\b(?!'s)|(?<=camera: ).*")
"""In what faults that belong together differ."""

MANY = 12
"""More numbers are shown as the first and the last."""

TOLD = "the actuator was told to end"
"""Why the push of a run that ends otherwise is aborted."""


class Outcome(NamedTuple):
    """What followed a fault."""

    case: Case
    seen: str  # exit code and time
    message: str  # the line that says what happened
    problems: tuple[str, ...]  # how the outcome differs from what was asked


def attempt(case: Case) -> Outcome:
    """Run a cell, do what the case says, and judge what follows."""
    with tempfile.TemporaryDirectory(prefix="pushfric-faults-") as folder:
        here = pathlib.Path(folder)
        (plan := here / "plan.yaml").write_text(PLAN)
        options = ("--plan", str(plan)) if case.short else ()
        command = [sys.executable, "-m", "faults.camera", case.camera, folder] if case.camera else demo(here, *options)
        if case.through:
            command = [sys.executable, "-m", f"faults.{case.through}", *command]
        with CellRun(command, here) as run:
            try:
                return _outcome(case, run)
            except AssertionError as problem:
                seen = f"exit code {run.process.returncode}" if run.ended else "did not end"
                return Outcome(case, seen, _last(run.output), (_shortened(str(problem)),))


def _outcome(case: Case, run: CellRun) -> Outcome:
    if not (case.camera or case.at_once):
        run.wait_for_push()
    begin = time.monotonic()
    case.strike(run)
    if case.interrupt:
        run.wait_for_output(case.says)
        if not run.ended:
            run.process.send_signal(signal.SIGINT)
    code = run.wait_for_end()
    seconds = time.monotonic() - begin
    problems = list(_problems(case, run, code))
    return Outcome(case, f"exit code {code} after {seconds:.0f} s", _message(case, run.output), tuple(problems))


def _problems(case: Case, run: CellRun, code: int) -> Iterable[str]:
    if code not in case.codes:
        yield f"exit code {code}, expected one of {', '.join(map(str, case.codes))}"
    if not re.search(case.says, run.output):
        yield f"nothing said matches {case.says!r}"
    allowed = f"{case.aborts}|{TOLD}" if code else case.aborts
    for push, reason in re.findall(r"push (\d+) aborted: (.*)", run.output):
        if not re.search(allowed, reason):
            yield f"push {push} was aborted for another reason: {reason}"
    if "Traceback" in run.output:
        yield "a traceback"
    deadline = time.monotonic() + NODES_END
    while (alive := run.nodes_alive()) and time.monotonic() < deadline:
        time.sleep(0.1)
    if alive:
        yield f"left running: {', '.join(alive.values())}"
    if code == 1 and "error: " not in run.output:
        yield "exit code 1 without a line that says why"
    if not any(run.bag.glob("*.mcap")):
        return
    read = subprocess.run(
        [sys.executable, "-m", "pushfric_core", "estimate", str(run.bag), "--json"], capture_output=True, text=True
    )
    if "Traceback" in read.stderr:
        yield "the bag gives a traceback"
    if code == 0:
        if read.returncode:
            yield f"the bag of a run that ended well cannot be read: {read.stderr.strip()}"
        elif (live := re.findall(r"^push +\d+ +(\d+) observations", run.output, re.M)) and int(live[-1]) != (
            found := json.loads(read.stdout)["data_points"]
        ):
            yield f"the live estimate had {live[-1]} observations, the bag {found}, and the run ended with 0"


def _message(case: Case, output: str) -> str:
    """The line that matches, or the last one that is an error or a warning; why the first aborted push was; the last error."""
    lines = [line for line in output.splitlines() if case.says and re.search(case.says, line)]
    first = _shortened(lines[0]) if lines else _last(output)
    others = (re.findall(pattern, output, re.M) for pattern in (r"push \d+ aborted: .*", r"^error: .*"))
    found = [first]
    for line in (_shortened(lines[0]) for lines in others if lines):
        if line not in " ".join(found):
            found.append(line)
    return " ... ".join(found)


def _last(output: str) -> str:
    told = [line for line in output.splitlines() if re.search(r"error|WARN|ERROR|warning", line)]
    return _shortened(told[-1]) if told else ""


def _shortened(line: str) -> str:
    line = re.sub(r"\[(WARN|ERROR|INFO)\] \[[\d.]+\] ", "", line)
    line = re.sub(r"/\S*pushfric-(faults-)?\w+", "...", line)
    return line if len(line) <= 200 else line[:197] + "..."


def campaign(
    cases: Sequence[Case], times: int, say: Callable[[str], None], keep: Callable[[list[list[Outcome]]], None]
) -> list[list[Outcome]]:
    """The outcomes of each case, as often as it is tried; `keep` is called with all outcomes so far after each case."""
    outcomes: list[list[Outcome]] = []
    for number, case in enumerate(cases, 1):
        tried = [attempt(case) for _ in range(times)]
        outcomes.append(tried)
        keep(outcomes)
        problems = [problem for outcome in tried for problem in outcome.problems]
        say(f"{number}/{len(cases)} {case.fault}: {tried[-1].seen}; {'; '.join(problems) or 'as asked'}")
    return outcomes


def evidence(outcomes: Sequence[Sequence[Outcome]]) -> list[dict[str, Any]]:
    """What followed each fault in each try, as JSON."""
    return [
        {
            "fault": tried[0].case.fault,
            "asked": tried[0].case.asked,
            "tries": [{"seen": one.seen, "message": one.message, "problems": one.problems} for one in tried],
        }
        for tried in outcomes
    ]


def table(faults: Sequence[Mapping[str, Any]]) -> str:
    """A Markdown table with a row for all faults that must have the same outcome.

    Args:
        faults: from `evidence`.
    """
    rows = []
    for asked in dict.fromkeys(fault["asked"] for fault in faults):
        alike = [fault for fault in faults if fault["asked"] == asked]
        tries = [tried for fault in alike for tried in fault["tries"]]
        good = sum(not tried["problems"] for tried in tries)
        wrong = [f"; {problem}" for tried in tries for problem in tried["problems"]]
        rows.append((merged(fault["fault"] for fault in alike), asked, seen(tries) + "".join(wrong), f"{good} of {len(tries)}"))
    return markdown(("fault", "what follows", "seen", "as asked"), rows)


def merged(faults: Iterable[str]) -> str:
    """Faults in one cell; those that differ in a number, a node or the camera's image are written once."""
    groups: dict[str, list[str]] = {}
    for fault in faults:
        found = VARYING.search(fault)
        groups.setdefault(VARYING.sub("*", fault, count=1), []).append(found[0] if found else "")
    return "; ".join(text.replace("*", listed(values)) for text, values in groups.items())


def listed(values: Sequence[str]) -> str:
    """Values in a sentence; of many numbers the first and the last."""
    many = len(values) > MANY and values[0][:1].isdigit()
    return f"{values[0]} to {values[-1]}" if many else ", ".join(values)


def seen(tries: Sequence[Mapping[str, Any]]) -> str:
    """The exit codes of tries, and their times; what was seen if there is neither."""
    found = [re.fullmatch(r"exit code (-?\d+) after (\d+) s", tried["seen"]) for tried in tries]
    ended = [(int(one[1]), int(one[2])) for one in found if one]
    if not ended or len(ended) < len(tries):
        return "; ".join(tried["seen"] for tried in tries)
    codes, times = sorted({code for code, _ in ended}), sorted(time for _, time in ended)
    span = f"{times[0]} to {times[-1]}" if times[0] < times[-1] else f"{times[0]}"
    return f"exit code {' or '.join(map(str, codes))} after {span} s"
