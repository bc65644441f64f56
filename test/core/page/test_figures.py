"""What the figures show, read from what was drawn."""

import math

import numpy as np
import pytest
from matplotlib.figure import Figure
from problems import observations_of

from pushfric_core import TABLE_1, Estimator
from pushfric_core.files.figure_file import save_figure
from pushfric_core.page.figure import run_figure

KNOWN = TABLE_1["rubber_rect4"]
DATA = observations_of(KNOWN.outline, KNOWN.support, KNOWN.mu_c, 12, np.random.default_rng(5))


@pytest.fixture
def drawn(monkeypatch):
    """The figures that the test saves."""
    figures, save = [], Figure.savefig

    def remember(figure, *arguments, **options):
        figures.append(figure)
        save(figure, *arguments, **options)

    monkeypatch.setattr(Figure, "savefig", remember)
    return figures


@pytest.fixture(scope="module")
def estimates():
    estimator = Estimator(KNOWN.support_points)
    return [estimator.add(observation) for observation in DATA]


def panel(figure, title):
    return next(axes for axes in figure.axes if title in axes.get_title() + axes.get_title(loc="left"))


def heights(bars):
    return [bar.get_height() for bar in bars]


def labels(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


@pytest.mark.parametrize("truth", [KNOWN, None])
def test_the_histogram_counts_every_lower_bound_and_marks_p90_and_max(drawn, estimates, tmp_path, truth):
    save_figure(run_figure(KNOWN.outline, estimates, DATA, truth), tmp_path / "figure.png")
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
    axes = panel(drawn[0], "Lower bounds")
    (bars,) = axes.containers
    assert sum(heights(bars)) == len(DATA)
    last = estimates[-1]
    for bar in bars:
        left, right = bar.get_x(), bar.get_x() + bar.get_width()
        assert bar.get_height() == np.sum((last.contact_friction >= left) & (last.contact_friction < right)) or left >= 2
    places = [line.get_xdata()[0] for line in axes.lines]
    assert places == [last.mu_c_p90, last.mu_c_max] + ([KNOWN.mu_c] if truth else [])
    assert labels(axes)[:2] == [f"90 %: {last.mu_c_p90:.2f}", f"100 %: {last.mu_c_max:.2f}"]
    for axes in drawn[0].axes[1:]:
        assert axes.get_legend().get_window_extent().y1 < axes.bbox.y0  # it covers nothing
    zeros = [line for line in panel(drawn[0], "Support").lines if line.get_marker() == "x"]
    assert [line.get_label() for line in zeros] == ["$w < 0.001$" * bool(len(zeros[0].get_xdata()))]


def test_infinite_lower_bounds_fill_the_last_bin(drawn, tmp_path):
    data = DATA[0]
    pull = data.__class__(data.contact_point, tuple(-n for n in data.contact_normal), data.twist)
    course = [Estimator(KNOWN.support_points).add(pull)]
    assert course[-1].mu_c_max == math.inf
    save_figure(run_figure(KNOWN.outline, course, [pull], None), tmp_path / "figure.png")
    axes = panel(drawn[0], "Lower bounds")
    (bars,) = axes.containers
    assert heights(bars)[-1] == 1
    assert labels(axes) == ["90 %: inf", "100 %: inf"]
    assert axes.get_xlim()[1] == pytest.approx(2.05)
    assert axes.get_xticklabels()[-1].get_text() == ">2"
