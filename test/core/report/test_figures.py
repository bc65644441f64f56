"""What the figures show, read from what was drawn."""

import math

import numpy as np
import pytest
from matplotlib.figure import Figure
from problems import observations_of

from pushfric_core import TABLE_1, Estimator, LimitSurface, Support
from pushfric_core.report.figures import limit_surface_figure, summary_figure

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
    summary_figure(tmp_path / "figure.png", KNOWN.outline, estimates, DATA, truth)
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


def test_infinite_lower_bounds_fill_the_last_bin(drawn, tmp_path):
    data = DATA[0]
    pull = data.__class__(data.contact_point, tuple(-n for n in data.contact_normal), data.twist)
    estimator = Estimator(KNOWN.support_points)
    course = [estimator.add(pull)]
    assert course[-1].mu_c_max == math.inf
    summary_figure(tmp_path / "figure.png", KNOWN.outline, course, [pull], None)
    axes = panel(drawn[0], "Lower bounds")
    (bars,) = axes.containers
    assert heights(bars)[-1] == 1
    assert labels(axes) == ["90 %: inf", "100 %: inf"]
    assert axes.get_xlim()[1] == pytest.approx(2.05)
    assert axes.get_xticklabels()[-1].get_text() == ">2"


def test_the_limit_surface_shows_its_reachable_part_and_its_section(drawn, tmp_path):
    """Figure 12: the rod on two supports, whose section is the diamond |fy| + |m| / 50 mm = 1."""
    rod = LimitSurface(Support(0.05 * np.array(((-1, 0), (1, 0))), np.full(2, 1 / 2)))
    contacts = np.array(((-0.05, 0.0), (0.0, 0.0), (0.05, 0.0)))
    limit_surface_figure(tmp_path / "figure.pdf", rod, contacts, np.tile((0.0, -1.0), (3, 1)), 0.0)
    space, section = drawn[0].axes
    reached = np.array([np.ravel(line.get_data_3d()) for line in space.lines[-3:]])
    np.testing.assert_allclose(reached, [(0, 0.5, -25), (0, 1, 0), (0, 0.5, 25)], atol=1e-9)
    exact, axes, fitted = (line.get_xydata() for line in section.lines)
    np.testing.assert_allclose(np.abs(exact[:, 0]) + np.abs(exact[:, 1]) / 50, 1)
    np.testing.assert_array_equal(exact[0], exact[-1])
    np.testing.assert_allclose(axes[:, 0] ** 2 + (axes[:, 1] / 50) ** 2, 1)
    form = rod.fitted_ellipsoid().form[1:, 1:]
    np.testing.assert_allclose(np.einsum("ki,ij,kj->k", fitted / (1, 1e3), form, fitted / (1, 1e3)), 1)
