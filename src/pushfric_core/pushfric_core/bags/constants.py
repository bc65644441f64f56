"""The constants in the definitions of pushfric_msgs."""

import functools
import pathlib
import re
from collections.abc import Mapping

FOLDER = pathlib.Path(__file__).parent / "msg"
"""The definitions of pushfric_msgs: here a link to them; what is built holds copies, and needs no pushfric_msgs."""

CONSTANT = re.compile(r"^\w+ +([A-Z][A-Z0-9_]*) *= *(-?\d+) *(?:#.*)?$", re.MULTILINE)


@functools.cache
def constants(name: str) -> Mapping[str, int]:
    """The whole-number constants of a type of pushfric_msgs, given its name without the package."""
    text = (FOLDER / f"{name}.msg").read_text(encoding="utf-8")
    return {constant: int(value) for constant, value in CONSTANT.findall(text)}
