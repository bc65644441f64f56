"""Many estimates as one table: a CSV, and a Parquet file if pyarrow is installed."""

import csv
import importlib.util
import pathlib
from collections.abc import Callable, Sequence
from typing import Any

from pushfric_core.offline.many import Line

CSV, PARQUET = "table.csv", "table.parquet"
"""Names in the folder of the results."""


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


COVARIANCE = "center_of_friction_covariance"

COLUMNS: dict[str, tuple[str, Callable[[Line], Any]]] = {
    "input": ("string", _at("input")),
    "object": ("string", _at("object")),
    "status": ("string", _at("status")),
    "use": ("bool", _at("verdict", "use")),
    "error": ("string", _at("error")),
    "reasons": (
        "string",
        lambda line: " ".join(one["code"] for one in line["verdict"]["reasons"]) if "verdict" in line else None,
    ),
    "p_cf_x": ("double", _number("center_of_friction", 0)),
    "p_cf_y": ("double", _number("center_of_friction", 1)),
    "var_x": ("double", _number(COVARIANCE, 0, 0)),
    "var_y": ("double", _number(COVARIANCE, 1, 1)),
    "cov_xy": ("double", _number(COVARIANCE, 0, 1)),
    "mu_c": ("double", _number("mu_c", "value")),
    "mu_c_low": ("double", _number("mu_c", "interval", 0)),
    "mu_c_high": ("double", _number("mu_c", "interval", 1)),
    "mu_c_kind": ("string", _at("mu_c", "kind")),
    "mu_c_p90": ("double", _number("mu_c", "p90")),
    "mu_c_max": ("double", _number("mu_c", "max")),
    "total_friction": ("double", _number("total_friction")),
    "objective": ("double", _number("objective")),
    "gap": ("double", _number("gap")),
    "data_points": ("int64", _at("data_points")),
    "pushes": ("int64", _at("pushes")),
    "outlier": ("string", lambda line: "; ".join(line.get("differs", ())) or None),
    "warnings": ("int64", lambda line: len(line["warnings"])),
    "model": ("string", _at("model")),
}
"""Each column's name, its type in Arrow, and what it holds; SI units, object frame."""


def write_table(lines: Sequence[Line], folder: pathlib.Path) -> list[pathlib.Path]:
    """Write the table of many estimates; return the files."""
    rows = [[value(line) for _, value in COLUMNS.values()] for line in lines]
    with (folder / CSV).open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(COLUMNS)
        table.writerows(["" if value is None else value for value in row] for row in rows)
    if importlib.util.find_spec("pyarrow") is None:
        return [folder / CSV]
    _write_parquet(lines, rows, folder / PARQUET)
    return [folder / CSV, folder / PARQUET]


def _write_parquet(lines: Sequence[Line], rows: Sequence[list[Any]], file: pathlib.Path) -> None:
    """Write the same table with w and its support points, which do not fit into a CSV."""
    import pyarrow
    from pyarrow import parquet

    columns = dict(zip(COLUMNS, zip(*rows, strict=True), strict=True)) if rows else dict.fromkeys(COLUMNS, ())
    arrays = {name: pyarrow.array(columns[name], kind) for name, (kind, _) in COLUMNS.items()}
    arrays["w"] = pyarrow.array([line.get("w") for line in lines], pyarrow.list_(pyarrow.float64()))
    points = pyarrow.list_(pyarrow.list_(pyarrow.float64()))
    arrays["support_points"] = pyarrow.array([line.get("support_points") for line in lines], points)
    parquet.write_table(pyarrow.table(arrays), file)
