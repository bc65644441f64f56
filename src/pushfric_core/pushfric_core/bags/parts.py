"""The files of a bag: whether their numbers, metadata.yaml and what they contain are those of one recording."""

import os
import pathlib
import re
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from pushfric_core.bags.contents import LONG_PAUSE_NS, LONG_PAUSE_RATIO
from pushfric_core.bags.rosbag2_metadata import METADATA, BagMetadata
from pushfric_core.errors import InvalidInput
from pushfric_core.wording import counted

PATTERNS = ("*.mcap", "*.mcap.zstd", "*.db3", "*.db3.zstd")

_NUMBERED = re.compile(r"(?P<base>.*)_(?P<number>[0-9]{1,9})\.(?:mcap|db3)(?:\.zstd)?")

OVERLAP_NS = 10**9
"""Parts of a recording may overlap by this much [ns]: recorders write what several threads receive."""

PAUSE_NS = 5 * 10**9
"""Without metadata.yaml, a longer pause between parts is a doubt, if it is far longer than any within them [ns]."""


class Doubt(NamedTuple):
    """What does not add up."""

    text: str
    files: tuple[pathlib.Path, ...] = ()  # whose messages nothing confirms therefore


class Parts(NamedTuple):
    """The files of a bag, by number."""

    files: tuple[pathlib.Path, ...]
    apart: tuple[pathlib.Path, ...]  # lie in the folder, but do not belong to the bag
    doubts: tuple[Doubt, ...]
    notes: tuple[str, ...]  # what cannot be known
    complete: bool  # whether the files are those that the metadata lists


class Covered(NamedTuple):
    """The contents of a part."""

    path: pathlib.Path
    messages: int
    expected: int | None  # how many it held, if it says so
    start_ns: int
    end_ns: int
    pause_ns: int  # the longest in it
    library: str
    embedded: BagMetadata | None  # what the file itself says of the bag so far


def number_of(path: pathlib.Path) -> int | None:
    """The number in a file's name; None: there is none."""
    found = _NUMBERED.fullmatch(path.name)
    return None if found is None else int(found["number"])


def _base(path: pathlib.Path) -> str:
    found = _NUMBERED.fullmatch(path.name)
    return path.name.partition(".")[0] if found is None else found["base"]


def _in_order(files: Sequence[pathlib.Path]) -> tuple[pathlib.Path, ...]:
    return tuple(sorted(files, key=lambda file: (number_of(file) is None, number_of(file) or 0, file.name)))


def parts_of(path: pathlib.Path, metadata: BagMetadata | None) -> Parts:
    """The files of a bag's folder, or the one file that is given.

    Raises:
        InvalidInput: the folder holds no files of a bag.
    """
    if not os.path.isdir(path):
        return Parts((path,), (), (), (), True)
    present = _in_order([file for pattern in PATTERNS for file in path.glob(pattern)])
    doubts: list[Doubt] = []
    notes: list[str] = []
    apart: tuple[pathlib.Path, ...] = ()
    if metadata is None:
        if not present:
            raise InvalidInput(f"{path}: is not a bag, expected {METADATA}, or an .mcap or .db3 file in it")
        files, gone = present, list[pathlib.Path]()
        if (last := number_of(present[-1])) is not None:
            notes.append(f"without {METADATA}, nothing says whether a part {last + 1} was recorded")
    else:
        gone = [file for file in metadata.files if not file.exists()]
        listed = [file for file in metadata.files if file not in gone]
        if not listed and not present:
            raise InvalidInput(f"{gone[0]}: cannot be read: No such file or directory, expected a bag")
        taken = {number_of(file) for file in listed}
        bases = {_base(file) for file in metadata.files}
        unlisted = [file for file in present if file not in listed]
        fitting = [one for one in unlisted if not listed or (_base(one) in bases and number_of(one) not in taken)]
        files, apart = _in_order([*listed, *fitting]), tuple(one for one in unlisted if one not in fitting)
        if gone:
            names = ", ".join(file.name for file in gone)
            what = f"lists {counted(len(metadata.files), 'file')}, {len(gone)} of which are not there: {names}"
            doubts.append(Doubt(f"{METADATA} {what}"))
        doubts += [Doubt(f"{METADATA} does not list {one.name}, which lies in the folder", (one,)) for one in fitting]
    doubts += _numbers([*files, *gone])
    return Parts(files, apart, tuple(doubts), tuple(notes), files == _in_order(metadata.files) if metadata else True)


