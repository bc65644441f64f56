"""The command `rehearse`."""

import sys
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from pushfric_core.commands.application import Application
from pushfric_core.commands.cell_options import FASTEST_STROKE, LONGEST_STROKE
from pushfric_core.commands.console import console, warn
from pushfric_core.commands.json_option import STDOUT, JsonOption, write_json
from pushfric_core.commands.options import in_range
from pushfric_core.commands.settings_options import option
from pushfric_core.errors import InvalidInput
from pushfric_core.plausible import check_within
from pushfric_core.pushers.grbl_settings import GrblSettings
from pushfric_core.report.report import to_json
from pushfric_ros.rehearsal.faults import FAULTS, Outcome, rehearse
from pushfric_ros.rehearsal.random_faults import KINDS, damages
from pushfric_ros.rehearsal.random_faults import kills as killed
from pushfric_ros.rehearsal.stage import Rehearsed, Stage

app = Application()


@app.command("rehearse")
def rehearsal(
    port: Annotated[str, typer.Option(help="Serial port of the GRBL controller.", show_default=False)],
    stroke: Annotated[
        float | None,
        typer.Option(
            help="How far the pusher may go forward from where it stands [m].",
            **in_range(0.001, LONGEST_STROKE, "m"),
            show_default="asked for",
        ),
    ] = None,
    speed: Annotated[float, typer.Option(help="Speed of the pushes [m/s].", **in_range(0.001, FASTEST_STROKE, "m/s"))] = 0.02,
    axis: Annotated[str, typer.Option(help="Axis of the controller; -X: the stroke goes to negative coordinates.")] = "X",
    baud: Annotated[int, typer.Option(help="Speed of the port [bit/s].", min=300, max=4_000_000)] = 115200,
    silence: Annotated[float, option(GrblSettings, "silence")] = GrblSettings.silence,
    kills: Annotated[
        int, typer.Option(help="Instead: kill -9 the host's processes this many times, at random moments.", min=0, max=100_000)
    ] = 0,
    damage: Annotated[
        int, typer.Option(help="Instead: make this many pushes on a line that is damaged at random.", min=0, max=100_000)
    ] = 0,
    seed: Annotated[int, typer.Option(help="Seed of --kills and --damage.", min=0, max=2**31)] = 0,
    json: JsonOption = None,
) -> None:
    """The faults come in mid-push, one after the other; the command measures when and where the pusher stops.

    Take the object away, bring the tip to the beginning of its stroke, and keep a hand on the emergency stop. The pusher moves
    between where it stands and the end of the stroke that you allow. At the end it is back there, and the controller has its
    old settings.

    A faulty line stands between the actuator and the controller: it loses, changes and delays bytes. Everything is measured by
    what the controller itself reports. Ctrl-C stops the pusher where it is.

    Exit code 1: a fault did not end as it must.
    """
    try:
        GrblSettings(port=port, baud=baud, axis=axis, silence=silence)
    except ValueError as error:
        raise InvalidInput(f"--{error}") from error
    if kills and damage:
        raise InvalidInput("--kills and --damage are two campaigns: give one of them")
    if stroke is None:
        if not sys.stdin.isatty():
            raise InvalidInput("--stroke is missing: how far the pusher may go forward from where it stands [m]")
        stroke = typer.prompt("The pusher will move. How far may it go forward from where it stands [m]?", type=float, err=True)
        try:
            check_within("the stroke", (stroke,), LONGEST_STROKE, "m")
        except ValueError as error:
            raise InvalidInput(str(error)) from error
    outcomes: list[Outcome] = []
    with Stage(Rehearsed(port, baud, axis, stroke, speed, silence), warn) as stage:
        console.print(
            f"strokes of {1e3 * stage.reach:.1f} mm at {1e3 * speed:g} mm/s; Ctrl-C stops the pusher", highlight=False
        )
        faults = killed(kills, seed) if kills else damages(damage, seed) if damage else FAULTS
        for outcome in rehearse(stage, faults):
            outcomes.append(outcome)
            console.print(line(outcome), highlight=False, markup=False)
        changed = stage.bring_back()
    for what in changed:
        warn(f"not as it was: {what}")
    write_json(to_json({"outcomes": [outcome._asdict() for outcome in outcomes], "changed": changed}), json)
    if json != STDOUT:
        Console().print(distribution(outcomes) if kills else table(outcomes))
    if changed or any(outcome.problem for outcome in outcomes):
        sys.exit(1)


def line(outcome: Outcome) -> str:
    """The result of a fault, as a line of text."""
    result = outcome.problem or "as it must be"
    if outcome.travelled is None or outcome.seconds is None:
        return f"{outcome.fault}: {result}"
    return f"{outcome.fault}: {result}, {1e3 * outcome.travelled:.2f} mm in {outcome.seconds:.2f} s"


def table(outcomes: list[Outcome]) -> Table:
    """A row for each fault."""
    shown = Table(box=None)
    for column in ("fault", "rests after", "travelled", "allowed", ""):
        shown.add_column(column, justify="left" if column in ("fault", "") else "right")
    for outcome in outcomes:
        seconds = "" if outcome.seconds is None else f"{outcome.seconds:.2f} s"
        lengths = ["" if way is None else f"{1e3 * way:.1f} mm" for way in (outcome.travelled, outcome.allowed)]
        shown.add_row(outcome.fault, seconds, *lengths, outcome.problem or "ok")
    return shown


def distribution(outcomes: list[Outcome]) -> Table:
    """How far the pusher went after a kill, for each kind of process."""
    shown = Table(box=None)
    for column in ("killed", "times", "median", "90 %", "farthest", "allowed", "failed"):
        shown.add_column(column, justify="left" if column == "killed" else "right")
    for kind in KINDS:
        ours = [outcome for outcome in outcomes if outcome.fault == kind]
        ways = sorted(outcome.travelled for outcome in ours if outcome.travelled is not None)
        if ways:
            chosen = (ways[len(ways) // 2], ways[(9 * len(ways)) // 10], ways[-1], ours[0].allowed or 0.0)
            shown.add_row(kind, str(len(ours)), *(f"{1e3 * way:.2f} mm" for way in chosen), str(sum(map(failed, ours))))
    return shown


def failed(outcome: Outcome) -> bool:
    """Whether a fault did not end as it must."""
    return outcome.problem is not None
