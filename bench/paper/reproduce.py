"""`./pushfric reproduce`: the paper's experiments for many seeds in parallel, as tables.json, images and an HTML report."""

import itertools
import math
import pathlib
from typing import Annotated

import typer
from rich.progress import track

from bench.paper.claims import CLOSE, CLOSE_MU, Claim, agrees, claims
from bench.paper.experiments import rods, run_seed
from bench.paper.figures import figures
from bench.paper.page import INFEASIBLE, NONE, Cell, Table, number, page
from bench.paper.pushes import CONDUCT
from bench.paper.tables import Nested, Path, leaves, tables
from pushfric_core.commands.console import console, say
from pushfric_core.commands.options import RUNS, DaskOption, JobsOption
from pushfric_core.files.disk import make_folder, write_whole
from pushfric_core.offline.many import results
from pushfric_core.records import to_json

COUNTS = ("data_points", "bad_data_points", "nonzero_weights")
"""Leaves of tables.json that are whole numbers."""


def reproduce(
    out: Annotated[pathlib.Path, typer.Option(help="Folder to write: the report.")] = RUNS / "reproduce",
    seeds: Annotated[int, typer.Option(help="Number of repetitions, each with its own noise.", min=1, max=10_000)] = 20,
    jobs: JobsOption = -1,
    dask: DaskOption = None,
) -> None:
    """Reproduce the paper's tables and figures from simulated pushes: report.html, tables.json, images."""
    make_folder(out)
    make_folder(out / "figures")
    found = list(track(results(run_seed, range(seeds), jobs, dask), "seeds", seeds, console=console))
    found.sort(key=lambda one: one.seed)
    of_rods, drawn_rods = rods()
    numbers = [{**one.numbers, "figure12": of_rods} for one in found]
    summary, claimed = tables(numbers), claims(numbers)
    said = {"seeds": seeds, "claims": [claim._asdict() for claim in claimed], **summary}
    write_whole(out / "tables.json", f"{to_json(said)}\n")
    images = figures(summary, found, drawn_rods)
    for name, content in images.items():
        write_whole(out / "figures" / name, content)
    report = out / "report.html"
    content = page(
        "report.html.j2",
        seeds=seeds,
        verdicts=[_card(claim) for claim in claimed],
        tables={key: table({key: nested}) for key, nested in summary.items()},
        figures={name[:-4]: image[image.index(b"<svg") :].decode() for name, image in images.items() if name.endswith(".svg")},
        conduct=CONDUCT,
        turn=math.degrees(CONDUCT["delrin_rect_center"].longest_turn),
        close=round(100 * CLOSE),
        close_mu=CLOSE_MU,
        infeasible=INFEASIBLE,
    )
    write_whole(report, content)
    say(f"report: {report}")


def table(nested: Nested) -> Table:
    """A part of tables.json, beside the paper's numbers and the reference's: a row for each case, a column for each kind."""
    rows: dict[str, dict[str, list[Cell]]] = {}
    for path, leaf in leaves(nested):
        _, *case, kind = path
        what, _, hypothesis = kind.partition("_")
        if hypothesis in ("left", "center", "right"):
            case, kind = [*case, hypothesis], what
        rows.setdefault(", ".join(case), {})[kind] = cells(path, leaf)
    kinds = list(dict.fromkeys(kind for row in rows.values() for kind in row))
    empty = [Cell(NONE)] * 3
    columns = [
        (kind, place)
        for kind, place in itertools.product(kinds, range(3))
        if any(row.get(kind, empty)[place].text != NONE for row in rows.values())
    ]
    spans = itertools.groupby(kind.replace("_", " ") for kind, _ in columns)
    return Table(
        ("", *(("paper", "reference", "this run")[place] for _, place in columns)),
        [[Cell(name), *(row.get(kind, empty)[place] for kind, place in columns)] for name, row in rows.items()],
        (("", 1), *((kind, len(list(span))) for kind, span in spans)),
    )


def cells(path: Path, leaf: Nested) -> list[Cell]:
    """A number of the paper, of the reference and of this run; that of this run with its quartiles, or how often it held."""
    digits = 0 if path[-1] in COUNTS else 2
    tone = {True: "good", False: "off", None: ""}[agrees(path, leaf)]
    if tone == "off" and path[-1].startswith("percent") and leaf["median"] < leaf["reference"]:
        tone = "better"
    paper = "yes" if leaf.get("paper") is True else number(leaf.get("paper"), digits)
    reference = number(leaf.get("reference"), digits)
    if "held" in leaf:
        return [Cell(paper), Cell(reference), Cell(f"{leaf['held']} of {leaf['of']}", tone=tone)]
    low, high = (number(quartile, digits) for quartile in leaf["quartiles"])
    detail = "" if low == high else f"{low} … {high}"
    return [Cell(paper), Cell(reference), Cell(number(leaf["median"], digits), detail, tone)]


def _card(claim: Claim) -> Cell:
    """How often a claim holds, with its spread."""
    low, high = claim.spread
    spread = f"with other seeds {low:.0f}" + f" to {high:.0f}" * (low < high)
    if claim.about_seeds:
        spread = f"in {100 * low:.0f} to {100 * high:.0f} % of all seeds"
    return Cell(f"{claim.held} of {claim.of}", claim.text, "good" if claim.reproduced else "off", spread)
