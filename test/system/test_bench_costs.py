"""The tables of where the time and the memory go."""

import pathlib
import re

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]


@pytest.fixture
def costs(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    from bench import costs

    return costs


def test_a_table_takes_the_place_of_the_one_between_its_marks(costs, tmp_path):
    document = tmp_path / "page.md"
    document.write_text("before\n<!-- bench --costs: memory -->\nold\n<!-- end -->\nafter\n")
    costs._write(document, "memory", ("process", "MiB"), {"tracker": 41.26}, ".0f")
    table = "| process | MiB |\n|---|---|\n| tracker | 41 |\n"
    assert document.read_text() == f"before\n<!-- bench --costs: memory -->\n{table}<!-- end -->\nafter\n"
    with pytest.raises(ValueError, match=r"page\.md: expected the lines <!-- bench --costs: latency --> and <!-- end -->"):
        costs._write(document, "latency", ("", ""), {}, ".0f")


@pytest.mark.parametrize(("page", "name"), [("estimator.md", "observation"), ("graph.md", "latency"), ("graph.md", "memory")])
def test_the_pages_hold_a_table_between_the_marks(page, name):
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    assert re.search(rf"<!-- bench --costs: {name} -->\n\| .*\n\|---\|---\|\n(\| .* \| [\d.]+ \|\n)+<!-- end -->\n", text)


def test_each_part_of_an_observation_takes_time(costs, monkeypatch):
    monkeypatch.setattr(costs, "ROUNDS", 1)
    found = costs._observation()
    assert found.keys() == {*costs.LADDER, "verdict", "mu_c", "message", "serialised"}
    assert sum(found.values()) > 0
