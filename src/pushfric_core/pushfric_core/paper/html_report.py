"""The reproduction as one self-contained HTML page: every table and figure next to the paper's numbers."""

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from pushfric_core.geometry.table_1 import TABLE_1
from pushfric_core.paper.claims import CLOSE, CLOSE_MU, Claim, agrees
from pushfric_core.paper.experiments import CONDUCT, GRIDS
from pushfric_core.paper.tables import Nested
from pushfric_core.report.page import INFEASIBLE, NONE, Cell, Section, Table, number, page

MEASURED = {"delrin": "0.1 … 0.3", "wood": "0.2 … 0.4", "rubber": "0.7 … 1.1"}
"""The author's own measurements of mu_c, Table 3."""


def html_report(summary: Nested, claims: Sequence[Claim], figures: Mapping[str, str]) -> str:
    """The page.

    Args:
        summary: the content of tables.json.
        claims: as `claims.claims` gives them.
        figures: SVG files by key, as `figures.figures` gives them.
    """
    return page(
        __package__,
        "report.html.j2",
        seeds=summary["seeds"],
        code=summary["code"],
        verdicts=_verdicts(claims),
        sections=_sections(summary),
        figures={key: text[text.index("<svg") :] for key, text in figures.items()},
        differing=_differing(summary),
        close=round(100 * CLOSE),
        close_mu=CLOSE_MU,
        infeasible=INFEASIBLE,
    )


def measured(leaf: Nested, digits: int = 2, absolute: float | None = None, error: bool = False) -> Cell:
    """Median and quartiles of a number; for a truth value, how often it held.

    Args:
        leaf: of tables.json.
        digits: decimal places.
        absolute: as for `agrees`.
        error: whether the number is an error of p_CF, which is better the smaller it is.
    """
    tone = {True: "good", False: "off", None: ""}[agrees(leaf, absolute)]
    if error and tone == "off" and leaf["median"] < leaf["reference"]:
        tone = "better"
    if "held" in leaf:
        return Cell(f"{leaf['held']} of {leaf['of']}", tone=tone)
    low, high = leaf["quartiles"]
    same = number(low, digits) == number(high, digits)
    return Cell(number(leaf["median"], digits), "" if same else f"{number(low, digits)} … {number(high, digits)}", tone)


def _paper(leaf: Nested, digits: int = 2) -> Cell:
    return Cell("yes" if leaf.get("paper") is True else number(leaf.get("paper"), digits))


def _reference(leaf: Nested, digits: int = 2) -> Cell:
    return Cell(number(leaf.get("reference"), digits))


def _all(leaf: Nested, digits: int = 2, absolute: float | None = None, error: bool = False) -> list[Cell]:
    return [_paper(leaf, digits), _reference(leaf, digits), measured(leaf, digits, absolute, error)]


def _point(leaf: Nested, source: str) -> Cell:
    """The centre of friction as the paper prints it."""
    known = [leaf[axis].get(source) for axis in ("x", "y")]
    return Cell(NONE if None in known else f"({number(known[0])}, {number(known[1])})")


