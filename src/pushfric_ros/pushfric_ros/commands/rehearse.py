"""The command `rehearse`."""

import sys
from collections.abc import Iterator
from typing import Annotated

import typer
import yaml
from rich.console import Console
from rich.table import Table

from pushfric_core.commands.application import STDOUT, Application, in_range
from pushfric_core.commands.cell_options import FASTEST_STROKE, LONGEST_STROKE
from pushfric_core.commands.console import console, warn, write_json
from pushfric_core.commands.options import JsonOption
from pushfric_core.commands.settings_options import option
from pushfric_core.errors import InvalidInput
from pushfric_core.plausible import check_within
from pushfric_core.plugins import PUSHERS, plugin
from pushfric_core.pushers.serial_settings import SerialSettings
from pushfric_core.records import to_json
from pushfric_core.settings import read
from pushfric_ros.rehearsal.faults import CONTRACT, FAULTS, Outcome, rehearse
from pushfric_ros.rehearsal.grbl_stage import GrblStage
from pushfric_ros.rehearsal.random_faults import KINDS, damages
from pushfric_ros.rehearsal.random_faults import kills as killed
from pushfric_ros.rehearsal.stage import Rehearsed, Stage

app = Application()


@app.command("rehearse")
def rehearsal(
    port: Annotated[str, typer.Option(help="Serial port of the GRBL controller.", show_default=False)] = "",
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
    silence: Annotated[float, option(SerialSettings, "silence")] = SerialSettings.silence,
    driver: Annotated[str, typer.Option(help="What drives the pusher; --set gives the settings of any but grbl.")] = "grbl",
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="A setting of the driver; may be repeated.")
    ] = None,
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

    Between the actuator and a GRBL controller stands a faulty line: it loses, changes and delays bytes, and everything is
    measured by what the controller itself reports. Any other driver is rehearsed without such a line, by what the actuator
    publishes: docs/hardware.md has the contract. Ctrl-C stops the pusher where it is.

    Exit code 1: a fault did not end as it must.
    """
    kind, prefix = (GrblStage, "--") if driver == "grbl" else (Stage, "--set: ")
    try:
        chosen = plugin(PUSHERS, driver)
    except ValueError as error:
        raise InvalidInput(f"--{error}") from error
    own = {"port": port, "baud": baud, "axis": axis, "silence": silence}
    try:
        (chosen,) = read(own if kind is GrblStage else _assigned(settings or []), chosen)
    except ValueError as error:
        raise InvalidInput(f"{prefix}{error}") from error
    if kind is Stage and (kills or damage):
        raise InvalidInput("--kills and --damage are for the driver grbl")
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
    with kind(Rehearsed(chosen, driver, stroke, speed), warn) as stage:
        console.print(
            f"strokes of {1e3 * stage.reach:.1f} mm at {1e3 * speed:g} mm/s; Ctrl-C stops the pusher", highlight=False
        )
        for outcome in _outcomes(stage, kills, damage, seed):
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


def _assigned(settings: list[str]) -> dict[str, object]:
    """Raises ValueError if a setting has no value."""
    if lacking := [text for text in settings if "=" not in text]:
        raise ValueError(f"expected NAME=VALUE, got {lacking[0]}")
    return {name: yaml.safe_load(value) for name, _, value in (text.partition("=") for text in settings)}


def _outcomes(stage: Stage, kills: int, damage: int, seed: int) -> Iterator[Outcome]:
    if not isinstance(stage, GrblStage):
        return rehearse(stage, CONTRACT)
    return rehearse(stage, killed(kills, seed) if kills else damages(damage, seed) if damage else FAULTS)


def line(outcome: Outcome) -> str:
    """The result of a fault, as a line of text."""
    result = (outcome.problem or "as it must be") + tried(outcome)
    way = "" if outcome.travelled is None else f", {1e3 * outcome.travelled:.2f} mm"
    return f"{outcome.fault}: {result}{way}" + ("" if outcome.seconds is None else f" in {outcome.seconds:.2f} s")


def table(outcomes: list[Outcome]) -> Table:
    """A row for each fault."""
    shown = Table(box=None)
    for column in ("fault", "rests after", "travelled", "allowed", ""):
        shown.add_column(column, justify="left" if column in ("fault", "") else "right")
    for outcome in outcomes:
        seconds = "" if outcome.seconds is None else f"{outcome.seconds:.2f} s"
        lengths = ["" if way is None else f"{1e3 * way:.1f} mm" for way in (outcome.travelled, outcome.allowed)]
        shown.add_row(outcome.fault, seconds, *lengths, (outcome.problem or "ok") + tried(outcome))
    return shown


def tried(outcome: Outcome) -> str:
    """How often a fault was tried, if its push ended before it."""
    return f", at the {outcome.tries}. try" if outcome.tries > 1 else ""


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
