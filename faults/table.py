"""What followed the faults of a running cell, as JSON, and as a table."""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from docs.markdown import table as markdown
from pushfric_ros.faults.processes import NODES

VARYING = re.compile(rf"\d+(\.\d+)?(?= s after| more)|\b({'|'.join(NODES)})\b(?!'s)|(?<=camera: ).*")
"""In what faults that belong together differ."""

MANY = 12
"""More numbers are shown as the first and the last."""


def table(faults: Sequence[Mapping[str, Any]]) -> str:
    """A Markdown table with a row for all faults that must have the same outcome.

    Args:
        faults: each with its name, what was `asked`, and the outcomes of its `tries`.
    """
    rows = []
    for asked in dict.fromkeys(fault["asked"] for fault in faults):
        alike = [fault for fault in faults if fault["asked"] == asked]
        tries = [tried for fault in alike for tried in fault["tries"]]
        good = sum(tried["problem"] is None for tried in tries)
        wrong = [f"; {tried['problem']}" for tried in tries if tried["problem"] is not None]
        again = "".join(f", 1 on try {tried['tries']}" for tried in tries if tried["tries"] > 1)
        names = merged(fault["fault"] for fault in alike)
        rows.append((names, asked, seen(tries) + "".join(wrong), f"{good} of {len(tries)}{again}"))
    return markdown(("fault", "what follows", "seen", "as asked"), rows)


def merged(faults: Iterable[str]) -> str:
    """Faults in one cell; those that differ in a number, a node or the camera's image are written once."""
    groups: dict[str, list[str]] = {}
    for fault in faults:
        found = VARYING.search(fault)
        groups.setdefault(VARYING.sub("*", fault, count=1), []).append(found[0] if found else "")
    return "; ".join(text.replace("*", listed(values)) for text, values in groups.items())


def listed(values: Sequence[str]) -> str:
    """Values in a sentence; of many numbers the first and the last."""
    many = len(values) > MANY and values[0][:1].isdigit()
    return f"{values[0]} to {values[-1]}" if many else ", ".join(values)


def seen(tries: Sequence[Mapping[str, Any]]) -> str:
    """The exit codes of tries, and their times; what was seen if there is neither."""
    told = [tried.get("seen", "did not end") for tried in tries]
    ended = [re.fullmatch(r"exit code (-?\d+) after (\d+) s", text) for text in told]
    if not all(ended):
        return "; ".join(told)
    codes, times = (sorted({int(one[group]) for one in ended if one}) for group in (1, 2))
    span = f"{times[0]} to {times[-1]}" if times[0] < times[-1] else f"{times[0]}"
    return f"exit code {' or '.join(map(str, codes))} after {span} s"
