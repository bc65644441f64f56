"""The reproduction as one self-contained HTML page: every table and figure beside the paper's numbers."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jinja2

from pushfric_ros.paper_tables import Nested

GRID_SIZES = (4, 9, 15, 24)
CLOSE = 0.3
"""A number within this share of the reference is marked as agreeing with it."""


NONE = "\N{EN DASH}"


class Cell(NamedTuple):
    """A number of the report."""

    text: str
    detail: str = ""  # quartiles, or of how many
    tone: str = ""  # class of the style sheet


class Section(NamedTuple):
    """A table or a figure of the paper."""

    key: str
    title: str
    text: str
    heads: Sequence[str] = ()
    rows: Sequence[Sequence[Cell]] = ()


def html_report(summary: Nested, figures: Mapping[str, str]) -> str:
    """The page.

    Args:
        summary: the content of tables.json.
        figures: SVG elements by key.
    """
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    return environment.from_string(PAGE).render(
        seeds=summary["seeds"],
        verdicts=_verdicts(summary),
        sections=_sections(summary),
        figures=figures,
        misses=_misses(summary),
        close=round(100 * CLOSE),
    )


def number(value: float | None, digits: int = 2) -> str:
    """A number for people, in a cell."""
    if value is None:
        return NONE
    return "infeasible" if math.isinf(value) else f"{value:.{digits}f}"


def measured(leaf: Nested, digits: int = 2) -> Cell:
    """Median and quartiles; how often, for a truth value."""
    if "held" in leaf:
        tone = "good" if leaf["held"] >= 0.95 * leaf["of"] else "off"
        return Cell(f"{leaf['held']} of {leaf['of']}", tone=tone)
    low, high = leaf["quartiles"]
    tone = ""
    if leaf.get("reference"):
        tone = "good" if abs(leaf["median"] / leaf["reference"] - 1) <= CLOSE else "off"
    same = low == high == leaf["median"]
    return Cell(number(leaf["median"], digits), "" if same else f"{number(low, digits)} … {number(high, digits)}", tone)


def _known(leaf: Nested, digits: int = 2) -> tuple[Cell, Cell]:
    """What the paper and the reference have."""
    if leaf.get("paper") is True:
        return Cell("yes"), Cell(NONE)
    return Cell(number(leaf.get("paper"), digits)), Cell(number(leaf.get("reference"), digits))


def _row(name: str, leaf: Nested, digits: int = 2) -> list[Cell]:
    return [Cell(name), *_known(leaf, digits), measured(leaf, digits)]


BESIDE = ("paper", "reference", "this run: median (quartiles)")


def _sections(summary: Nested) -> list[Section]:
    """In the paper's order."""
    objects = ("delrin_rect_center", "delrin_rect_right")
    table2 = [
        _row(f"{name}, {size} points, {axis}", summary["table2"][name][f"grid_{size}"][f"percent_{axis}"])
        for name in objects
        for size in GRID_SIZES
        for axis in ("x", "y")
    ]
    table3 = [
        _row(f"{name.replace('_all_data', ' (all data)').replace('_slipping', ' (slipping only)')}, {label}", leaves[key])
        for name, leaves in summary["table3"].items()
        for key, label in (("p90", "90 %"), ("p100", "100 %"), ("low", "lowest"), ("high", "highest"))
        if key in leaves
    ]
    figure5 = [
        _row(f"{name}: {label}", summary["figure5"][name][key], digits)
        for name in ("wood_rect4", "rubber_rect4")
        for key, label, digits in (
            ("corners_are_top_four", "the four largest weights are the feet", 0),
            ("weight_at_corners", "share of w at the feet", 2),
            ("nonzero_weights", "nonzero weights", 0),
            ("percent_x", "error of p_CF in x [%]", 2),
            ("percent_y", "error of p_CF in y [%]", 2),
        )
    ]
    figure11 = [
        _row(f"{points.removeprefix('points_')} data points, {axis} [%]", leaves[f"percent_{axis}"])
        for points, leaves in summary["figure11"].items()
        for axis in ("x", "y")
    ]
    figure13 = [
        _row(f"{case}: {label}", leaves[key])
        for name, case in (
            ("feet", "least squares, actual supports"),
            ("grid_15", "least squares, 15 points"),
            ("grid_15_nonnegative", "least squares with w ≥ 0"),
            ("grid_15_linear_program", "linear program"),
        )
        for leaves in [summary["figure13"][name]]
        for key, label in (("percent_x", "x [%]"), ("percent_y", "y [%]"), ("w_min", "least w"), ("w_max", "largest w"))
    ]
    rods, tests = summary["figure12"], summary["test_pushes"]
    return [
        Section(
            "table1",
            "Table 1: data points",
            "How many data points the pushes of each object gave. Where the contacts lie and when a push ends is not in the "
            "paper; both are chosen for numbers like these.",
            ("object", *BESIDE),
            [_row(name, leaf["data_points"], 0) for name, leaf in summary["table1"].items()],
        ),
        Section(
            "figure3",
            "Figure 3: trajectories",
            "Two pushes of rubber_rect4 as the camera saw them, smoothed: outline and contact at each data point. The pusher "
            "moves upwards.",
        ),
        Section(
            "table2",
            "Table 2: centre of friction over four grids",
            "Error of the estimated p_CF, in percent of the object's sides.",
            ("object, grid, axis", *BESIDE),
            table2,
        ),
        Section(
            "figure5",
            "Figure 5: support friction distribution",
            "w over 15 points; area is proportional to w, x marks zero. The feet are at the corner points.",
            ("", *BESIDE),
            figure5,
        ),
        Section(
            "figure6",
            "Figure 6: feet that are not on the grid",
            "w of delrin_square3 over 6 x 6 points. Rings mark the feet.",
            ("", *BESIDE),
            [_row("share of w within 1 cm of a foot", summary["figure6"]["weight_within_1_cm"])],
        ),
        Section(
            "table3",
            "Table 3: contact friction",
            "Lower bounds on mu_c: the values below which 90 % and 100 % of them lie. The simulated truth is 0.2 (delrin), 0.3 "
            "(wood), 0.9 (rubber).",
            ("object, share of the bounds", *BESIDE),
            table3,
        ),
        Section(
            "figure7", "Figure 7: a vision error in one push", "One seed. The outlier at the right of (a) is the bad push."
        ),
        Section("figure8", "Figure 8: slipping contact", "One seed. Pushes at sharp angles slip: (b) clusters around mu_c."),
        Section(
            "table4",
            "Table 4: which centre of friction has delrin_rect_center?",
            "Fit error [cm] and its ratio to the best hypothesis. Errors are scaled to the paper's 36 data points. The last "
            "column frees supports near the centre of rotation, which is pushfric's default and not in the paper.",
            (
                "grid, hypothesis",
                "paper",
                "reference",
                "fit error",
                "ratio: paper",
                "reference",
                "this run",
                "with cor_radius auto",
            ),
            _recognition(summary, "table4"),
        ),
        Section(
            "table5",
            "Table 5: and delrin_rect_right?",
            "The same, scaled to 32 data points.",
            (
                "grid, hypothesis",
                "paper",
                "reference",
                "fit error",
                "ratio: paper",
                "reference",
                "this run",
                "with cor_radius auto",
            ),
            _recognition(summary, "table5"),
        ),
        Section(
            "figure9",
            "Figure 9: orientation of wood_rect3",
            "Median fit error and quartiles over all seeds. The true orientation should fit best at every half-width.",
            ("half-width", "supports only", "with the centre of friction"),
            _orientations(summary["figure9"]),
        ),
        Section(
            "figure10",
            "Figure 10: orientation of delrin_square3",
            "As Figure 9, with four orientations.",
            ("half-width", "supports only", "with the centre of friction"),
            _orientations(summary["figure10"]),
        ),
        Section(
            "figure11",
            "Figure 11: how many data points are enough",
            "rubber_rect4: error of p_CF from random subsets of the data points, mean of 10 samplings at each size. The "
            "paper's curve is flat after 20 data points.",
            ("", *BESIDE),
            figure11,
        ),
        Section(
            "test_pushes",
            "Section 6.2: without support points",
            "delrin_rect_right: each push cuts off the side of its line of motion on which p_CF cannot be. The paper gives no "
            "numbers.",
            ("", *BESIDE),
            [
                _row("area left [cm²]", tests["area_cm2"]),
                _row("error of its centroid in x [%]", tests["percent_x"]),
                _row("error of its centroid in y [%]", tests["percent_y"]),
            ],
        ),
        Section(
            "figure12",
            "Figure 12: two rods that pushing cannot tell apart",
            "Sections fx = 0 of their limit surfaces; what frictionless pushes along the rod reach is blue. The surfaces "
            "differ, the reachable parts do not. With a contact friction of 1 the best push differs by "
            f"{rods['deviations_with_mu_c_1']['median']:.1f} standard deviations of a good camera.",
            ("", *BESIDE),
            [_row("largest difference of reachable wrenches", rods["largest_difference_of_reachable_wrenches"])],
        ),
        Section(
            "figure13",
            "Figure 13 and section 7: least squares",
            "wood_rect4. Unconstrained least squares, by singular value decomposition, serves while the supports are known and "
            "breaks down on 15 points: red dots are negative weights.",
            ("", *BESIDE),
            figure13,
        ),
    ]


