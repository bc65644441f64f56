"""The code blocks of README.md and docs/, and whether what a program prints is what a document shows."""

import pathlib
import re
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from markdown_it import MarkdownIt
from markdown_it.token import Token

ROOT = pathlib.Path(__file__).resolve().parents[1]
PAGES = (
    "README.md",
    "CONTRIBUTING.md",
    "bags/README.md",
    *sorted(f"docs/{page.name}" for page in (ROOT / "docs").glob("*.md")),
)

LEFT_OUT = "..."
"""A line that stands for any number of lines."""

NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?(?![\w])")


class Block(NamedTuple):
    """A block of code: where it is, its language and text, and the file that its first line or the sentence before names."""

    page: str
    line: int
    language: str
    text: str
    file: str


def tokens(page: str) -> list[Token]:
    return MarkdownIt("commonmark").enable("table").parse((ROOT / page).read_text(encoding="utf-8"))


def inline(page: str) -> Iterator[Token]:
    """What stands within the sentences of a page: text, code and links."""
    for token in tokens(page):
        yield from token.children or ()


def blocks(page: str) -> list[Block]:
    """The blocks of code of a page, in its order."""
    found, sentence = [], ""
    for token in tokens(page):
        if token.type == "inline":
            sentence = token.content
        if token.type in ("fence", "code_block"):
            begin = token.content.split("\n")[0]
            names = re.findall(r"`([\w./]+\.(?:yaml|csv))`", sentence)
            name = re.match(r"# (\w+\.yaml)", begin)
            file = name[1] if name else names[-1] if names and names[-1].endswith(token.info or "-") else ""
            found.append(Block(page, token.map[0] + 1, token.info, token.content, file))
            sentence = ""
    return found


def sessions(block: Block) -> list[tuple[str, str]]:
    """Each command of a console block, and what it prints."""
    return [(command, output) for command, output in re.findall(r"^\$ (.*)\n((?:(?!\$ ).*\n)*)", block.text, re.MULTILINE)]


def shown(page: str, command: str) -> str:
    """What a page says that a command prints."""
    (output,) = [out for block in blocks(page) if block.language == "console" for one, out in sessions(block) if one == command]
    return output


def form(line: str) -> str:
    """A line without its numbers and its spacing."""
    return " ".join(NUMBER.sub("0", line).split())


def has_the_form(said: str, expected: str) -> bool:
    """Whether the lines that a document shows were printed, in this order, but for the numbers."""
    pattern = "".join(
        r"(?:.*\n)*?" if line == LEFT_OUT else re.escape(form(line)) + "\n" for line in expected.splitlines() if line.strip()
    )
    return bool(
        re.search(f"^{pattern}", "".join(f"{form(line)}\n" for line in said.splitlines() if line.strip()), re.MULTILINE)
    )


def agrees(said: str, expected: str) -> bool:
    """Whether a program printed what a document shows, to 1 % of each number; what is left of rounding is as good as 0."""
    numbers = [[float(one) for one in NUMBER.findall(text)] for text in (said, expected)]
    return (
        [form(line) for line in said.split("\n")] == [form(line) for line in expected.split("\n")]
        and len(numbers[0]) == len(numbers[1])
        and bool(np.allclose(*numbers, rtol=0.01, atol=1e-9))
    )