def _numbers(files: Sequence[pathlib.Path]) -> list[Doubt]:
    """Errors in the numbers of files, which begin with 0."""
    found = [number for file in files if (number := number_of(file)) is not None]
    if not found:
        return [Doubt(f"{len(files)} files without numbers: {_named(files)}", tuple(files))] if len(files) > 1 else []
    doubts = []
    if absent := sorted({*range(max(found) + 1)} - {*found} if max(found) < 100_000 else {*range(min(found))}):
        parts = ", ".join(map(str, absent[:10])) + (", ..." if len(absent) > 10 else "")
        doubts.append(Doubt(f"{counted(len(absent), 'part is', 'parts are')} missing of 0 to {max(found)}: {parts}"))
    if twice := sorted({number for number in found if found.count(number) > 1}):
        same = [file for file in files if number_of(file) in twice]
        doubts.append(Doubt(f"{len(same)} files have the same number: {_named(same)}", tuple(same)))
    if others := [file for file in files if number_of(file) is None]:
        text = f"{counted(len(others), 'file')} without a number among {len(found)} parts: {_named(others)}"
        doubts.append(Doubt(text, tuple(others)))
    bases = Counter(_base(file) for file in files if number_of(file) is not None)
    if len(bases) > 1:
        usual = bases.most_common(1)[0][0]
        text = f"files of {len(bases)} bags in one folder: {', '.join(sorted(bases)[:10])}"
        doubts.append(Doubt(text, tuple(file for file in files if _base(file) != usual)))
    return doubts


def _named(files: Sequence[pathlib.Path]) -> str:
    return ", ".join(file.name for file in files[:10]) + (", ..." if len(files) > 10 else "")


def compared(parts: Sequence[Covered], metadata: BagMetadata | None) -> list[Doubt]:
    """Contradictions between the contents of the parts, in order of their numbers, and the metadata."""
    doubts = []
    for part in parts:
        said = None if metadata is None else metadata.by_file.get(part.path.name)
        if said is None or not said.messages:
            continue
        end_ns = said.start_ns + said.duration_ns
        if part.expected not in (None, said.messages):
            what = f"holds {said.messages} messages, but it held {part.expected}"
        elif part.messages and (part.start_ns > end_ns + OVERLAP_NS or part.end_ns < said.start_ns - OVERLAP_NS):
            what = f"covers {_span(said.start_ns, end_ns)}, but it covers {_span(part.start_ns, part.end_ns)}"
        else:
            continue
        doubts.append(Doubt(f"{METADATA} says that {part.path.name} {what}", (part.path,)))
    libraries = Counter(part.library for part in parts if part.library)
    for library, count in libraries.most_common()[1:]:
        others = tuple(part.path for part in parts if part.library == library)
        usual = libraries.most_common(1)[0][0]
        doubts.append(Doubt(f"{count} of {len(parts)} parts written by {library[:80]!r}, not {usual[:80]!r}", others))
    lists = [(part.path, [file.name for file in part.embedded.files]) for part in parts if part.embedded is not None]
    longest = max((names for _, names in lists), key=len, default=[])
    if metadata is None:
        for path, names in lists:
            if names != longest[: len(names)]:
                what = f"says that it belongs to {', '.join(names[:3])}, another part to {', '.join(longest[:3])}"
                doubts.append(Doubt(f"{path.name} {what}", (path,)))
        if len(longest) > len(parts):
            doubts.append(Doubt(f"a file says that the bag had {len(longest)} files, but there are {len(parts)}"))
    filled = [part for part in parts if part.messages]
    pause = max([PAUSE_NS, *(LONG_PAUSE_RATIO * part.pause_ns for part in filled)])
    for number, (before, after) in enumerate(pairwise(filled), 1):
        between = after.start_ns - before.end_ns
        if between < -OVERLAP_NS:
            what = f"begins {-between * 1e-9:.3f} s before {before.path.name} ends"
            doubts.append(Doubt(f"{after.path.name} {what}", (before.path, after.path)))
        elif metadata is None and between > pause:
            sides = filled[:number], filled[number:]
            least = min(sum(part.messages for part in side) for side in sides)
            smaller = [part.path for side in sides if sum(part.messages for part in side) == least for part in side]
            text = f"{after.path.name} begins {between * 1e-9:.3f} s after {before.path.name} ends"
            doubts.append(Doubt(text, tuple(smaller if between > LONG_PAUSE_NS else ())))
    return doubts


def _span(start_ns: int, end_ns: int) -> str:
    return f"{start_ns * 1e-9:.3f} s to {end_ns * 1e-9:.3f} s"
