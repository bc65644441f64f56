"""The results as tables, and the plot of cost against M."""

import pathlib
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich import box
from rich.markup import escape
from rich.table import Table

from bench.contenders import CONTENDERS
from bench.verdict import Verdict

Figures = dict[str, Any]


def updates_table(updates: Sequence[Figures]) -> Table:
    """One row for each M and N; "-" for a contender that was too slow."""
    row_of = {(row["N"], row["M"], row["contender"]): row for row in updates}
    legend = "In each cell: median, 99th percentile, and the median as a multiple of pushfric's."
    table = Table(title="CPU ms of one new data point", caption=legend, box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("N", "M", *(name.replace("_", "\n") for name in CONTENDERS)):
        table.add_column(heading, justify="right", overflow="fold")
    last = None
    for n, m in dict.fromkeys(key[:2] for key in row_of):
        if n != last and last is not None:
            table.add_section()
        last = n
        own = row_of[n, m, "pushfric"]["median_cpu_ms"]
        cells = []
        for name in CONTENDERS:
            row = row_of.get((n, m, name))
            if row is None:
                cells.append("-")
                continue
            median, p99 = row["median_cpu_ms"], row["p99_cpu_ms"]
            cells.append(f"{_short(median)}\n{_short(p99)}" + f"\n{_short(median / own)}x" * (name != "pushfric"))
        table.add_row(str(n), str(m), *cells)
    return table


def verdict_table(verdicts: Iterable[Verdict], caption: str = "") -> Table:
    table = Table(title="Targets", caption=caption)
    for heading in ("target", "asked", "measured", ""):
        table.add_column(heading, justify="left" if heading == "target" else "right")
    for target, asked, measured, met in verdicts:
        mark = "[green]met[/]" if met else "[red]missed[/]"
        table.add_row(target, asked, *(("-", "not measured") if measured is None else (_short(measured), mark)))
    return table


def memory_table(rows: Sequence[Figures]) -> Table:
    table = Table("N", "bytes", title="Memory of one data point")
    for row in rows:
        table.add_row(str(row["N"]), f"{row['bytes']:.0f}")
    return table


def growth_table(rows: Sequence[Figures]) -> Table:
    """The cost of a data point when there are already many."""
    columns = {"median_ms": "median", "mean_ms": "mean", "p99_ms": "99 %", "longest_ms": "longest", "at_rest_ms": "at rest"}
    title = "One data point of many: CPU time in ms, memory in bytes"
    table = Table("M", *columns.values(), "bytes", title=title)
    for row in rows:
        table.add_row(str(row["M"]), *(f"{row[name]:.2f}" for name in columns), f"{row['bytes']:.0f}")
    return table


def tracker_table(figures: Figures) -> Table:
    table = Table("contour tracker, 640 x 480", "frames/s", "time over bare OpenCV's", title="One frame")
    for name in ("tracked", "found", "bare"):
        ratio = figures.get(f"{name}_ratio")
        table.add_row(name, f"{figures[f'{name}_fps']:.0f}", "" if ratio is None else f"{ratio:.2f}x")
    return table


def accuracy_table(figures: Figures) -> Table:
    """Error of p_CF for each support and rule, over the logs of real pushes."""
    rows: dict[tuple[str, str], dict[str, float]] = {}
    for row in figures["logs"]:
        rows.setdefault((row["support"], row["rule"]), {})[row["log"]] = row["error_m"]
    logs = list(dict.fromkeys(row["log"] for row in figures["logs"]))
    table = Table("support", "rule", *(log.split("__exp")[0] for log in logs), "median", "worst", title="Error of p_CF [mm]")
    for (support, rule), errors in rows.items():
        each = [_millimetres(errors[log]) if log in errors else "-" for log in logs]
        table.add_row(
            support, rule, *each, _millimetres(float(np.median(list(errors.values())))), _millimetres(max(errors.values()))
        )
    return table


def learning_table(figures: Figures) -> Table:
    """Error of p_CF against the number of pushes."""
    rows: dict[tuple[str, str], list[str]] = {}
    for row in figures["curve"]:
        cell = f"{_millimetres(row['median_m'])} / {_millimetres(row['p90_m'])}"
        rows.setdefault((row["support"], row["rule"]), []).append(cell)
    counts = list(dict.fromkeys(row["pushes"] for row in figures["curve"]))
    headings = [f"{count} pushes" for count in counts]
    table = Table("support", "rule", *headings, title="Error of p_CF [mm] from random pushes: median / 90th percentile")
    for (support, rule), cells in rows.items():
        table.add_row(support, rule, *cells)
    return table


def prediction_table(figures: Figures) -> Table:
    """Angles between predicted and measured motions, by what was fitted; each peer has the same mu_c."""
    caption = "Medians of each log, and their median; within: how often the motion was in the predicted 90 %."
    logs = list(dict.fromkeys(row["log"] for row in figures["twists"]))
    headings = ("support", "fitted", "model", *(log.split("__exp")[0] for log in logs), "median", "within")
    table = Table(*headings, title="Motion of pushes not fitted [degrees]", caption=caption)
    cells: dict[tuple[str, str], dict[str, Figures]] = {}
    for row in figures["twists"]:
        cells.setdefault((row["support"], row["fitted"]), {})[row["log"]] = row
    for (support, fitted), by_log in cells.items():
        within = f"{100 * np.mean([row['within_90'] for row in by_log.values()]):.0f} %"
        for model in next(iter(by_log.values()))["median_deg"]:
            medians = {log: row["median_deg"][model] for log, row in by_log.items()}
            each = [f"{medians[log]:.1f}" if log in medians else "-" for log in logs]
            median = f"{np.median(list(medians.values())):.1f}"
            table.add_row(support, fitted, model, *each, median, within if model == "pushfric" else "")
    return table


def stability_table(figures: Figures) -> Table:
    """How well each model predicts which two-finger pushes hold the object, learned from the point pushes of each log."""
    models = list(figures["stability"][0]["balanced_accuracy"]) if figures["stability"] else []
    table = Table("object", "learned from", *models, title="Stable pushes, balanced accuracy")
    for row in figures["stability"]:
        table.add_row(row["object"], row["log"], *(f"{row['balanced_accuracy'][model]:.2f}" for model in models))
    return table


def strokes_table(figures: Figures) -> Table:
    """Where strokes of simulated objects end, predicted from few pushes, compared with the truth."""
    title = "Strokes of 50 mm, predicted from 14 pushes: median / 90th percentile of the error"
    table = Table("object", "strokes", "mu_c from", "position [mm]", "angle [degrees]", title=title)
    for row in figures["strokes"]:
        cells = (f"{row[f'median_{unit}']:.2f} / {row[f'p90_{unit}']:.2f}" for unit in ("mm", "deg"))
        table.add_row(row["object"], str(row["strokes"]), ", ".join(row["mu_c"]), *cells)
    return table


def services_table(figures: Figures) -> Table:
    """Delays of answers and of estimates in one run, in which a client asks during every second push."""
    table = Table(
        "delay", "count", "p50 [ms]", "p90 [ms]", "p99 [ms]", title="Services of the estimator, asked 20 times a second"
    )
    rows = {
        "an answer, as the client sees it": figures["answers"],
        "an estimate, pushes with questions": figures["estimates"]["asked"],
        "an estimate, pushes without": figures["estimates"]["quiet"],
    }
    for name, row in rows.items():
        table.add_row(name, str(row["count"]), *(f"{row[key]:.1f}" for key in ("p50_ms", "p90_ms", "p99_ms")))
    return table


def live_table(figures: Figures) -> Table:
    """Results of the live graph and the recorder, in real time."""
    pipeline, recording = figures["pipeline"], figures["recording"]
    latency, images, offline = pipeline["latency"], recording["images"], recording["offline"]
    table = Table("figure", "measured", title="The live graph")
    table.add_row("image to estimate, median / 99th percentile", f"{latency['p50_ms']:.1f} / {latency['p99_ms']:.1f} ms")
    table.add_row("of this, until the pose", f"{latency['pose_p50_ms']:.1f} ms")
    table.add_row("of this, waiting for the pusher's report", f"{latency['pusher_p50_ms']:.1f} ms")
    table.add_row("start to first pose", f"{pipeline['start_to_first_pose_s']:.1f} s")
    for row in pipeline["frames"]:
        table.add_row(f"frames dropped at {row['published_hz']:.0f} frames/s", f"{row['dropped']} of {row['published']}")
    table.add_row(f"images recorded at {images['published_hz']:.0f} Hz", f"{images['recorded']} of {images['published']}")
    table.add_row("a bag estimated offline", f"{offline['times_real_time']:.0f} times real time")
    return table


def view_table(figures: Figures) -> Table:
    """What the live view costs."""
    table = Table("", "image to estimate, median", "99th percentile", "cores", "estimates", title="The live view")
    for way, row in figures.items():
        times = (f"{row[key]:.1f} ms" for key in ("p50_ms", "p99_ms"))
        table.add_row(way, *times, f"{row['cores']:.2f}", str(row["estimates"]))
    return table


def footprint_table(figures: Figures) -> Table:
    """Memory of the demo's processes, and all other figures that are compared with a bare rclpy node."""
    table = Table("figure", "pushfric", "bare rclpy node", title="Footprint of the processes")
    memory, ends = figures["memory_mib"], figures["end_s"]
    for name, mebibytes in memory.items():
        count = len(memory) - 1 if name == "total" else 1
        table.add_row(f"memory, {name}", f"{mebibytes:.0f} MiB", f"{count * figures['bare_memory_mib']:.0f} MiB")
    table.add_row("CPU time of --help", f"{figures['help_cpu_s']:.2f} s", f"{figures['bare_start_cpu_s']:.2f} s to start")
    table.add_row("CPU time of estimate", f"{figures['estimate_cpu_s']:.2f} s", "")
    table.add_row("run to first pose", f"{figures['first_pose_s']:.2f} s", "")
    for name in ("alone", "together", "together_busy"):
        label = f"SIGINT to the end, {name.replace('_', ', ')}"
        table.add_row(label, f"{ends[name]:.2f} s", f"{ends['bare']:.2f} s" if name == "alone" else "")
    return table


def soak_table(figures: Figures) -> Table:
    """How the nodes of a running cell grew."""
    title = f"{figures['minutes']:g} minutes, {figures['data_points']} data points"
    table = Table("node", "figure", "after warm-up", "at the end", "per hour", "", title=title)
    for one in figures["growth"]:
        cells = (f"{value:.0f}" for value in (one.first, one.last, one.slope))
        table.add_row(one.node, escape(one.kind), *cells, "flat" if one.flat else "GROWS")
    return table


def _millimetres(metres: float) -> str:
    return f"{metres * 1e3:.1f}"


def plot(updates: Sequence[Figures], path: pathlib.Path) -> None:
    """Plot the median cost against M, with a panel for each N and a band up to pushfric's 99th percentile."""
    supports = sorted({row["N"] for row in updates})
    figure = Figure(figsize=(2 + 3 * len(supports), 4), layout="tight")
    axes = figure.subplots(1, len(supports), sharey=True, squeeze=False)
    for axis, n in zip(axes[0], supports, strict=True):
        for name in CONTENDERS:
            rows = sorted((row for row in updates if (row["N"], row["contender"]) == (n, name)), key=lambda row: row["M"])
            if not rows:
                continue
            m, median = [row["M"] for row in rows], [row["median_cpu_ms"] for row in rows]
            own = name == "pushfric"
            (line,) = axis.loglog(m, median, marker="o", markersize=3, linewidth=2.5 if own else 1, label=name)
            if own:
                tail = [row["p99_cpu_ms"] for row in rows]
                axis.fill_between(m, median, tail, color=line.get_color(), alpha=0.2, label="to its 99th percentile")
        axis.set(title=f"{n} supports", xlabel="data points before")
        axis.grid(alpha=0.3)
    axes[0, 0].set_ylabel("CPU time of one new data point [ms]")
    axes[0, 0].legend(fontsize="small")
    figure.savefig(path, dpi=150)


def _short(value: float) -> str:
    """At least three digits, without an exponent."""
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"