def _recognition(summary: Nested, table: str) -> list[list[Cell]]:
    rows = []
    for size in GRID_SIZES:
        numbers, freed = summary[table][f"grid_{size}"], summary[f"{table}_default"][f"grid_{size}"]
        for name in ("left", "center", "right"):
            error, ratio = numbers[f"error_{name}"], numbers[f"ratio_{name}"]
            cells = [*_known(error), measured(error), *_known(ratio), measured(ratio), measured(freed[f"ratio_{name}"])]
            rows.append([Cell(f"{size} points, {name}"), *cells])
        blank = Cell("")
        right, right_freed = measured(numbers["correct"]), measured(freed["correct"])
        rows.append([Cell(f"{size} points: right object"), Cell("yes"), blank, right, blank, blank, blank, right_freed])
    return rows


def _orientations(numbers: Nested) -> list[list[Cell]]:
    return [
        [
            Cell(key.removeprefix("half_width_").replace("_", " ")),
            *(measured(numbers[case][key]["correct"]) for case in ("supports", "supports_and_center")),
        ]
        for key in numbers["supports"]
    ]


def _verdicts(summary: Nested) -> list[Cell]:
    """The claims of the paper, and whether they hold here; the worst case of each."""

    def worst(leaves: Sequence[Nested]) -> Nested:
        return min(leaves, key=lambda leaf: leaf["held"] / leaf["of"])

    fine = [summary[table][f"grid_{size}"]["correct"] for table in ("table4", "table5") for size in (9, 15, 24)]
    corners = [leaves["corners_are_top_four"] for leaves in summary["figure5"].values()]
    turns = [
        leaf["correct"] for figure in ("figure9", "figure10") for case in summary[figure].values() for leaf in case.values()
    ]
    claims = (
        ("the right one of three look-alikes (Tables 4, 5; 9 points and more)", worst(fine)),
        ("the four feet found among 15 points (Figure 5)", worst(corners)),
        ("the true orientation, at every half-width (Figures 9, 10)", worst(turns)),
    )
    cells = [Cell(measured(leaf).text, text, measured(leaf).tone) for text, leaf in claims]
    ratios = [
        leaf
        for table in ("table4", "table5")
        for grid in summary[table].values()
        for key, leaf in grid.items()
        if key.startswith("ratio") and "reference" in leaf
    ]
    close = sum(measured(leaf).tone == "good" for leaf in ratios)
    text = f"ratios of Tables 4 and 5 within {round(100 * CLOSE)} % of the reference"
    return [*cells, Cell(f"{close} of {len(ratios)}", text, "good" if close == len(ratios) else "off")]


