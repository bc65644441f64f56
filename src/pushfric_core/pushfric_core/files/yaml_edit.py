"""Replaces values in a YAML text; everything else, comments included, stays as its author wrote it."""

import copy
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import yaml

from pushfric_core.files.bounded_yaml import load_yaml

Value = float | Sequence[Any] | Mapping[str, Any]
"""A number, or a list of values, or values by key."""


def with_values(text: str, section: str | None, values: Mapping[str, Value]) -> str:
    """A YAML text with new values for some keys.

    Args:
        text: keys with values.
        section: key of the part that holds them; None: the whole text.
        values: by key; a key that is missing from the whole text is added at its end.
    Raises:
        ValueError: the text is not YAML, has no such part or key, or an alias makes a value stand for several keys.
    """
    wanted = copy.deepcopy(load_yaml(text))
    part = wanted if section is None else wanted.get(section) if isinstance(wanted, dict) else None
    if not isinstance(part, dict):
        raise ValueError(f"expected keys with values{f' in {section}' if section else ''}")
    try:
        nodes = _nodes(yaml.compose(text, Loader=yaml.SafeLoader))
    except yaml.YAMLError as error:  # it is stricter than the loader that `load_yaml` uses where that is installed
        raise ValueError(" ".join(str(error).split())) from error
    nodes = nodes if section is None else _nodes(nodes.get(section))  # a section may come from an alias
    lacking = [key for key in values if key not in nodes]
    if lacking and section is not None:
        raise ValueError(f"expected {', '.join(lacking)} in {section}")
    made = text
    for key, node in sorted(nodes.items(), key=lambda item: -item[1].start_mark.index):
        if key not in values:
            continue
        made = made[: node.start_mark.index] + _written(values[key]) + made[_end(node) :]
    for key in lacking:
        made = f"{made.rstrip()}\n{key}: {_written(values[key])}\n"
    part.update({key: _plain(value) for key, value in values.items()})
    if load_yaml(made) != wanted:
        raise ValueError("its values cannot be replaced one by one, as where an alias stands for several")
    return made


def _nodes(mapping: Any) -> dict[str, Any]:
    """The nodes of a mapping's values."""
    if not isinstance(mapping, yaml.MappingNode):
        return {}
    return {key.value: value for key, value in mapping.value}


def _end(node: Any) -> int:
    """Where a value ends; for the parser, a list in several lines ends only where the next key begins, after comments."""
    lines = isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value
    return _end(node.value[-1] if isinstance(node, yaml.SequenceNode) else node.value[-1][1]) if lines else node.end_mark.index


def _plain(value: Value) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, Sequence) else value


def _written(value: Value) -> str:
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key}: {_written(one)}' for key, one in value.items())}}}"
    if isinstance(value, Sequence):
        return f"[{', '.join(map(_written, value))}]"
    if isinstance(value, int):
        return str(value)
    return np.format_float_positional(value, trim="0")  # YAML 1.1 takes 1e-05 for a text
