"""The tables of where the time and the memory go."""

import pathlib
import re

import pytest

from pushfric_core.errors import InvalidInput

ROOT = pathlib.Path(__file__).resolve().parents[2]


@pytest.fixture
def costs(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    from bench import costs

    return costs


def test_a_table_takes_the_place_of_the_one_between_its_marks(costs, tmp_path):
    document = tmp_path / "page.md"
    document.write_text("before\n<!-- bench --costs: memory -->\nold\n<!-- end of memory -->\nafter\n")
    costs._write(document, "memory", ("process", "MiB"), {"tracker": 41.26}, ".0f")
    table = "| process | MiB |\n|---|---|\n| tracker | 41 |\n"
    assert document.read_text() == f"before\n<!-- bench --costs: memory -->\n{table}<!-- end of memory -->\nafter\n"
    with pytest.raises(InvalidInput, match="expected the lines <!-- bench --costs: latency --> and <!-- end of latency -->"):
        costs._write(document, "latency", ("way", "ms"), {"all": 1.0}, ".0f")


@pytest.mark.parametrize(("page", "name"), [("estimation.md", "observation"), ("graph.md", "latency"), ("graph.md", "memory")])
def test_the_pages_hold_a_table_between_the_marks(page, name):
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    marks = f"<!-- bench --costs: {name} -->", f"<!-- end of {name} -->"
    assert re.search(rf"{marks[0]}\n\| .*\n\|---\|---\|\n(\| .* \| [\d.]+ \|\n)+{marks[1]}\n", text)


def test_each_part_of_an_observation_takes_time(costs, monkeypatch):
    monkeypatch.setattr(costs, "ROUNDS", 1)
    found = costs._observation()
    assert found.keys() == set(costs.PARTS)
    assert sum(found.values()) > 0