def _sections(summary: Nested) -> list[Section]:
    """All tables and figures, in the paper's order."""
    whole = float(np.prod(TABLE_1["delrin_rect_right"].outline.size)) * 1e4
    return [
        Section(
            "table1",
            "Table 1: data points",
            "The number of data points from each object's pushes. Contacts are evenly spaced along the edges. Those of the "
            f"objects on feet lie nearer to the middle, at {100 * CONDUCT['delrin_square3'].closer:.0f} % (square) and "
            f"{100 * CONDUCT['wood_rect4'].closer:.0f} % (others) of the even distance, because an object pushed nearer to "
            "its corners turns about a foot. Pushes run over the whole stroke of 5 cm. Those of the flat objects, which in the "
            "paper "
            "“tended to rotate quickly, resulting in fewer useful data points”, end after a turn of "
            f"{math.degrees(CONDUCT['delrin_rect_center'].longest_turn):.0f}°.",
            Table(
                ("object", "paper", "this run"),
                [
                    [Cell(name), _paper(leaf["data_points"], 0), measured(leaf["data_points"], 0)]
                    for name, leaf in summary["table1"].items()
                ],
            ),
        ),
        Section(
            "figure3",
            "Figure 3: trajectories",
            "Two pushes of rubber_rect4 in the table frame, as the camera saw them, smoothed: outline and contact at each data "
            "point, darker with time. The pusher moves upwards along x = 0.",
        ),
        Section(
            "table2",
            "Table 2 and Figure 4: centre of friction over four grids",
            "Estimated p_CF, and its error in percent of the object's sides. The figure shows the grids with each seed's "
            "estimate next to the paper's.",
            _table2(summary["table2"]),
        ),
        Section(
            "figure5",
            "Figure 5: support friction distribution",
            "w over 15 points; the feet are at the four corners. The figure shows one seed.",
            _figure5(summary["figure5"]),
        ),
        Section(
            "figure6",
            "Figure 6: feet that are not on the grid",
            "w of delrin_square3 over 6 by 6 points; the figure shows one seed. In the paper, too, w gathers at the points "
            "near the feet, but the paper gives no number.",
            Table(
                ("", "reference", "this run"),
                [
                    [Cell(label), _reference(leaf), measured(leaf)]
                    for label, leaf in (
                        ("share of w within 1 cm of a foot", summary["figure6"]["weight_within_1_cm"]),
                        ("error of p_CF in x [%]", summary["figure6"]["percent_x"]),
                        ("error of p_CF in y [%]", summary["figure6"]["percent_y"]),
                    )
                ],
            ),
        ),
        Section(
            "table3",
            "Table 3: contact friction",
            "Values below which 90 % and 100 % of the lower bounds on mu_c lie. For the pushes with slipping contact: the "
            "lowest and the highest bound.",
            _table3(summary["table3"]),
        ),
        Section(
            "figure7",
            "Figure 7: a vision error in one push",
            "Lower bounds on mu_c of one seed. The outlier of (a) comes from a bad push of six data points; (b) leaves it out.",
        ),
        Section(
            "figure8",
            "Figure 8: slipping contact",
            "Lower bounds on mu_c of one seed. If the contact sticks, they say little (a). In pushes at sharp angles it slips, "
            "and they gather around mu_c (b).",
        ),
        Section(
            "table4",
            "Table 4: which centre of friction has delrin_rect_center?",
            "Fit error of each hypothesis, and its ratio to the best one. Errors are scaled to the paper's 36 data points. The "
            "last column frees supports near the centre of rotation, which is pushfric's default. All others use the paper's "
            "method, cor_radius 0.",
            _recognition(summary, "table4"),
        ),
        Section(
            "table5",
            "Table 5: which one has delrin_rect_right?",
            "The same, scaled to 32 data points.",
            _recognition(summary, "table5"),
        ),
        Section(
            "figure9",
            "Figure 9: orientation of wood_rect3",
            "Median fit error over all seeds, with quartiles. In the table: how often the true orientation fits best.",
            _orientations(summary, "figure9"),
        ),
        Section(
            "figure10",
            "Figure 10: orientation of delrin_square3",
            "As Figure 9, with four orientations. With wide contact intervals several orientations may fit exactly; then no "
            "single one is best. The last two columns use 85 of the data points, drawn at random: as many as the paper had.",
            _orientations(summary, "figure10", "figure10_fewer_data_points"),
        ),
        Section(
            "figure11",
            "Figure 11: how many data points are enough",
            "rubber_rect4: error of p_CF from random subsets of the data points, mean of 10 samplings. In the paper it "
            "“decreases little after 20 data points”, and nearly all samplings of 20 and more find the four supports.",
            Table(
                ("data points", "reference", "this run", "reference", "this run", "this run"),
                [
                    [
                        Cell(points.removeprefix("points_")),
                        *_all(leaf["percent_x"], error=True)[1:],
                        *_all(leaf["percent_y"], error=True)[1:],
                        measured(leaf["share_with_correct_supports"]),
                    ]
                    for points, leaf in summary["figure11"].items()
                ],
                (("", 1), ("error in x [%]", 2), ("error in y [%]", 2), ("share with the four supports", 1)),
            ),
        ),
        Section(
            "figure12",
            "Figure 12: two rods that pushing cannot distinguish",
            "Sections f_x = 0 of their limit surfaces. They differ, but the part that frictionless pushes along the rod reach "
            "(blue) is the same. The table gives the largest difference of the reachable wrenches. It then gives the number "
            "of standard deviations by which the best single push distinguishes the rods: rods 2 m long, a contact that moves "
            "by 1 cm, and a motion seen with standard deviations of 0.1 mm and 1 mrad.",
            Table(
                ("", "paper", "this run"),
                [
                    [Cell(label), Cell(paper), Cell(number(summary["figure12"][key]["median"]))]
                    for label, key, paper in (
                        ("largest difference of reachable wrenches", "largest_difference_of_reachable_wrenches", "identical"),
                        ("standard deviations, without friction", "deviations_without_friction", "indistinguishable"),
                        ("standard deviations, with a mu_c of 1", "deviations_with_mu_c_1", NONE),
                    )
                ],
            ),
        ),
        Section(
            "test_pushes",
            "Section 6.2: without support points",
            "delrin_rect_right: each push cuts off the side of its line of motion on which p_CF cannot lie. The paper "
            "describes the method and gives no numbers.",
            Table(
                ("", "this run"),
                [
                    [Cell(label), measured(summary["test_pushes"][key])]
                    for label, key in (
                        (f"area left of {number(whole)} cm²", "area_cm2"),
                        ("error of its centroid in x [%]", "percent_x"),
                        ("error of its centroid in y [%]", "percent_y"),
                    )
                ],
            ),
        ),
        Section(
            "figure13",
            "Figure 13 and section 7: least squares",
            "wood_rect4. Unconstrained least squares, by singular value decomposition, works if the supports are known and "
            "breaks down on 15 points. Least squares with w ≥ 0 and the linear program do not.",
            _figure13(summary["figure13"]),
        ),
    ]


