"""Results as JSON or in lines for people: any result, an estimate, and the ledger."""

from collections.abc import Iterable, Iterator
from typing import Any

from rich.table import Table

from pushfric_core.commands.application import STDOUT
from pushfric_core.commands.console import write_json
from pushfric_core.estimation.estimate_report import center_line, contact_friction_line
from pushfric_core.records import to_json
from pushfric_core.solvers.program import Loss
from pushfric_core.trajectories.ledger import Ledger
from pushfric_core.wording import data_of


def answer(result: Any, where: str | None, lines: Iterable[str] = ()) -> None:
    """Write a result as JSON, if asked to, and print it in lines for people, unless the JSON goes to stdout.

    Args:
        result: as `to_json` takes it.
        where: value of the option.
        lines: made only if they are printed.
    Raises:
        InvalidInput: the file cannot be written.
    """
    write_json(to_json(result), where)
    if where != STDOUT:
        for line in lines:
            print(line)


def print_result(figures: dict[str, Any], json: str | None, loss: Loss) -> None:
    """Print an estimate.

    Args:
        figures: of `EstimateReport.to_dict`.
        json: value of the option `--json`.
        loss: of the estimator; it determines the unit of the fit error.
    """
    answer(figures, json, _lines(figures, loss))


def _lines(figures: dict[str, Any], loss: Loss) -> Iterator[str]:
    yield center_line(figures)
    yield contact_friction_line(figures)
    if "total_friction" in figures:
        yield f"total  {figures['total_friction']:.3f} N of support friction"
    scale, unit = (1e6, "mm^2") if loss is Loss.L2 else (1e3, "mm")
    yield f"fit    {figures['objective'] * scale:.4f} {unit}, {figures['status']}, gap {figures['gap'] * scale:.1e} {unit}"
    if "slips" in figures["mu_c"]:
        yield "slip   " + ", ".join(f"{state} {count}" for state, count in figures["mu_c"]["slips"].items())
    yield f"from   {data_of(figures['data_points'], figures['pushes'])}"
    for one in figures["belief"]["rejected"]:
        yield f"       push_id {one['push']} is left out: {one['reason']['text']}"


def ledger_table(ledger: Ledger) -> Table:
    """The account of every message: a line for each reason, a column for each kind."""
    shown = Table("", box=None, pad_edge=False, header_style="bold")
    for kind in ledger.sums():
        shown.add_column(kind, justify="right")
    for row in ledger.rows():
        shown.add_row(*row)
    return shown
