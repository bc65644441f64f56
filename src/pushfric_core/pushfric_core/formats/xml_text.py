"""XML as the writers of MJCF and SDF share it: elements, numbers, and the comment on top."""

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from xml.etree.ElementTree import Element

import numpy as np
import numpy.typing as npt


def element(tag: str, /, *content: Element | npt.ArrayLike, **attributes: npt.ArrayLike) -> Element:
    """An element with its children, or with a text; numbers are written with nine digits, and spaces between them."""
    made = Element(tag, {name: _text(value) for name, value in attributes.items()})
    for one in content:
        if isinstance(one, Element):
            made.append(one)
        else:
            made.text = _text(one)
    return made


def document(root: Element, comments: Iterable[str]) -> str:
    """The file: the comments, in which XML allows no double hyphen, and the element."""
    ElementTree.indent(root)
    lines = re.sub("-(?=-)", "- ", "\n".join(comments))
    return f'<?xml version="1.0"?>\n<!--\n{lines}\n-->\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _text(value: npt.ArrayLike) -> str:
    return value if isinstance(value, str) else " ".join(f"{one:.9g}" for one in np.ravel(value))