def _table2(numbers: Nested) -> Table:
    rows = []
    for name, grids in numbers.items():
        x, y = TABLE_1[name].support.center_of_friction * 100
        rows.append([Cell(f"{name}: p_CF at ({number(x, 1)}, {number(y, 1)})")])
        for grid, leaf in grids.items():
            rows.append(
                [
                    Cell(grid.removeprefix("grid_")),
                    _point(leaf, "paper"),
                    _point(leaf, "median"),
                    _paper(leaf["percent_x"], 1),
                    measured(leaf["percent_x"], error=True),
                    _paper(leaf["percent_y"], 1),
                    _reference(leaf["percent_y"]),
                    measured(leaf["percent_y"], error=True),
                ]
            )
    return Table(
        ("points", "paper", "this run", "paper", "this run", "paper", "reference", "this run"),
        rows,
        (("", 1), ("p_CF [cm]", 2), ("error in x [%]", 2), ("error in y [%]", 3)),
    )


def _table3(numbers: Nested) -> Table:
    rows = []
    for name, leaves in numbers.items():
        label = name.replace("_all_data", ", with the bad push").replace("_slipping", ", slipping contact only")
        known = TABLE_1[name.removesuffix("_all_data").removesuffix("_slipping")]
        low, high = (leaves[key] for key in (("low", "high") if "low" in leaves else ("p90", "p100")))
        rows.append(
            [
                Cell(label),
                *_all(low, absolute=CLOSE_MU),
                *_all(high, absolute=CLOSE_MU),
                Cell(MEASURED[name.split("_")[0]]),
                Cell(number(known.mu_c, 1)),
            ]
        )
    return Table(
        ("object", "paper", "reference", "this run", "paper", "reference", "this run", "measured", "simulated"),
        rows,
        (("", 1), ("90 %, or lowest", 3), ("100 %, or highest", 3), ("paper", 1), ("truth", 1)),
    )


