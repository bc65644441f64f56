"""YAML text from outside: read within limits on size, depth, aliases and numbers; and edited as its author wrote it."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import yaml

from pushfric_core.records import mapped

TEXT_LIMIT = 4 * 2**20
"""Largest number of characters of a text."""

DEPTH_LIMIT = 30
"""Largest number of levels of nested lists and mappings."""

NODE_LIMIT = 200_000
"""Largest number of scalars, lists and mappings in a text; an alias counts as everything that it stands for."""

SCALAR_LIMIT = 100_000
"""Largest number of characters of a scalar."""

INTEGER_LIMIT = 2**63
"""Integers must be smaller than this in magnitude."""

# libyaml parses ten times as fast; PyYAML has it on all but exotic machines
_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _BoundedLoader(_Loader):  # type: ignore[misc]
    """A loader that refuses a key given twice, and huge integers: no field takes them, and Python could not print some."""

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        given: dict[str, yaml.Node] = {}
        for key, _ in node.value:
            if given.setdefault(str(key.value), key) is not key:
                raise yaml.constructor.ConstructorError(None, None, f"the key {key.value!r} is given twice", key.start_mark)
        super().flatten_mapping(node)
        # a key counts before a merged one, also when this mapping, merged into another, comes here again
        node.value = list({str(key.value): (key, value) for key, value in node.value}.values())

    def _integer(self, node: yaml.ScalarNode) -> int:
        value = self.construct_yaml_int(node)
        if abs(value) >= INTEGER_LIMIT:
            raise yaml.constructor.ConstructorError(None, None, "a whole number beyond 64 bits", node.start_mark)
        return int(value)


_BoundedLoader.add_constructor("tag:yaml.org,2002:int", _BoundedLoader._integer)


def load_yaml(text: str) -> Any:
    """The content of a YAML text: dicts, lists, texts, numbers, booleans, dates and None.

    Raises:
        ValueError: the text is not YAML or exceeds a limit; one line says what is wrong, and where.
    """
    if len(text) > TEXT_LIMIT:
        raise ValueError(f"expected at most {TEXT_LIMIT} characters, got {len(text)}")
    try:
        _check_structure(text)
        return yaml.load(text, Loader=_BoundedLoader)
    except yaml.MarkedYAMLError as error:
        where = error.problem_mark or error.context_mark
        line = f"line {where.line + 1}: " if where is not None else ""
        raise ValueError(line + " ".join(str(error.problem or error.context).split())) from error
    except yaml.YAMLError as error:
        raise ValueError(" ".join(str(error).split())) from error
    except (LookupError, TypeError, AttributeError, ArithmeticError) as error:
        # PyYAML's constructors let every error of a conversion through
        raise ValueError(f"a value cannot be converted: {type(error).__name__} {error}") from error


def _check_structure(text: str) -> None:
    """Check the limits on the events of the parser, before anything is built."""
    sizes = [0]  # number of nodes in each open collection
    open_anchors: list[str | None] = []
    anchored: dict[str, int] = {}
    events: Iterable[Any] = yaml.parse(text, Loader=_Loader)
    for event in events:
        where = f"line {event.start_mark.line + 1}"
        if (tag := getattr(event, "tag", None)) is not None:
            raise ValueError(f"{where}: expected plain values, got the tag {tag[:40]!r}")
        if isinstance(event, yaml.CollectionStartEvent):
            if len(sizes) > DEPTH_LIMIT:
                raise ValueError(f"{where}: expected at most {DEPTH_LIMIT} levels of lists and mappings")
            sizes.append(1)
            open_anchors.append(event.anchor)
            continue
        if isinstance(event, yaml.CollectionEndEvent):
            anchor, size = open_anchors.pop(), sizes.pop()
        elif isinstance(event, yaml.AliasEvent):
            if event.anchor not in anchored:  # also for an alias within its own anchor, which would be an endless structure
                raise ValueError(f"{where}: the alias {event.anchor!r} names nothing that is complete")
            anchor, size = None, anchored[event.anchor]
        elif isinstance(event, yaml.ScalarEvent):
            if len(event.value) > SCALAR_LIMIT:
                raise ValueError(f"{where}: expected values of at most {SCALAR_LIMIT} characters, got {len(event.value)}")
            anchor, size = event.anchor, 1
        else:
            continue
        if anchor is not None:
            anchored[anchor] = size
        sizes[-1] += size
        if sizes[-1] > NODE_LIMIT:
            raise ValueError(f"{where}: expected at most {NODE_LIMIT} values")


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
    wanted = load_yaml(text)
    part = wanted if section is None else wanted.get(section) if isinstance(wanted, dict) else None
    if not isinstance(part, dict):
        raise ValueError(f"expected keys with values{f' in {section}' if section else ''}")
    try:
        mapping: Any = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.YAMLError as error:  # it is stricter than the loader that `load_yaml` uses where that is installed
        raise ValueError(" ".join(str(error).split())) from error
    mapping = mapping if section is None else _nodes(mapping).get(section)  # a section may come from an alias
    nodes = _nodes(mapping)
    lacking = [key for key in values if key not in nodes]
    if lacking and section is not None:
        raise ValueError(f"expected {', '.join(lacking)} in {section}")
    made = text
    for key, node in sorted(nodes.items(), key=lambda item: -item[1].start_mark.index):
        if key in values:
            at, below = node.start_mark.index, node.start_mark.column <= mapping.start_mark.column  # as a list may begin
            made = f"{made[:at]}{' ' * (below or made[at - 1] == ':')}{_written(values[key])}{made[_end(node) :]}"
    for key in lacking:
        made = f"{made.rstrip()}\n{key}: {_written(values[key])}\n"
    part.update(mapped(dict(values), lambda one: one))
    if load_yaml(made) != wanted:
        raise ValueError("its values cannot be replaced one by one, as where an alias stands for several")
    return made


def _nodes(mapping: Any) -> dict[str, Any]:
    """The nodes of a mapping's values."""
    return {key.value: value for key, value in mapping.value} if isinstance(mapping, yaml.MappingNode) else {}


def _end(node: Any) -> int:
    """Where a value ends; for the parser, a list in several lines ends only where the next key begins, after comments."""
    lines = isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value
    return _end(node.value[-1] if isinstance(node, yaml.SequenceNode) else node.value[-1][1]) if lines else node.end_mark.index


def _written(value: Value) -> str:
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key}: {_written(one)}' for key, one in value.items())}}}"
    if isinstance(value, Sequence):
        return f"[{', '.join(map(_written, value))}]"
    if isinstance(value, int):
        return str(value)
    return np.format_float_positional(value, trim="0")  # YAML 1.1 takes 1e-05 for a text
