"""Whether code, terminal, page and documents keep to the terms of docs/glossary.md, and docstrings name the thing first."""

import ast
import pathlib
import re

ROOT = pathlib.Path(__file__).parents[1]
VAGUE = re.compile(r"(What|One|Of)\b")
AVOIDED = ("docs/glossary.md", "test/ros/commands/test_documents.py")  # these also name the words to be avoided


def sources(*endings):
    folders = ("bench", "docs", "examples", "faults", "src", "test")
    files = [file for folder in folders for file in (ROOT / folder).glob("**/*") if file.suffix in endings]
    return [file for file in files if str(file.relative_to(ROOT)) not in AVOIDED and file.name != pathlib.Path(__file__).name]


def own_words(file):
    """The text of a file without what it quotes from the paper."""
    return re.sub("“.*?”", "", file.read_text(encoding="utf-8"), flags=re.DOTALL)


def test_an_observation_has_one_name():
    texts = [
        ROOT / "pushfric",
        ROOT / "set_up.py",
        *sources(".py", ".js", ".html", ".j2", ".md", ".msg", ".srv", ".action", ".yaml"),
    ]
    found = {file.name for file in texts if re.search(r"\bdata[\s#-]+points?\b", own_words(file), re.IGNORECASE)}
    assert not found


def test_docstrings_name_the_thing_first():
    found = [
        f"{file.name}:{node.lineno}"
        for file in sources(".py")
        if file.is_relative_to(ROOT / "src")
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
        and VAGUE.match(node.value.value)
    ]
    assert not found
