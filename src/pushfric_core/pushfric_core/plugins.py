"""Pushers, trackers, sources and terms, found by entry point, both those of this package and those of other packages."""

import importlib.metadata
from collections.abc import Sequence
from typing import Any

from pushfric_core.settings import AUTO

PUSHERS = "pushfric.pushers"
"""Group of the pushers: see pushfric_core.pushers.pusher.PusherDriver."""

TRACKERS = "pushfric.trackers"
"""Group of the trackers: see pushfric_core.vision.sighting.TrackerDriver."""

SOURCES = "pushfric.sources"
"""Group of the sources of poses and tips: see pushfric_ros.adapters.body.SourceDriver."""

SIMULATIONS = "pushfric.simulations"
"""Group of the controllers of a simulated cell, by driver: see pushfric_core.simulated.serial_controller.SerialController."""

TERMS = "pushfric.terms"
"""Group of terms of the fit error; each is a Constraint, or makes one when it is called."""


def installed(group: str) -> list[str]:
    """The names in a group."""
    return sorted({entry.name for entry in importlib.metadata.entry_points(group=group)})


def plugin(group: str, name: str) -> Any:
    """The object that an installed package registered in a group under a name: a settings class, except of terms.

    Raises:
        ValueError: no package or more than one registered the name, or it cannot be imported.
    """
    named = {entry.value: entry for entry in importlib.metadata.entry_points(group=group, name=name)}
    if not named:
        known = ", ".join(installed(group)) or "none is installed"
        raise ValueError(f"{_WHAT[group]} must be an entry point of {group} ({known}), got {name!r}")
    if len(named) > 1:
        raise ValueError(f"{_WHAT[group]} must be registered by one package, but {name!r} is {' and '.join(sorted(named))}")
    (entry,) = named.values()
    try:
        return entry.load()
    except (ImportError, AttributeError) as error:
        raise ValueError(f"{_WHAT[group]} {name!r} cannot be loaded from {entry.value}: {error}") from error


def tracker_kinds(name: str) -> list[Any]:
    """The settings classes that the setting `tracker` asks for: the one it names, or those that AUTO chooses from.

    Raises:
        ValueError: as for `plugin`.
    """
    return [plugin(TRACKERS, one) for one in (AUTOMATIC if name == AUTO else (name,))]


def spare_trackers(name: str) -> list[Any]:
    """The settings classes of pushfric's other trackers, if this is one of them: their keys may stay in the file."""
    return [plugin(TRACKERS, other) for other in AUTOMATIC if name in AUTOMATIC and other != name]


def chosen_tracker(configs: Sequence[Any]) -> Any:
    """The first of the settings of `tracker_kinds` that is complete.

    Raises:
        ValueError: no settings are complete; the text says what the last ones lack.
    """
    for config in configs:
        if (absence := config.absence()) is None:
            return config
    raise ValueError(absence)


AUTOMATIC = ("fiducial", "contour")
"""Choices of AUTO, in this order: an object with markers is found by its markers."""

_WHAT = {PUSHERS: "driver", TRACKERS: "tracker", SOURCES: "source", SIMULATIONS: "simulation", TERMS: "term"}
"""For each group, the setting that chooses from it."""