def _figure5(numbers: Nested) -> Table:
    labels = {
        "corners_are_top_four": ("the four largest weights are the feet", 0, None),
        "weight_at_corners": ("share of w at the feet", 2, None),
        "nonzero_weights": ("nonzero weights", 0, None),
        "percent_x": ("error of p_CF in x [%]", 2, "< 2"),
        "percent_y": ("error of p_CF in y [%]", 2, "< 2"),
    }
    rows = []
    for key, (label, digits, said) in labels.items():
        row = [Cell(label)]
        for leaves in numbers.values():
            row += [Cell(said) if said else _paper(leaves[key], digits), measured(leaves[key], digits)]
        rows.append(row)
    return Table(("", "paper", "this run", "paper", "this run"), rows, (("", 1), *((name, 2) for name in numbers)))


def _recognition(summary: Nested, table: str) -> Table:
    rows = []
    for size in GRIDS:
        numbers, freed = summary[table][f"grid_{size}"], summary[f"{table}_default"][f"grid_{size}"]
        right, right_freed = measured(numbers["correct"]), measured(freed["correct"])
        rows.append(
            [Cell(f"{size} points: the right one in {right.text}; with cor_radius auto in {right_freed.text}", tone=right.tone)]
        )
        for name in ("left", "center", "right"):
            error, ratio = numbers[f"error_{name}"], numbers[f"ratio_{name}"]
            rows.append([Cell(name), *_all(error), *_all(ratio), measured(freed[f"ratio_{name}"])])
    return Table(
        ("hypothesis", "paper", "reference", "this run", "paper", "reference", "this run", "this run"),
        rows,
        (("", 1), ("fit error [cm]", 3), ("ratio to the best", 3), ("with cor_radius auto", 1)),
    )


def _orientations(summary: Nested, *keys: str) -> Table:
    cases = [summary[key][case] for key in keys for case in ("supports", "supports_and_center")]
    rows = [
        [
            Cell(half_width.removeprefix("half_width_").replace("_", " ")),
            *(measured(case[half_width]["correct"]) for case in cases),
        ]
        for half_width in cases[0]
    ]
    heads = ("half-width", *("supports only", "with p_CF") * len(keys))
    return Table(heads, rows, (("", 1), ("all data points", 2), ("85 data points", 2)) if len(keys) > 1 else ())


def _figure13(numbers: Nested) -> Table:
    labels = {
        "feet": "least squares, actual supports",
        "grid_15": "least squares, 15 points",
        "grid_15_nonnegative": "least squares with w ≥ 0, 15 points",
        "grid_15_linear_program": "linear program, 15 points",
    }
    parts = {"percent_x": "error in x [%]", "percent_y": "error in y [%]", "w_min": "least weight", "w_max": "largest weight"}
    rows = []
    for case, label in labels.items():
        leaf = numbers[case]
        rows.append([Cell(label)])
        rows.append([Cell("p_CF [cm]"), _point(leaf, "paper"), _point(leaf, "reference"), _point(leaf, "median")])
        rows += [[Cell(part), *_all(leaf[key], error=key.startswith("percent"))] for key, part in parts.items()]
    return Table(("", "paper", "reference", "this run"), rows)


def leaves(nested: Nested, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Nested]]:
    """All leaves of tables.json, with the keys that lead to them."""
    for key, value in nested.items():
        if isinstance(value, dict):
            if {"median", "held"} & value.keys():
                yield (*path, key), value
            else:
                yield from leaves(value, (*path, key))


def _verdicts(claims: Sequence[Claim]) -> list[Cell]:
    """A card for each claim: how often it holds, with its spread."""
    return [
        Cell(f"{claim.held} of {claim.of}", claim.text, "good" if claim.reproduced else "off", _spread(claim))
        for claim in claims
    ]


def _spread(claim: Claim) -> str:
    low, high = claim.spread
    if claim.about_seeds:
        return f"in {100 * low:.0f} to {100 * high:.0f} % of all seeds"
    return f"with other seeds {low:.0f}" + f" to {high:.0f}" * (low < high)


def _differing(summary: Nested) -> Table:
    """All numbers that do not agree with the reference."""
    rows = []
    for path, leaf in leaves(summary):
        absolute = CLOSE_MU if path[0] == "table3" else None
        if agrees(leaf, absolute) is False and "reference" in leaf:
            rows.append([Cell(" / ".join(path)), *_all(leaf, absolute=absolute, error=path[-1].startswith("percent"))])
    return Table(("", "paper", "reference", "this run"), rows)
