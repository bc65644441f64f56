"""The benchmark's figures of many data points in one estimator."""

import pathlib
import sys

from rich.console import Console

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2]))

from bench import display, growth


def test_the_cost_of_a_data_point_is_told_at_each_mark(capsys):
    said = []
    rows = growth.measure(said.append, marks=(20, 50))
    assert said == ["20 data points", "50 data points"]
    assert [row["M"] for row in rows] == [20, 50]
    for row in rows:
        assert 0 < row["median_ms"] <= row["p99_ms"] <= row["longest_ms"]
        assert row["at_rest_ms"] > 0
    Console(width=200).print(*display.plain_tables("growth", rows))
    assert "median_ms" in capsys.readouterr().out
