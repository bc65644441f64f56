"""The commands of `pushfric bag`."""

import pathlib
import sys
import time
from collections.abc import Iterator
from typing import Annotated, Any, NamedTuple

import typer
from rich.console import Console

from pushfric_core.bags.bag import Bag
from pushfric_core.bags.recorded import Recorded, beside, cells
from pushfric_core.bags.recovery import recover as recovered
from pushfric_core.commands.application import STDOUT, Application
from pushfric_core.commands.console import say, warn
from pushfric_core.commands.options import JsonOption
from pushfric_core.commands.result import answer, ledger_table
from pushfric_core.errors import InvalidInput
from pushfric_core.files.object_file import OBJECT_FILE
from pushfric_core.trajectories.ledger import POSES, Doubt, DoubtCode, Ledger
from pushfric_core.wording import counted

BagArgument = Annotated[pathlib.Path, typer.Argument(help="A bag, or one of its files.")]

app = Application()


class CheckedBag(NamedTuple):
    """A bag, and what its messages say."""

    bag: Bag
    ledgers: dict[str, Ledger]  # by the namespace of the cell
    notes: list[str]  # what cannot be known
    doubts: list[Doubt]
    remarks: list[Doubt]

    @property
    def sound(self) -> bool:
        """Whether nothing shows that something is missing."""
        return self.bag.damage is None and not self.doubts

    @property
    def whole(self) -> bool:
        """Whether it is proven that nothing is missing."""
        return self.sound and self.bag.proven and not self.remarks


@app.command()
def info(bag: BagArgument, json: JsonOption = None) -> None:
    """Show files, times, topics and counts of a bag, what became of its messages, and whether they add up.

    Exit codes as of verify.
    """
    checked = _checked(bag)
    answer(_condition(checked), json)
    if json != STDOUT:
        for line in _contents(checked.bag):
            _show(line)
        for ledger in checked.ledgers.values():
            _show(ledger_table(ledger))
    _end(checked, json)


@app.command()
def recover(
    damaged: Annotated[pathlib.Path, typer.Argument(help="Bag that was damaged or cut short, or one of its files.")],
    out: Annotated[pathlib.Path, typer.Option(help="Folder to write: the new bag.")],
) -> None:
    """Save everything that can be read of a damaged bag into a new one, and say what is lost.

    What is saved are whole chunks, before and after the damage; the new bag notes what was wrong. Exit code 1: messages are
    lost, or what was saved does not add up.
    """
    bag = recovered(damaged, out)
    if bag.damage is not None:
        _print_damage(bag)
    say(f"{out}: {counted(bag.summary.message_count, 'message')} saved")
    _end(_checked(out), None)


@app.command()
def verify(bag: BagArgument, json: JsonOption = None) -> None:
    """Read every byte of a bag, and say whether it is whole and its messages add up.

    Checked are checksums, lengths and indexes, the files' numbers and names, metadata.yaml, the number of messages of each
    topic, the messages' own numbers, and whether poses, pusher states and plan lack something. docs/files.md says what cannot
    be known.

    Exit code 0: nothing shows that something is missing; 1: it is damaged, or does not add up; 2: it is not a bag.
    """
    checked = _checked(bag)
    answer(_condition(checked), json)
    _end(checked, json)


def _checked(path: pathlib.Path) -> CheckedBag:
    bag = Bag(path)
    ledgers: dict[str, Ledger] = {}
    doubts = [Doubt(DoubtCode.LOST_BEFORE, f"was recovered; before that, {text}") for text in bag.lost]
    for cell in cells(bag):
        try:
            ledger = Recorded(path, cell, bag).ledger()
        except InvalidInput as error:  # a bag, but with a run that nobody understands
            doubts.append(Doubt(DoubtCode.NOT_UNDERSTOOD, str(error)))
        else:
            ledgers |= {} if ledger is None else {cell: ledger}
    notes = [*bag.notes]
    if not bag.summary.message_count and bag.damage is None:
        doubts.append(Doubt(DoubtCode.EMPTY, "holds no messages: its recorder heard nobody"))
    elif not ledgers and not doubts and bag.damage is None:
        notes.append("holds nothing of a cell, neither poses and pusher states nor observations")
    elif beside(path, OBJECT_FILE) is None and any(ledger.accounts[POSES].received for ledger in ledgers.values()):
        notes.append(f"without {OBJECT_FILE} in it, nobody knows which observations its poses give")
    doubts += [one for ledger in ledgers.values() for one in ledger.doubts if one not in doubts]
    return CheckedBag(bag, ledgers, notes, doubts, [one for ledger in ledgers.values() for one in ledger.remarks])


