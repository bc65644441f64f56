"""The commands of `pushfric bag`."""

import pathlib
import sys
from typing import Annotated

import typer
from rich.console import Console

from pushfric_core.bags.bag import Bag, each
from pushfric_core.bags.contents import Standing
from pushfric_core.bags.recorded import Recorded, cells
from pushfric_core.bags.recovery import recover as recovered
from pushfric_core.commands.application import Application
from pushfric_core.commands.console import console, say, warn
from pushfric_core.commands.json_option import STDOUT, JsonOption, write_json
from pushfric_core.errors import InvalidInput
from pushfric_core.report.condition import condition
from pushfric_core.report.report import to_json
from pushfric_core.wording import counted

app = Application()


@app.command()
def recover(
    damaged: Annotated[
        pathlib.Path, typer.Argument(help="Bag that was damaged or cut short, or one of its files.", show_default=False)
    ],
    out: Annotated[pathlib.Path, typer.Option(help="Folder to write: the new bag.", show_default=False)],
    only_confirmed: Annotated[
        bool,
        typer.Option("--only-confirmed", help="Leave out messages that nothing confirms."),
    ] = False,
) -> None:
    """Save everything that can be read of a damaged bag into a new one, and say what is lost.

    Copies are dropped. Messages that nothing confirms are marked, and the new bag is then read with --partial only: those that
    the damage of an uncompressed chunk does not seem to have reached, those without a checksum, and those that do not belong to
    the recording around them. Exit code 1: what was saved does not add up.
    """
    bag = recovered(damaged, out, unconfirmed=not only_confirmed)
    _print(bag, console)
    unconfirmed = bag.doubtful
    saved = bag.standings[Standing.SOUND].total() + (0 if only_confirmed else unconfirmed.total())
    say(f"{out}: {counted(saved, 'message')} saved")
    if unconfirmed and only_confirmed:
        say(f"{out}: {counted(unconfirmed.total(), 'message')} left out: {each(unconfirmed)}")
    elif unconfirmed:
        say(
            f"{out}: nothing confirms {unconfirmed.total()} of them: {each(unconfirmed)}; --partial reads them,"
            " --only-confirmed leaves them out here",
        )
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

    Checked are checksums, lengths and indexes, the files' numbers, names, times and order, metadata.yaml, the number of
    messages of each topic, copies, messages of other recordings, and gaps in the messages' numbers. docs/files.md says what
    cannot be known.

    Exit code 0: they do; 1: it is damaged, or they do not; 2: it is not a bag.
    """
    checked = Bag(bag)
    doubts = _doubts(checked) if checked.damage is None else []
    write_json(to_json(condition(checked) | {"doubts": doubts}), json)
    if json != STDOUT:
        _print(checked, Console(highlight=False, soft_wrap=True))
    _warn_of(bag, doubts)
    if checked.damage is not None or doubts:
        sys.exit(1)


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
    if bag.damage.unconfirmed:
        output.print(
            f"intact in damaged chunks, though no checksum confirms it: {each(bag.damage.unconfirmed)};"
            " `pushfric bag recover` saves them",
            markup=False,
        )
    for contradiction in bag.damage.contradictions:
        output.print(contradiction, markup=False)
