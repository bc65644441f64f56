"""XML as the writers of MJCF and SDF share it: elements, numbers, and the comment on top."""

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from xml.etree.ElementTree import Element


def element(parent: Element, tag: str, text: str | float | None = None, /, **attributes: str | float) -> Element:
    """A new child; numbers are written with nine digits."""
    child = ElementTree.SubElement(parent, tag, {name: _text(value) for name, value in attributes.items()})
    child.text = None if text is None else _text(text)
    return child


def numbers(*values: float) -> str:
    """Numbers with spaces between them."""
    return " ".join(map(_text, values))


def document(root: Element, comments: Iterable[str]) -> str:
    """The file: the comments, in which XML allows no double hyphen, and the element."""
    ElementTree.indent(root)
    lines = re.sub("-(?=-)", "- ", "\n".join(comments))
    return f'<?xml version="1.0"?>\n<!--\n{lines}\n-->\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _text(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:.9g}"
