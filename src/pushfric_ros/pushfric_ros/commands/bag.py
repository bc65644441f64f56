"""The commands of `pushfric bag`."""

import pathlib
import sys
from typing import Annotated

import typer
from rich.console import Console

from pushfric_core.wording import counted
from pushfric_ros.bags.bag import Bag
from pushfric_ros.bags.recovery import recover as recovered
from pushfric_ros.commands.console import console
from pushfric_ros.commands.group import Group
from pushfric_ros.commands.json_option import STDOUT, JsonOption, write_json
from pushfric_ros.report.condition import condition
from pushfric_ros.report.report import to_json

app = typer.Typer(cls=Group, add_completion=False)


@app.command()
def recover(
    damaged: Annotated[
        pathlib.Path, typer.Argument(help="Bag that was damaged or cut short, or one of its files.", show_default=False)
    ],
    out: Annotated[pathlib.Path, typer.Option(help="Folder to write: the new bag.", show_default=False)],
    only_confirmed: Annotated[
        bool,
        typer.Option("--only-confirmed", help="Leave out messages that are intact in chunks whose checksum fails."),
    ] = False,
) -> None:
    """Save everything that can be read of a damaged bag into a new one, and say what is lost.

    In an uncompressed chunk that fails its checksum, those messages are saved that the damage does not seem to have reached.
    The new bag says so, and is then read with --partial only.
    """
    bag = recovered(damaged, out, unconfirmed=not only_confirmed)
    _print(bag, console)
    unconfirmed = {} if bag.damage is None or only_confirmed else bag.damage.unconfirmed
    saved = bag.summary.message_count + sum(unconfirmed.values())
    console.print(f"{out}: {counted(saved, 'message')} saved", markup=False)
    if unconfirmed:
        console.print(
            f"{out}: no checksum confirms {sum(unconfirmed.values())} of them: {_each(unconfirmed)}; --partial reads them,"
            " --only-confirmed leaves them out here",
            markup=False,
        )


@app.command()
def verify(
    bag: Annotated[pathlib.Path, typer.Argument(help="A bag, or one of its files.", show_default=False)],
    json: JsonOption = None,
) -> None:
    """Read every byte of a bag and say whether it is whole.

    Exit code 0: it is whole; 1: it is damaged; 2: it is not a bag.
    """
    checked = Bag(bag)
    write_json(to_json(condition(checked)), json)
    if json != STDOUT:
        _print(checked, Console(highlight=False, soft_wrap=True))
    if checked.damage is not None:
        sys.exit(1)


def _print(bag: Bag, output: Console) -> None:
    if bag.damage is None:
        messages = counted(bag.summary.message_count, "message")
        output.print(f"{bag.path}: whole, {messages} of {counted(len(bag.summary.topics), 'topic')}", markup=False)
        return
    output.print(bag.what_is_missing(with_places=False), markup=False)
    for file, gap in bag.damage.gaps:
        output.print(f"{file.name}, bytes {gap.begin} to {gap.end}: {gap.reason}, {bag.when(gap)}", markup=False)
    if bag.damage.unconfirmed:
        output.print(
            f"intact in damaged chunks, though no checksum confirms it: {_each(bag.damage.unconfirmed)};"
            " `pushfric bag recover` saves them",
            markup=False,
        )
    for contradiction in bag.damage.contradictions:
        output.print(contradiction, markup=False)


def _each(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} of {topic}" for topic, count in counts.items())
