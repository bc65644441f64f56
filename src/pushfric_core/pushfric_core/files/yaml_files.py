"""YAML files as records, read by pydantic models: an error is one line, with the file, the key and what was expected there."""

import contextlib
import pathlib
from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

import pydantic

from pushfric_core.errors import InvalidInput, blaming
from pushfric_core.files.disk import reading, text_of
from pushfric_core.files.yaml_text import TEXT_LIMIT, Value, load_yaml, with_values
from pushfric_core.wording import shortened

Model = TypeVar("Model", bound=pydantic.BaseModel)


class Strict(pydantic.BaseModel):
    """A part of a YAML file. It refuses unknown keys, and numbers that are not finite."""

    model_config = pydantic.ConfigDict(frozen=True, allow_inf_nan=False, defer_build=True)  # most runs use one of the models

    @pydantic.model_validator(mode="before")
    @classmethod
    def _known_keys(cls, content: Any) -> Any:
        # pydantic's own check does not say which keys there are
        unknown = [str(key) for key in content if key not in cls.model_fields] if isinstance(content, dict) else []
        if unknown:
            raise ValueError(f"expected any of the keys {', '.join(cls.model_fields)}, got {', '.join(unknown)}")
        return content


def read_yaml(path: pathlib.Path, model: type[Model], content: Any = None) -> Model:
    """Read a YAML file as a pydantic model.

    Args:
        path: the file.
        model: what it should hold.
        content: of the file, if it has been read already.
    Raises:
        InvalidInput: the file cannot be read, is not YAML, or does not fit the model; one line names the file, the field, and
            what was expected there.
    """
    content = yaml_content(path) if content is None else content
    with fitting(path):
        return model.model_validate(content)


@contextlib.contextmanager
def fitting(where: object) -> Iterator[None]:
    """A context in which a pydantic model is made of something from outside.

    Raises:
        InvalidInput: it does not fit; the text says where, which field, and what was expected there.
    """
    try:
        yield
    except pydantic.ValidationError as error:
        raise InvalidInput(f"{where}: {complaint(error)}") from error


def yaml_content(path: pathlib.Path) -> Any:
    """The content of a YAML file.

    Raises:
        InvalidInput: the file cannot be read, or is not YAML.
    """
    with reading(path):
        text = text_of(path, TEXT_LIMIT)
    with blaming(f"{path}: not YAML"):
        return load_yaml(text)


def edited_yaml(path: pathlib.Path, section: str | None, values: Mapping[str, Value], instead: str = "") -> str:
    """The text of a YAML file with new values for some keys; for arguments see `with_values`.

    Args:
        instead: the end of the error if they cannot be replaced.
    Raises:
        InvalidInput: the file cannot be read, or its entries cannot be replaced.
    """
    with reading(path):
        text = path.read_bytes().decode()  # with its ends of lines
    try:
        return with_values(text, section, values)
    except ValueError as error:
        raise InvalidInput(f"{path}: {error}{instead}") from error


EXPECTED = {
    "model_type": "keys with values",
    "dict_type": "keys with values",
    "list_type": "a list",
    "tuple_type": "a list",
    "string_type": "a text, in quotes if it looks like a number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "greater_than": "more than {gt:g}",
    "greater_than_equal": "at least {ge:g}",
    "less_than_equal": "at most {le:g}",
    "too_short": "a list of at least {min_length}",
    "too_long": "a list of at most {max_length}",
    "string_too_short": "a text that is not empty",
}
"""Pydantic's types of errors, in words for the author of the file."""


def complaint(error: pydantic.ValidationError) -> str:
    """The first error in what was read, on one line: the path of the key, what was expected there, and what was found."""
    first = error.errors()[0]
    kind, got = first["type"], "nothing" if first["input"] is None else shortened(first["input"])
    where = list(map(str, first["loc"]))
    if not where and first["input"] is not None:
        got = "other content"  # whoever may name a file to a service is told nothing of what is in it
    if kind == "missing" and isinstance(first["input"], dict):
        expected, got = "expected a value", f"only {', '.join(map(str, first['input'])) or 'an empty part'}"
    elif kind == "missing":
        expected = "expected a longer list"
        where.pop()  # the index of the missing item
    elif kind == "value_error":
        expected = str(first["ctx"]["error"])
    else:
        expected = f"expected {EXPECTED[kind].format(**first.get('ctx', {}))}" if kind in EXPECTED else first["msg"]
    said = f"{'.'.join(where)}: {expected}" if where else expected
    return said if ", got " in expected else f"{said}, got {got}"
