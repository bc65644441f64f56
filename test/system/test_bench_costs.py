"""The tables of where the time and the memory go."""

import pathlib

import pytest

from bench import costs
from pushfric_core.errors import InvalidInput

ROOT = pathlib.Path(__file__).resolve().parents[2]


def test_a_table_takes_the_place_of_the_one_between_its_marks(tmp_path):
    document = tmp_path / "page.md"
    document.write_text("before\n<!-- bench --costs: memory -->\nold\n<!-- end of memory -->\nafter\n")
    costs._write(document, "memory", ("process", "MiB"), {"tracker": 41.26}, ".0f")
    table = "| process | MiB |\n|---|---|\n| tracker | 41 |\n"
    assert document.read_text() == f"before\n<!-- bench --costs: memory -->\n{table}<!-- end of memory -->\nafter\n"
    with pytest.raises(InvalidInput, match="expected the lines <!-- bench --costs: latency --> and <!-- end of latency -->"):
        costs._write(document, "latency", ("way", "ms"), {"all": 1.0}, ".0f")


def test_each_part_of_an_observation_takes_time(monkeypatch):
    monkeypatch.setattr(costs, "ROUNDS", 1)
    found = costs._observation()
    assert found.keys() == set(costs.PARTS)
    assert sum(found.values()) > 0