def _misses(summary: Nested) -> list[tuple[str, str]]:
    """What does not reproduce: the fact with this run's number, and the likely reason."""
    table2 = summary["table2"]
    errors = [table2[name]["grid_24"]["percent_y"] for name in ("delrin_rect_center", "delrin_rect_right")]
    coarse = summary["table4"]["grid_4"]["error_center"]
    nonzero = summary["figure5"]["rubber_rect4"]["nonzero_weights"]
    slip, wood3 = summary["table3"]["rubber_rect4_slipping"], summary["table3"]["wood_rect3"]
    negative = summary["figure13"]["grid_15"]
    return [
        (
            "Table 2, errors in y: "
            + ", ".join(f"{number(leaf['paper'], 1)} % there and {number(leaf['median'], 1)} % here" for leaf in errors)
            + " with 24 points.",
            "From 9 points on, the paper's errors in y all have the same sign, for both objects: a bias of its camera or its "
            "table, such as a tilt or a misplaced origin. The simulation has none.",
        ),
        (
            f"The 4-point grid: a fit error of {number(coarse['paper'], 0)} cm there, {number(coarse['median'], 0)} cm here; a "
            "wrong hypothesis is often infeasible here.",
            "Four points at the corners cannot stand for a flat bottom, so the number says most about where exactly they were "
            "and which pushes were made, which the paper does not tell.",
        ),
        (
            f"Exactly four nonzero weights (rubber_rect4): {number(nonzero['median'], 0)} here.",
            "Noise gives a few other points small weights; that there were none in the paper is a matter of one data set.",
        ),
        (
            f"The spread of Figure 8 (b): {number(slip['low']['paper'])} to {number(slip['high']['paper'])} there, "
            f"{number(slip['low']['median'])} to {number(slip['high']['median'])} here.",
            "The simulated mu_c is one number; a rubber band's varies from place to place and with speed.",
        ),
        (
            f"Table 3, wood_rect3: {number(wood3['p90']['paper'])} and {number(wood3['p100']['paper'])} there, "
            f"{number(wood3['p90']['median'])} and {number(wood3['p100']['median'])} here.",
            "Where its feet are is a guess, and pushes that turn it about one of them tell little of that foot's force.",
        ),
        (
            f"Figure 13 on 15 points: weights from {number(negative['w_min']['paper'], 1)} to "
            f"{number(negative['w_max']['paper'], 1)} there, {number(negative['w_min']['median'], 1)} to "
            f"{number(negative['w_max']['median'], 1)} here.",
            "Both are meaningless; how large they get depends on the smallest singular values of one data set.",
        ),
    ]


