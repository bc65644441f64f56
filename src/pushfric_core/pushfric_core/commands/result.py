"""An estimate as text or as JSON, and the ledger as text."""

from typing import Any

from rich.console import Console

from pushfric_core.commands.console import console
from pushfric_core.commands.json_option import STDOUT, write_json
from pushfric_core.estimation.estimate_report import center_line, contact_friction_line, posterior_line
from pushfric_core.report.ledger import events, table
from pushfric_core.report.report import to_json
from pushfric_core.solvers.program import Loss
from pushfric_core.trajectories.ledger import Ledger
from pushfric_core.wording import data_of


def print_result(figures: dict[str, Any], json: str | None, loss: Loss) -> None:
    """Print an estimate.

    Args:
        figures: of `EstimateReport.to_dict`.
        json: value of the option `--json`.
        loss: of the estimator; it determines the unit of the fit error.
    """
    write_json(to_json(figures), json)
    if json == STDOUT:
        return
    mu = figures["mu_c"]
    output = Console(highlight=False, soft_wrap=True)
    output.print(center_line(figures))
    if "posterior" in figures:
        output.print(posterior_line(figures))
    output.print(contact_friction_line(figures))
    if "total_friction" in figures:
        output.print(f"total  {figures['total_friction']:.3f} N of support friction")
    squares = loss is Loss.L2
    scale, unit = (1e6, "mm^2") if squares else (1e3, "mm")
    output.print(
        f"fit    {figures['objective'] * scale:.4f} {unit}, {figures['status']}, gap {figures['gap'] * scale:.1e} {unit}"
    )
    if "slips" in mu:
        output.print("slip   " + ", ".join(f"{state} {count}" for state, count in mu["slips"].items()))
    output.print(f"from   {data_of(figures['data_points'], figures['pushes'])}")
    for one in figures["rejected"]:
        output.print(f"       push {one['push']} is left out: {one['reason']['text']}")


def print_ledger(ledger: Ledger) -> None:
    """Print what became of every message, and the events, on stderr."""
    console.print(table(ledger))
    for line in events(ledger):
        console.print(line, highlight=False, markup=False)
