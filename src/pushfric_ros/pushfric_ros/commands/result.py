"""An estimate as text or as JSON."""

from typing import Any

from rich.console import Console

from pushfric_core.solvers.program import Loss
from pushfric_ros.report.report import to_json


def print_result(figures: dict[str, Any], as_json: bool, loss: Loss) -> None:
    """Print an estimate on stdout.

    Args:
        figures: of `report.report`.
        as_json: print one JSON object, and nothing else.
        loss: of the estimator; it determines the unit of the fit error.
    """
    if as_json:
        print(to_json(figures))
        return
    x, y = (1e3 * value for value in figures["center_of_friction"])
    output = Console(highlight=False)
    trust = f"; off by at most {figures['confidence'] * 1e3:.2f} mm with 90 %" if "confidence" in figures else ""
    output.print(f"p_CF   ({x:.2f}, {y:.2f}) mm{trust}")
    mu = figures["mu_c"]
    slipping = ", {:.3f} to {:.3f} (slipping)".format(*mu["slipping"]) if "slipping" in mu else ""
    output.print(f"mu_c   {_coefficient(mu)}{mu['p90']:.3f} (90 %), {mu['max']:.3f} (100 %){slipping}")
    if "total_friction" in figures:
        output.print(f"total  {figures['total_friction']:.3f} N of support friction")
    squares = loss is Loss.L2
    scale, unit = (1e6, "mm^2") if squares else (1e3, "mm")
    output.print(
        f"fit    {figures['objective'] * scale:.4f} {unit}, {figures['status']}, gap {figures['gap'] * scale:.1e} {unit}"
    )
    output.print(f"from   {figures['data_points']} data points of {figures['pushes']} pushes")


def _coefficient(mu: dict[str, Any]) -> str:
    """The value and its interval, in front of the bounds; nothing where it is only bounded."""
    if mu.get("value") is None:
        return ""
    low, high = mu["interval"]
    return f"{mu['value']:.3f} (from {mu['kind']}; {low:.3f} to {high:.3f} with 90 %); bounds "
