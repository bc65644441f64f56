"""The command `./pushfric faults`: runs the campaign and writes docs/reliability.md."""

import os
import pathlib
import signal
import sys
from typing import Annotated

import typer

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))  # started as `python faults`, from any folder

from faults.campaign import campaign, table
from faults.cases import CASES

DOCUMENT = pathlib.Path(__file__).resolve().parents[1] / "docs/reliability.md"

HEAD = """\
# What faults do to a run

Written by `./pushfric faults`; do not edit. Each row is a fault that is done to a running cell, with real processes, a
simulated camera and a simulated controller: what must follow, and what did. In every case, no process may be left, no traceback
printed, the bag must be readable or refused in one line, and a run that ends with 0 must have the same estimate as its bag. The
faults of the pusher are in [safety.md](safety.md), those of files in [files.md](files.md). `n of m` counts the tries in which
all was as asked.

"""

app = typer.Typer(add_completion=False)


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
    outcomes = campaign(cases, times, lambda line: print(line, file=sys.stderr, flush=True))
    if quick or only:
        print(table(outcomes))
    else:
        DOCUMENT.write_text(HEAD + table(outcomes) + "\n")
    sys.exit(int(any(outcome.problems for tried in outcomes for outcome in tried)))


if __name__ == "__main__":
    app(prog_name="pushfric faults")
