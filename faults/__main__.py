"""The command `./pushfric faults`: runs the campaign and writes docs/reliability.md."""

import json
import os
import pathlib
import platform
import signal
import sys
import textwrap
import time
from typing import Annotated

import typer

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))  # started as `python faults`, from any folder

from faults.campaign import Outcome, campaign, evidence, table
from faults.cases import CASES
from pushfric_core.commands.application import Application
from pushfric_core.commands.cli import main as carried_out
from pushfric_core.commands.program import run

DOCUMENT = pathlib.Path(__file__).resolve().parents[1] / "docs/reliability.md"

EVIDENCE = DOCUMENT.with_suffix(".json")

HEAD = """\
# What faults do to a run

Written by `./pushfric faults` from [reliability.json](reliability.json), which has every try with its message;
do not edit.

Each fault is caused in a running cell of real processes with a simulated camera and controller. In every case, no process may
be left, no traceback printed, the bag must be readable or refused in one line, and a run that ends with 0 must have the
estimate of its bag. Faults of the pusher are in [safety.md](safety.md).

"""

app = Application()


@app.command()
def main(
    quick: Annotated[bool, typer.Option("--quick", help="Only a few cases, in about a minute; writes nothing.")] = False,
    only: Annotated[str, typer.Option(help="Only faults whose name contains this; writes nothing.")] = "",
    times: Annotated[int, typer.Option(help="How often each fault is tried.", min=1)] = 1,
) -> None:
    """Cause faults in running cells and judge what follows; writes docs/reliability.md. All faults take about an hour."""
    # a shell starts background jobs with SIGINT ignored, and the runs would inherit that
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    cases = [case for case in CASES if only in case.fault and (case.quick or not quick)]
    loads: list[float] = []

    def keep(outcomes: list[list[Outcome]]) -> None:
        loads.append(os.getloadavg()[0])
        if not (quick or only):
            found = {"circumstances": circumstances(outcomes, loads), "faults": evidence(outcomes)}
            EVIDENCE.write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
            DOCUMENT.write_text(page(), encoding="utf-8")

    outcomes = campaign(cases, times, lambda line: print(line, file=sys.stderr, flush=True), keep)
    if quick or only:
        print(table(evidence(outcomes)), end="")
    sys.exit(int(any(outcome.problems for tried in outcomes for outcome in tried)))


def page() -> str:
    """The document, from the evidence."""
    found = json.loads(EVIDENCE.read_text(encoding="utf-8"))
    how = textwrap.fill(found["circumstances"], 120)
    return f"{HEAD}{table(found['faults'])}\n{how}\n"


def circumstances(outcomes: list[list[Outcome]], loads: list[float]) -> str:
    """How a table was made: when, how busy the machine was, and what was left out."""
    tried = [tries[0].case.fault for tries in outcomes]
    load = f"{min(loads):.0f} to {max(loads):.0f}" if loads else "unknown"
    times = len(outcomes[0])
    how_often = "once" if times == 1 else f"{times} times"
    machine = f"{os.cpu_count()} processors, Python {platform.python_version()}, load average {load}"
    said = f"Each fault was tried {how_often}, on {time.strftime('%Y-%m-%d')}: {machine}."
    left_out = [case.fault for case in CASES if case.fault not in tried]
    return f"{said} Not tried: {'; '.join(left_out)}." if left_out else f"{said} No fault was left out."


if __name__ == "__main__":
    run(lambda: carried_out(app, "./pushfric faults"))
