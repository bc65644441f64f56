"""An estimate as text or as JSON."""

from typing import Any

from rich.console import Console

from pushfric_core.solvers.program import Loss
from pushfric_core.wording import data_of
from pushfric_ros.commands.json_option import STDOUT, write_json
from pushfric_ros.report.report import to_json


def print_result(figures: dict[str, Any], json: str | None, loss: Loss) -> None:
    """Print an estimate.

    Args:
        figures: of `report.report`.
        json: value of the option `--json`.
        loss: of the estimator; it determines the unit of the fit error.
    """
    write_json(to_json(figures), json)
    if json == STDOUT:
        return
    x, y = (1e3 * value for value in figures["center_of_friction"])
    output = Console(highlight=False, soft_wrap=True)
    trust = f", within {figures['confidence'] * 1e3:.2f} mm with 90 % probability" if "confidence" in figures else ""
    output.print(f"p_CF   ({x:.2f}, {y:.2f}) mm{trust}")
    mu = figures["mu_c"]
    slipping = "; {:.3f} to {:.3f} in the pushes that slipped".format(*mu["slipping"]) if "slipping" in mu else ""
    bounds = f"lower bounds up to {mu['max']:.3f}, 90 % of them up to {mu['p90']:.3f}"
    output.print(f"mu_c   {_coefficient(mu)}{bounds}{slipping}")
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
        output.print(f"       push {one['push']} is left out: {one['reason']}")


def _coefficient(mu: dict[str, Any]) -> str:
    """The value and its interval, in front of the bounds; nothing if it is only bounded."""
    if mu.get("value") is None:
        return ""
    low, high = mu["interval"]
    return f"{mu['value']:.3f} from {mu['kind']}, {low:.3f} to {high:.3f} with 90 % probability; "
