"""The rooms: which may import which, what each weighs, and that docs/architecture.md describes each as its package does."""

import ast
import importlib
import io
import pathlib
import pkgutil
import re
import tokenize
import tomllib

import pytest
from importlinter.cli import lint_imports

ROOT = pathlib.Path(__file__).resolve().parents[1]
ARCHITECTURE = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| `(\w+)/` \| (.+?) \|", ARCHITECTURE, re.MULTILINE)
SLACK = 25
"""A room that weighs less than its limit by more lines has a limit of long ago."""
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
    assert (room.rpartition(".")[2], importlib.import_module(room).__doc__.splitlines()[0]) in ROWS


def test_architecture_names_only_rooms_that_exist():
    assert sorted(name for name, _ in ROWS) == sorted(room.rpartition(".")[2] for room in ROOMS)


def code_lines(text: str) -> int:
    """Lines of code: no blank line, comment or docstring; a text under a constant counts as its docstring."""
    left_out = {
        line
        for node in ast.walk(ast.parse(text))
        for one in (node.body if isinstance(getattr(node, "body", None), list) else ())
        if isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant) and isinstance(one.value.value, str)
        for line in range(one.lineno, one.end_lineno + 1)
    }
    lines = text.splitlines()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT and lines[token.start[0] - 1].lstrip().startswith("#"):
            left_out.add(token.start[0])
    return sum(bool(line.strip()) and number not in left_out for number, line in enumerate(lines, 1))


def test_no_room_grows():
    """A limit is only lowered, except in a commit that says what was deleted elsewhere."""
    limits = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["pushfric"]["lines-of-code"]
    weights = dict.fromkeys(limits, 0)
    for file in ROOT.glob("src/*/pushfric_*/**/*.py"):
        house, *rooms, _ = file.relative_to(ROOT / "src").parts[1:]
        weights[".".join((house, *rooms[:1]))] += code_lines(file.read_text())
    weights["test"] = sum(code_lines(file.read_text()) for file in ROOT.glob("test/**/*.py"))
    grown = [
        f"{room} has {lines} lines of code, at most {limits[room]} are allowed"
        for room, lines in weights.items()
        if lines > limits[room]
    ]
    assert not grown, "; ".join(grown)
    slack = [f"{room} = {lines}" for room, lines in weights.items() if lines < limits[room] - SLACK]
    assert not slack, f"lower the limits in pyproject.toml: {', '.join(slack)}"
