"""The commands of `pushfric bag`."""

import pathlib
import sys
from typing import Annotated, Any

import typer
from rich.console import Console

from pushfric_core.bags.bag import Bag
from pushfric_core.bags.recorded import Recorded, cells
from pushfric_core.bags.recovery import recover as recovered
from pushfric_core.commands.application import Application
from pushfric_core.commands.console import console, say, warn
from pushfric_core.commands.json_option import STDOUT, JsonOption, write_json
from pushfric_core.errors import InvalidInput
from pushfric_core.report.report import to_json
from pushfric_core.wording import counted

app = Application()


@app.command()
def recover(
    damaged: Annotated[
        pathlib.Path, typer.Argument(help="Bag that was damaged or cut short, or one of its files.", show_default=False)
    ],
    out: Annotated[pathlib.Path, typer.Option(help="Folder to write: the new bag.", show_default=False)],
) -> None:
    """Save everything that can be read of a damaged bag into a new one, and say what is lost.

    What is saved are whole chunks, before and after the damage; the new bag notes what was wrong. Exit code 1: what was saved
    does not add up.
    """
    bag = recovered(damaged, out)
    _print(bag, console)
    say(f"{out}: {counted(bag.summary.message_count, 'message')} saved")
    doubts = _doubts(Bag(out))
    _warn_of(out, doubts)
    if doubts:
        sys.exit(1)


@app.command()
def verify(
    bag: Annotated[pathlib.Path, typer.Argument(help="A bag, or one of its files.", show_default=False)],
    json: JsonOption = None,
) -> None:
    """Read every byte of a bag, and say whether it is whole and its messages add up.

    Checked are checksums, lengths and indexes, the files' numbers and names, metadata.yaml, the number of
    messages of each topic, and the messages' own numbers. docs/files.md says what cannot be known.

    Exit code 0: they do; 1: it is damaged, or they do not; 2: it is not a bag.
    """
    checked = Bag(bag)
    doubts = _doubts(checked) if checked.damage is None else []
    write_json(to_json(_condition(checked) | {"doubts": doubts}), json)
    if json != STDOUT:
        _print(checked, Console(highlight=False, soft_wrap=True))
    _warn_of(bag, doubts)
    if checked.damage is not None or doubts:
        sys.exit(1)


def _condition(bag: Bag) -> dict[str, Any]:
    """The condition of a bag, as JSON: whether it is whole, and what is missing."""
    damage = bag.damage
    gaps = [] if damage is None else damage.gaps
    return {
        "whole": damage is None,
        "messages": bag.summary.message_count,
        "topics": {topic.name: topic.message_count for topic in bag.summary.topics},
        "missing": {} if damage is None else damage.missing,
        "gaps": [{"file": file.name, **gap._asdict()} for file, gap in gaps],
        "contradictions": [] if damage is None else list(damage.contradictions),
        "notes": list(bag.notes),
    }


def _doubts(bag: Bag) -> list[str]:
    """Contradictions between the messages of a bag, one line each."""
    doubts = []
    for cell in cells(bag):
        try:
            ledger = Recorded(bag.path, cell, bag).ledger()
        except InvalidInput as error:  # a bag, but with a run that nobody understands
            doubts.append(str(error))
        else:
            doubts += [] if ledger is None else ledger.doubts
    return doubts


def _warn_of(bag: pathlib.Path, doubts: list[str]) -> None:
    for line in doubts:
        warn(f"{bag}: {line}")


def _print(bag: Bag, output: Console) -> None:
    for note in bag.notes:
        say(note)
    if bag.damage is None:
        messages = counted(bag.summary.message_count, "message")
        output.print(f"{bag.path}: whole, {messages} of {counted(len(bag.summary.topics), 'topic')}", markup=False)
        return
    output.print(bag.what_is_missing(with_places=False), markup=False)
    for file, gap in bag.damage.gaps:
        output.print(f"{file.name}, bytes {gap.begin} to {gap.end}: {gap.reason}, {bag.when(gap)}", markup=False)
    for contradiction in bag.damage.contradictions:
        output.print(contradiction, markup=False)
