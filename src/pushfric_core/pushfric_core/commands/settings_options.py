"""Command line options for the estimator: all of EstimatorConfig, and `pose_lag`; the recorded values are the defaults."""

import dataclasses
import inspect
import types
import typing
from collections.abc import Callable, Collection
from typing import Annotated, Any

import typer

from pushfric_core.commands.application import in_range
from pushfric_core.errors import InvalidInput
from pushfric_core.estimation.estimator import EstimatorConfig
from pushfric_core.files.estimator_settings import ChosenSettings
from pushfric_core.settings import AUTO, unit_in, written
from pushfric_core.trajectories.samples import TrajectoryConfig

SECTION = "Settings of the estimator"
"""Section of these options in the help of every command that has them."""

PUSHES = {
    "exclude_push": "Leave out this push",
    "slipping_push": "The contact of this push slips, which gives mu_c",
    "keep_push": "Keep this push, even if it is unlike the others",
}


def option(config: type, name: str) -> Any:
    """The typer option of one setting: its help and range; its default is the class's attribute of that name."""
    field = _field(config, name)
    low, high, unit = field.metadata["low"], field.metadata["high"], unit_in(field.metadata["description"])
    limits = in_range(low, high, unit) if unit and None not in (low, high) else {"min": low, "max": high}
    return typer.Option(help=_help(field), **limits)


def option_as_recorded(config: type, name: str) -> Any:
    """The same, but None stands for the value that a bag was recorded with; the class checks the range."""
    field = _field(config, name)
    return typer.Option(help=_help(field), show_default=f"as recorded, or {field.default}")


def _field(config: Any, name: str) -> Any:
    return next(field for field in dataclasses.fields(config) if field.name == name)


def with_settings(command: Callable[..., None], without: Collection[str] = ()) -> Callable[..., None]:
    """The command with an option for each field of EstimatorConfig, the lag and single pushes, instead of `settings`.

    Args:
        command: the function; its parameter `settings` gets the values as ChosenSettings.
        without: fields that have no meaning for the command.
    """
    fields = [field for field in dataclasses.fields(EstimatorConfig) if field.name not in without]
    hints = typing.get_type_hints(EstimatorConfig)
    options = {field.name: _option(field, hints[field.name]) for field in fields}
    options["pose_lag"] = _option(_field(TrajectoryConfig, "pose_lag"), float)
    for name, text in PUSHES.items():
        flag = f"--{name.replace('_', '-')}"
        info = typer.Option(flag, help=f"{text}; repeatable.", metavar="PUSH", rich_help_panel=SECTION)
        options[name] = Annotated[list[int] | None, info]

    def run(**given: Any) -> None:
        chosen = {name: given.pop(name) for name in options}
        command(settings=_chosen(chosen), **given)

    run.__doc__ = command.__doc__
    own = [parameter for name, parameter in inspect.signature(command).parameters.items() if name != "settings"]
    keyword = inspect.Parameter.KEYWORD_ONLY
    added = [inspect.Parameter(name, keyword, default=None, annotation=option) for name, option in options.items()]
    run.__signature__ = inspect.Signature([*own, *added])  # type: ignore[attr-defined]
    return run


def _option(field: Any, hint: Any) -> Any:
    """A field as a parameter of typer."""
    name = field.name.replace("_", "-")
    default = AUTO if field.default is None else field.default
    kind: Any = str
    metavar: str | None
    if isinstance(default, tuple):
        metavar, default = "NAME,...", ",".join(default)
    elif isinstance(hint, types.UnionType) and bool not in typing.get_args(hint):
        metavar = f"NUMBER|{AUTO}"
    else:
        kind, metavar = written(hint), None
    flag, shown = f"--{name}", str(default)
    if kind is bool:
        flag = f"--{name}/--no-{name}"
        shown = shown if default == AUTO else f"--{name}" if default else f"--no-{name}"
    shown = f"as recorded, or {shown}"
    return Annotated[
        kind | None, typer.Option(flag, help=_help(field), metavar=metavar, show_default=shown, rich_help_panel=SECTION)
    ]


def _help(field: Any) -> str:
    text = field.metadata["description"]
    if not text.split()[0].endswith(":"):  # the name of a value is not capitalised
        text = text[0].upper() + text[1:]
    return f"{text}."


def _chosen(options: dict[str, Any]) -> ChosenSettings:
    """The options that were given."""
    excluded, slipping, kept = (tuple(options.pop(name) or ()) for name in PUSHES)
    if both := {*excluded} & {*kept}:
        raise InvalidInput(f"give --exclude-push {min(both)} or --keep-push {min(both)}, not both")
    given = {name: value for name, value in options.items() if value is not None}
    if "terms" in given:
        given["terms"] = given["terms"].split(",")
    return ChosenSettings(given, excluded, slipping, kept)
