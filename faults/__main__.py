"""The command `./pushfric faults`: runs the campaign and writes docs/reliability.md."""

import json
import os
import pathlib
import platform
import signal
import sys
import textwrap
import time
from typing import Annotated, Any

import typer

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))  # started as `python faults`, from any folder

from bench.program import start
from faults import quota
from faults.cases import CASES, QUICK, QUOTAS
from faults.cell_run import new_run
from faults.table import table
from pushfric_core import InvalidInput
from pushfric_core.commands.application import Application
from pushfric_ros.faults.fault import tried

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
) -> None:
    """Cause faults in running cells and judge what follows; writes docs/reliability.md. All faults take about an hour."""
    # a shell starts background jobs with SIGINT ignored, nohup with SIGHUP, and the runs would inherit that
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signal.signal(signal.SIGHUP, lambda *_: None)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    possible = CASES if quota.available() else [fault for fault in CASES if fault not in QUOTAS]
    chosen = [fault for fault in possible if only in fault.name and (fault.name in QUICK or not quick)]
    if not chosen:
        raise InvalidInput(f"--only {only}: no fault that can be caused here is named so; CPU quotas need control groups")
    loads, found = [], []
    for number, fault in enumerate(chosen, 1):
        outcome = tried(fault, new_run)
        found.append({"fault": fault.name, "asked": fault.must.asked, "tries": [outcome.to_dict()]})
        loads.append(os.getloadavg()[0])
        said = f"{outcome.found.get('seen')}; {outcome.problem or 'as asked'}{outcome.tried}"
        print(f"{number}/{len(chosen)} {fault.name}: {said}", file=sys.stderr, flush=True)
        if not (quick or only):
            told = {"circumstances": circumstances(found, loads), "faults": found}
            EVIDENCE.write_text(json.dumps(told, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
            DOCUMENT.write_text(page(), encoding="utf-8")
    if quick or only:
        print(table(found), end="")
    sys.exit(int(any(one["problem"] for fault in found for one in fault["tries"])))


def page() -> str:
    """The document, from the evidence."""
    found = json.loads(EVIDENCE.read_text(encoding="utf-8"))
    return f"{HEAD}{table(found['faults'])}\n{textwrap.fill(found['circumstances'], 120)}\n"


def circumstances(found: list[dict[str, Any]], loads: list[float]) -> str:
    """How a table was made: when, how busy the machine was, and what was left out."""
    load = f"load average {min(loads):.0f} to {max(loads):.0f}"
    machine = f"{os.cpu_count()} processors, Python {platform.python_version()}, {load}"
    tried_here = {one["fault"] for one in found}
    left_out = "; ".join(fault.name for fault in CASES if fault.name not in tried_here)
    which = f"Not tried: {left_out}." if left_out else "No fault was left out."
    return f"Each fault was tried once, on {time.strftime('%Y-%m-%d')}: {machine}. {which}"


if __name__ == "__main__":
    start(app, "./pushfric faults")