def _condition(checked: CheckedBag) -> dict[str, Any]:
    """The condition of a bag, as JSON: whether it is whole, what it holds, and what is missing."""
    bag, damage = checked.bag, checked.bag.damage
    gaps = [] if damage is None else damage.gaps
    by_name = {topic.name: [one for one in bag.summary.topics if one.name == topic.name] for topic in bag.summary.topics}
    return {
        "whole": checked.whole,
        "start_ns": bag.summary.start_ns,
        "end_ns": bag.summary.end_ns,
        "messages": bag.summary.message_count,
        "topics": {name: sum(one.message_count for one in same) for name, same in by_name.items()},
        "types": {name: ", ".join(one.type_name for one in same) for name, same in by_name.items()},
        "missing": {} if damage is None else damage.missing,
        "gaps": [gap._asdict() for gap in gaps],
        "contradictions": [] if damage is None else list(damage.contradictions),
        "notes": checked.notes,
        "doubts": [one._asdict() for one in checked.doubts],
        "remarks": [one._asdict() for one in checked.remarks],
        "ledgers": {cell: ledger.to_dict() for cell, ledger in checked.ledgers.items()},
    }


def _contents(bag: Bag) -> Iterator[str]:
    """The contents of a bag, in lines, as `ros2 bag info` prints them."""
    summary = bag.summary
    yield f"Files:             {', '.join(file.name for file in bag.files)}"
    yield f"Bag size:          {sum(file.stat().st_size for file in bag.files) / 1024:.1f} KiB"
    yield f"Duration:          {(summary.end_ns - summary.start_ns) * 1e-9:.3f} s"
    for name, at in (("Start:", summary.start_ns), ("End:", summary.end_ns)):
        yield f"{name:<19}{time.strftime('%Y-%m-%d %H:%M:%S', time.gmtime(at // 10**9))} UTC ({at * 1e-9:.3f})"
    yield f"Messages:          {summary.message_count}"
    for number, topic in enumerate(summary.topics):
        title = "" if number else "Topic information:"
        yield f"{title:<19}Topic: {topic.name} | Type: {topic.type_name} | Count: {topic.message_count}"


def _end(checked: CheckedBag, json: str | None) -> None:
    """Say whether a bag is whole, unless the JSON on stdout does, and what is missing; exit with 1 if something is."""
    bag = checked.bag
    if json != STDOUT:
        for note in checked.notes:
            say(f"{bag.path}: {note}")
        if bag.damage is not None:
            _print_damage(bag)
        else:
            sound = "whole" if checked.whole else "complete as far as the streams can say"
            said = sound if checked.sound else "does not add up"
            messages = counted(bag.summary.message_count, "message")
            _show(f"{bag.path}: {said}, {messages} of {counted(len(bag.summary.topics), 'topic')}")
    for one in (*checked.doubts, *checked.remarks):
        warn(f"{bag.path}: {one.text}")
    if not checked.sound:
        sys.exit(1)


def _print_damage(bag: Bag) -> None:
    assert bag.damage is not None
    _show(bag.what_is_missing(with_places=False))
    for gap in bag.damage.gaps:
        _show(f"{gap.file}, bytes {gap.begin} to {gap.end}: {gap.reason}, {bag.when(gap)}")
    for contradiction in bag.damage.contradictions:
        _show(contradiction)


def _show(line: Any) -> None:
    """Print a line, or a table, on stdout; names in a bag may hold control characters, which are left out."""
    line = "".join(filter(str.isprintable, line)) if isinstance(line, str) else line
    Console(highlight=False, soft_wrap=True, markup=False).print(line)
