"""Many estimates as one table."""

import csv
import pathlib
from collections.abc import Callable, Sequence
from typing import Any

from pushfric_core.offline.many import Line, objections

TABLE = "table.csv"
"""Name in the folder of the results."""


def _at(*keys: str | int) -> Callable[[Line], Any]:
    """A function that looks up a value in a line, key by key; None if it is not there."""

    def value(line: Any) -> Any:
        for key in keys:
            if line is None or (isinstance(key, str) and key not in line):
                return None
            line = line[key]
        return line

    return value


def _number(*keys: str | int) -> Callable[[Line], float | None]:
    """The same for a number; infinite numbers are strings in JSON."""
    found = _at(*keys)
    return lambda line: None if found(line) is None else float(found(line))


def believed_center(line: Line) -> list[float]:
    """The belief's p_CF; that of the program if the pushes do not show how far it is off."""
    known: list[float] = line["belief"].get("center_of_friction", line["center_of_friction"])
    return known


COVARIANCE = "belief", "covariance"

COLUMNS: dict[str, Callable[[Line], Any]] = {
    "input": _at("input"),
    "object": _at("object"),
    "status": _at("status"),
    "use": lambda line: not objections(line) if "belief" in line else None,
    "error": _at("error"),
    "reasons": lambda line: " ".join(one["code"] for one in objections(line)) if "belief" in line else None,
    "p_cf_x": lambda line: believed_center(line)[0] if "belief" in line else None,
    "p_cf_y": lambda line: believed_center(line)[1] if "belief" in line else None,
    "var_x": _number(*COVARIANCE, 0, 0),
    "var_y": _number(*COVARIANCE, 1, 1),
    "cov_xy": _number(*COVARIANCE, 0, 1),
    "mu_c": _number("belief", "mu_c", "value"),
    "mu_c_low": _number("belief", "mu_c", "interval", 0),
    "mu_c_high": _number("belief", "mu_c", "interval", 1),
    "mu_c_kind": _at("belief", "mu_c", "kind"),
    "mu_c_p90": _number("mu_c", "p90"),
    "mu_c_max": _number("mu_c", "max"),
    "total_friction": _number("total_friction"),
    "objective": _number("objective"),
    "gap": _number("gap"),
    "data_points": _at("data_points"),
    "pushes": _at("pushes"),
    "outlier": lambda line: "; ".join(line.get("differs", ())) or None,
    "warnings": lambda line: len(line["warnings"]),
    "model": _at("model"),
}
"""Each column's name, and what it holds; SI units, object frame."""


def write_table(lines: Sequence[Line], folder: pathlib.Path) -> pathlib.Path:
    """Write the table of many estimates; return the file."""
    rows = [[value(line) for value in COLUMNS.values()] for line in lines]
    with (folder / TABLE).open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(COLUMNS)
        table.writerows(["" if value is None else value for value in row] for row in rows)
    return folder / TABLE
