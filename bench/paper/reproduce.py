"""`./pushfric reproduce`: the paper's experiments for many seeds in parallel, as tables.json, images and a report."""

import math
import pathlib
from typing import Annotated

import jinja2
import typer

from bench.paper.claims import CLOSE, CLOSE_MU, Claim, agrees, claims
from bench.paper.experiments import rods, run_seed
from bench.paper.figures import figures
from bench.paper.pushes import CLOSER, LONGEST_TURN
from bench.paper.tables import Nested, Path, leaves, number, table_of, tables
from bench.program import results_of
from docs import markdown
from pushfric_core.commands.console import say
from pushfric_core.commands.options import RUNS, DaskOption, JobsOption
from pushfric_core.files.disk import make_folder, write_whole
from pushfric_core.records import to_json

COUNTS = ("data_points", "bad_data_points", "nonzero_weights")
"""Leaves of tables.json that are whole numbers."""

WHOSE = ("the paper", "reference", "here")
"""Whose number a column has."""


def reproduce(
    out: Annotated[pathlib.Path, typer.Option(help="Folder to write: the report.")] = RUNS / "reproduce",
    seeds: Annotated[int, typer.Option(help="Number of repetitions, each with its own noise.", min=1, max=10_000)] = 20,
    jobs: JobsOption = -1,
    dask: DaskOption = None,
) -> None:
    """Reproduce the paper's tables and figures from simulated pushes: report.md, tables.json, images."""
    make_folder(out)
    found = sorted(results_of(run_seed, range(seeds), jobs, dask), key=lambda one: one.seed)
    of_rods, drawn_rods = rods()
    numbers = [{**one.numbers, "figure12": of_rods} for one in found]
    summary, claimed = tables(numbers), claims(numbers)
    said = {"seeds": seeds, "claims": [claim._asdict() for claim in claimed], **summary}
    write_whole(out / "tables.json", f"{to_json(said)}\n")
    images = figures(summary, found, drawn_rods)
    for name, content in images.items():
        write_whole(out / "figures" / f"{name}.svg", content)
    template = pathlib.Path(__file__).with_name("report.md.j2").read_text(encoding="utf-8")
    content = jinja2.Template(template, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True).render(
        seeds=seeds,
        claims=markdown.table(("claim", "holds", "with other seeds"), map(_row, claimed)),
        tables={key: table({key: nested}) for key, nested in summary.items()},
        figures=images,
        closer=CLOSER,
        turn=math.degrees(LONGEST_TURN),
        close=round(100 * CLOSE),
        close_mu=CLOSE_MU,
    )
    write_whole(out / "report.md", content)
    say(f"report: {out / 'report.md'}")


def table(nested: Nested) -> str:
    """A part of tables.json, beside the paper's numbers and the reference's: a row for each case, columns for each kind."""
    rows: dict[str, dict[str, str]] = {}
    for path, leaf in leaves(nested):
        _, *case, kind = path
        what, _, hypothesis = kind.partition("_")
        if hypothesis in ("left", "center", "right"):
            case, kind = [*case, hypothesis], what
        row = rows.setdefault(", ".join(case), {})
        row |= {f"{kind}, {whose}": cell for whose, cell in zip(WHOSE, cells(path, leaf), strict=True)}
    return table_of(rows, missing="")


def cells(path: Path, leaf: Nested) -> tuple[str, str, str]:
    """A number of the paper, of the reference and of this run; that of this run with its quartiles, or how often it held."""
    digits = 0 if path[-1] in COUNTS else 2
    paper = "yes" if leaf.get("paper") is True else number(leaf.get("paper"), digits)
    if "held" in leaf:
        here = f"{leaf['held']} of {leaf['of']}"
    else:
        low, high = (number(quartile, digits) for quartile in leaf["quartiles"])
        here = number(leaf["median"], digits) + ("" if low == high else f" ({low} … {high})")
    better = path[-1].startswith("percent") and "reference" in leaf and leaf["median"] < leaf["reference"]
    off = agrees(path, leaf) is False and not better
    return paper, number(leaf.get("reference"), digits), f"**{here}**" if off else here


def _row(claim: Claim) -> tuple[str, str, str]:
    """How often a claim holds, with its spread."""
    low, high = claim.spread
    spread = f"{low:.0f}" + f" to {high:.0f}" * (low < high)
    if claim.about_seeds:
        spread = f"in {100 * low:.0f} to {100 * high:.0f} % of all seeds"
    held = f"{claim.held} of {claim.of}"
    return claim.text, held if claim.reproduced else f"**{held}**", spread
