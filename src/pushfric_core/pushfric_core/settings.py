"""A config dataclass field that says what it is: default, description and range, once, for Python, nodes and docs alike."""

import dataclasses
from typing import Any

AUTO = "auto"
"""What people write where a setting is None: to be found."""


def setting(default: Any, description: str, low: float | None = None, high: float | None = None) -> Any:
    """A dataclass field with its default, description [unit] and inclusive range; the range is the caller's to enforce."""
    return dataclasses.field(default=default, metadata={"description": description, "low": low, "high": high})


def check_ranges(config: Any) -> None:
    """Refuse a config whose values leave their ranges.

    Raises:
        ValueError: names the field, its range and its value.
    """
    for field in dataclasses.fields(config):
        low, high = field.metadata.get("low"), field.metadata.get("high")
        value = getattr(config, field.name)
        # `not >=` also catches NaN
        if value is None:
            continue  # to be found: only where the field's type allows it
        if (low is not None and not value >= low) or (high is not None and not value <= high):
            span = f"[{'-inf' if low is None else low}, {'inf' if high is None else high}]"
            raise ValueError(f"{field.name} must lie in {span}, got {value}")
