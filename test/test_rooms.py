"""The rooms: which may import which; and docs/architecture.md describes each room as its package does."""

import importlib
import pathlib
import pkgutil
import re

import pytest
from importlinter.cli import lint_imports

ROOT = pathlib.Path(__file__).resolve().parents[1]
ARCHITECTURE = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| `(\w+)/` \| (.+?) \|", ARCHITECTURE, re.MULTILINE)
ROOMS = [
    f"{house}.{module.name}"
    for house in ("pushfric_core", "pushfric_ros")
    for module in pkgutil.iter_modules(importlib.import_module(house).__path__)
    if module.ispkg
]


def test_every_import_is_allowed(capsys, monkeypatch):
    monkeypatch.chdir(ROOT)
    code = lint_imports(config_filename="pyproject.toml", no_cache=True)
    assert code == 0, capsys.readouterr().out


@pytest.mark.parametrize("room", ROOMS)
def test_architecture_describes_every_room_as_its_package_does(room):
    said = importlib.import_module(room).__doc__
    assert said is not None
    assert (room.rpartition(".")[2], said.splitlines()[0]) in ROWS


def test_architecture_names_only_rooms_that_exist():
    assert sorted(name for name, _ in ROWS) == sorted(room.rpartition(".")[2] for room in ROOMS)
