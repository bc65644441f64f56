"""The command `rehearse`."""

import sys
from collections.abc import Iterable
from typing import Annotated, Any

import typer
import yaml
from rich.console import Console
from rich.table import Table

from pushfric_core.commands.application import STDOUT, Application, in_range
from pushfric_core.commands.cell_options import FASTEST_STROKE, LONGEST_STROKE
from pushfric_core.commands.console import say, warn
from pushfric_core.commands.options import JsonOption
from pushfric_core.commands.result import answer
from pushfric_core.commands.settings_options import option
from pushfric_core.errors import InvalidInput, blaming
from pushfric_core.plausible import check_within
from pushfric_core.plugins import PUSHERS, plugin
from pushfric_core.pushers.serial_settings import SerialSettings
from pushfric_core.settings import read
from pushfric_ros.faults.fault import Fault, Outcome, tried
from pushfric_ros.faults.grbl_stage import GrblStage
from pushfric_ros.faults.pusher import CONTRACT, FAULTS, KINDS, damages
from pushfric_ros.faults.pusher import kills as killed
from pushfric_ros.faults.stage import Rehearsed, Stage

NOTHING_FOUND = dict.fromkeys(("seconds", "travelled", "allowed"))

app = Application()


@app.command("rehearse")
def rehearsal(
    port: Annotated[str, typer.Option(help="Serial port of the GRBL controller.")] = "",
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
        with blaming():
            check_within("the stroke", (stroke,), LONGEST_STROKE, "m")
    outcomes: list[Outcome] = []
    with kind(Rehearsed(chosen, driver, stroke, speed), warn) as stage:
        stage.open()
        say(f"strokes of {1e3 * stage.reach:.1f} mm at {1e3 * speed:g} mm/s; Ctrl-C stops the pusher")
        for fault in _faults(kind, kills, damage, seed):
            outcomes.append(outcome := tried(fault, stage.set_up))
            say(line(outcome))
        changed = stage.bring_back()
    for what in changed:
        warn(f"not as it was: {what}")
    told = [{"fault": one.fault, **NOTHING_FOUND, **one.to_dict()} for one in outcomes]
    answer({"outcomes": told, "changed": changed}, json)
    if json != STDOUT:
        Console().print(distribution(outcomes) if kills else table(outcomes))
    if changed or any(outcome.problem for outcome in outcomes):
        sys.exit(1)


def _assigned(settings: list[str]) -> dict[str, object]:
    """Raises ValueError if a setting has no value."""
    if lacking := [text for text in settings if "=" not in text]:
        raise ValueError(f"expected NAME=VALUE, got {lacking[0]}")
    return {name: yaml.safe_load(value) for name, _, value in (text.partition("=") for text in settings)}


def _faults(kind: type[Stage], kills: int, damage: int, seed: int) -> Iterable[Fault[Any]]:
    if kind is Stage:
        return CONTRACT
    return killed(kills, seed) if kills else damages(damage, seed) if damage else FAULTS


def line(outcome: Outcome) -> str:
    """The result of a fault, as a line of text."""
    seconds, way, _ = figures(outcome, 2)
    went = way and f", {way}" + (seconds and f" in {seconds}")
    return f"{outcome.fault}: {outcome.problem or 'as it must be'}{outcome.tried}{went}"


def figures(outcome: Outcome, digits: int) -> list[str]:
    """When the pusher rested, how far it went and may have gone; empty if it was not to stop."""
    found, scales = outcome.found, {"seconds": (1.0, 2, "s"), "travelled": (1e3, digits, "mm"), "allowed": (1e3, digits, "mm")}
    shown = ((found.get(name), *scale) for name, scale in scales.items())
    return ["" if value is None else f"{scale * value:.{digits}f} {unit}" for value, scale, digits, unit in shown]


def table(outcomes: list[Outcome]) -> Table:
    """A row for each fault."""
    shown = headed("fault", "rests after", "travelled", "allowed", "")
    for outcome in outcomes:
        shown.add_row(outcome.fault, *figures(outcome, 1), (outcome.problem or "ok") + outcome.tried)
    return shown


def headed(first: str, *columns: str) -> Table:
    """A table without rows; figures stand on the right."""
    shown = Table(box=None)
    for column in (first, *columns):
        shown.add_column(column, justify="left" if column in (first, "") else "right")
    return shown


def distribution(outcomes: list[Outcome]) -> Table:
    """How far the pusher went after a kill, for each kind of process."""
    shown = headed("killed", "times", "median", "90 %", "farthest", "allowed", "failed")
    for kind in KINDS:
        ours = [outcome for outcome in outcomes if outcome.fault == kind]
        found = [outcome.found for outcome in ours if outcome.found.get("travelled") is not None]
        if ways := sorted(one["travelled"] for one in found):
            chosen = (ways[len(ways) // 2], ways[(9 * len(ways)) // 10], ways[-1], found[0]["allowed"])
            wrong = sum(outcome.problem is not None for outcome in ours)
            shown.add_row(kind, str(len(ours)), *(f"{1e3 * way:.2f} mm" for way in chosen), str(wrong))
    return shown