PAGE = """\
<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Lynch 1993, reproduced</title>
<style>
:root { --ink: #222; --soft: #6b6b6b; --line: #e4e2dd; --paper: #fbfaf7; --blue: #2563a8; --good: #2f7d4f; --off: #c2410c; }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink); font: 16px/1.55 system-ui, sans-serif; }
main { max-width: 62rem; margin: 0 auto; padding: 3rem 1.5rem 5rem; }
h1 { font-size: 2.1rem; line-height: 1.2; margin: 0 0 .4rem; }
h2 { font-size: 1.25rem; margin: 0 0 .3rem; }
p { margin: .3rem 0 1rem; max-width: 46rem; }
.soft { color: var(--soft); }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(12rem, 1fr)); gap: 1rem; margin: 2rem 0; }
.card { background: #fff; border: 1px solid var(--line); border-radius: .6rem; padding: 1rem 1.1rem; font-size: .9rem; }
.card b { display: block; font-size: 1.7rem; }
nav { columns: 2 20rem; margin: 0 0 1rem; font-size: .92rem; }
nav a { display: block; color: var(--blue); text-decoration: none; }
nav a:hover { text-decoration: underline; }
section { background: #fff; border: 1px solid var(--line); border-radius: .6rem; padding: 1.4rem 1.6rem; margin: 1.4rem 0; }
figure { margin: .6rem 0; } figure svg { max-width: 100%; height: auto; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .88rem; font-variant-numeric: tabular-nums; margin: .5rem 0; }
th, td { text-align: right; padding: .25rem .8rem; border-bottom: 1px solid var(--line); }
th { font-weight: 600; color: var(--soft); vertical-align: bottom; }
td { white-space: nowrap; }
th:first-child, td:first-child { text-align: left; padding-left: 0; }
td small { color: var(--soft); margin-left: .5em; }
.good { color: var(--good); font-weight: 600; } .off { color: var(--off); font-weight: 600; }
dt { font-weight: 600; margin-top: .9rem; } dd { margin: .1rem 0 0; color: var(--soft); max-width: 46rem; }
</style>
</head>
<body>
<main>
<h1>Estimating the friction parameters of pushed objects</h1>
<p class="soft">The tables and figures of Lynch 1993 on simulated pushes of its six objects: {{ seeds }} seeds of camera
noise and of the operator's hand, estimated with the paper's settings. Every number of this run was computed from them.</p>
<div class="cards">
{% for card in verdicts %}
<div class="card"><b class="{{ card.tone }}">{{ card.text }}</b>{{ card.detail }}</div>
{% endfor %}
</div>
<p>The reference is the median of another simulation with the same noise, written apart from this one.
<span class="good">Green</span>: within {{ close }} % of it, or held in 19 of 20 seeds.
<span class="off">Red</span>: not. Lengths are in centimetres; the unit of force is the support friction of the translating
object.</p>
<nav>
{% for section in sections %}
<a href="#{{ section.key }}">{{ section.title }}</a>
{% endfor %}
<a href="#misses">What does not reproduce</a>
</nav>
{% for section in sections %}
<section id="{{ section.key }}">
<h2>{{ section.title }}</h2>
<p>{{ section.text }}</p>
{% if section.key in figures %}
<figure>{{ figures[section.key] | safe }}</figure>
{% endif %}
{% if section.rows %}
<div class="wide"><table>
<tr>{% for head in section.heads %}<th>{{ head }}</th>{% endfor %}</tr>
{% for row in section.rows %}
<tr>
{% for cell in row %}
<td class="{{ cell.tone }}">{{ cell.text }}{% if cell.detail %}<small>{{ cell.detail }}</small>{% endif %}</td>
{% endfor %}
</tr>
{% endfor %}
</table></div>
{% endif %}
</section>
{% endfor %}
<section id="misses">
<h2>What does not reproduce, and why</h2>
<dl>
{% for fact, reason in misses %}
<dt>{{ fact }}</dt><dd>{{ reason }}</dd>
{% endfor %}
</dl>
</section>
</main>
</body>
</html>
"""
