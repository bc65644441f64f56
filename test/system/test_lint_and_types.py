"""Lint, format and types of all the code."""

import subprocess
import sys

import pytest
from documents import ROOT


@pytest.mark.parametrize("check", ["mypy", "ruff check", "ruff format --check"])
def test_nothing_is_found(check):
    run = subprocess.run([sys.executable, "-m", *check.split()], cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
