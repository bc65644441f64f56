"""The Python examples of docs/limit_surface.md run, and their results are as the comments say."""

import pathlib
import re

import pytest

TEXT = (pathlib.Path(__file__).parents[3] / "docs/limit_surface.md").read_text()


def test_the_examples_run_and_their_numbers_hold(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    known: dict = {}
    lines = [line for block in re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL) for line in block.splitlines()]
    exec("\n".join(lines), known)
    said = [
        (code, float(value))
        for code, value in (
            re.match(r"(.*?)  # ([\d.]+): ", line).groups() for line in lines if re.search("  # [0-9.]+: ", line)
        )
    ]
    assert len(said) == 3
    for code, value in said:
        assert eval(code, known) == pytest.approx(value, abs=0.05 if value > 1 else 0.005), code
    assert known["reachable"].wrenches.shape == known["reachable"].twists.shape == (4, 65, 3)
    assert (tmp_path / "limit_surface.svg").stat().st_size > 10_000
