"""Typer with help that a person reads: metavars in words, options and commands in sections, as wide as the terminal."""

import inspect
import os
import pathlib
import re
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import typer
import typer.core
from typer.models import ArgumentInfo, ParameterInfo

from pushfric_core.errors import InvalidInput
from pushfric_core.plausible import other_unit
from pushfric_core.wording import no_such

HELP = ("-h", "--help")

CONTEXT: dict[str, Any] = {"help_option_names": list(HELP), "max_content_width": 10_000}

METAVARS = {int: "N", float: "NUMBER", str: "NAME", pathlib.Path: "PATH"}

RANGES = {
    r"\[default: \((.*?)\)(?=\]|; )": r"[default: \1",
    r"(-?[\d.]+)<=x<=(-?[\d.]+)": r"\1 to \2",
    r"x>=(-?[\d.]+)": r"\1 or more",
    r"x<=(-?[\d.]+)": r"at most \1",
}
"""Typer's additions to the help of an option -> the same in words."""

UsageError: type[Exception] = typer.BadParameter.__bases__[0]  # typer does not export it
"""A command line that names no known command or option, or gives a value of the wrong kind."""


class Application(typer.Typer):
    """A command, or a group of commands."""

    def __init__(self, **settings: Any) -> None:
        plain: dict[str, Any] = {"cls": Group, "add_completion": False, "rich_markup_mode": None, "context_settings": CONTEXT}
        super().__init__(**(plain | settings))

    def command(self, name: str | None = None, **settings: Any) -> Callable[[Any], Any]:
        """As of typer; an option without a metavar gets one from its type, and an argument from its name."""
        plain: dict[str, Any] = {"cls": PlainCommand, "context_settings": CONTEXT}
        register = super().command(name, **(plain | settings))

        def registered(function: Any) -> Any:
            for parameter in inspect.signature(function).parameters.values():
                _, *infos = typing.get_args(parameter.annotation) or (None,)
                for info in infos:
                    if isinstance(info, ParameterInfo) and info.metavar is None:
                        info.metavar = _metavar(parameter, isinstance(info, ArgumentInfo))
            return register(function)

        return registered


def _metavar(parameter: inspect.Parameter, argument: bool) -> str | None:
    """The metavar of a parameter; None for a choice, whose values are shown."""
    if argument:
        return parameter.name.upper()
    kinds = typing.get_args(parameter.annotation)[0]
    alternatives = typing.get_args(kinds) if isinstance(kinds, types.UnionType) else (kinds,)
    kind = next(one for one in alternatives if one is not type(None))
    return METAVARS.get(typing.get_args(kind)[0] if typing.get_origin(kind) is list else kind)


class PlainCommand(typer.core.TyperCommand):
    """A command in plain help; options of the same `rich_help_panel` stand in a section of that name."""

    def __init__(self, *args: Any, **settings: Any) -> None:
        super().__init__(*args, **(settings | {"rich_markup_mode": None}))  # no option's name is cut short

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        ctx.allow_extra_args = True
        try:
            rest = super().parse_args(ctx, spelled_out(args))
        except UsageError as error:
            error.ctx = ctx  # type: ignore[attr-defined] # the parser does not know it
            raise
        if ctx.args and not ctx.resilient_parsing:
            raise InvalidInput(f"unexpected {ctx.args[0]!r}; see {ctx.command_path} --help")
        given = [(_name(one), ctx.params.get(one.name)) for one in self.params]
        files = [(name, os.path.realpath(one)) for name, one in given if isinstance(one, str | os.PathLike) and one != STDOUT]
        for json, file in files:
            if ALONE.get(json) == _JSON and (others := [name for name, one in files if one == file and name != json]):
                raise InvalidInput(f"{json} and {others[0]} name the same file, {file}")
        return rest

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        arguments = [one for one in self.params if one.param_type_name == "argument"]
        return ["[OPTIONS]", *(_argument(one) if one.required else f"[{_argument(one)}]" for one in arguments)]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        sections: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        for one in self.get_params(ctx):
            record = one.get_help_record(ctx)
            if record is None:
                continue
            name, text = record
            for pattern, words in RANGES.items():
                text = re.sub(pattern, words, text)
            if one.param_type_name == "argument":
                sections["Arguments"].append((_argument(one), text.replace("[required]", "").rstrip()))
            else:
                name = re.sub(r"<(.*)>$", r"\1", name)  # the values of a choice
                sections.setdefault(getattr(one, "rich_help_panel", None) or "Options", []).append((name, text))
        write_sections(formatter, sections)


def _argument(argument: Any) -> str:
    return f"{argument.metavar or argument.name.upper()}{'...' if argument.nargs == -1 else ''}"


class Group(typer.core.TyperGroup):
    """Lists its commands with the whole first paragraph of their help, in sections."""

    def sections(self, ctx: Any) -> dict[str, tuple[str, ...]]:
        """The names of the commands in each section."""
        return {"Commands": tuple(self.list_commands(ctx))}

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if not args and not ctx.resilient_parsing:
            some = f": {' or '.join(names)}" if len(names := self.list_commands(ctx)) < UNLISTED else ""
            raise InvalidInput(f"expected a command{some}; see {ctx.command_path} --help")
        return super().parse_args(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        shown: dict[str, list[tuple[str, str]]] = {}
        for section, names in self.sections(ctx).items():
            commands = [self.get_command(ctx, name) for name in names]
            texts = [(str(one.name), (one.help or "").split("\n\n")[0]) for one in commands if one is not None]
            shown[section] = [(name, " ".join(text.split())) for name, text in texts]
        write_sections(formatter, shown)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        if not ctx.resilient_parsing and not args[0].startswith("-") and self.get_command(ctx, args[0]) is None:
            known = [*self.list_commands(ctx), *(option for one in self.get_params(ctx) for option in one.opts)]
            raise InvalidInput(no_such("command", args[0], known, f"{ctx.command_path} --help"))
        return super().resolve_command(ctx, args)


def write_sections(formatter: Any, sections: Mapping[str, list[tuple[str, str]]]) -> None:
    """Write the sections that are not empty, with their second columns in line."""
    widest = max((len(name) for rows in sections.values() for name, _ in rows), default=0)
    for title, rows in sections.items():
        if rows:
            with formatter.section(title):
                formatter.write_dl([(name.ljust(min(widest, COLUMN)), text) for name, text in rows])


UNLISTED = 6
"""As many commands or more are not listed in an error."""

COLUMN = 30
"""Names wider than this have a line of their own in help, as typer writes it."""


def complaint(error: Any) -> str:
    """The error in a command line, in one line without the wording of a library.

    Args:
        error: a UsageError.
    """
    parameter: Any = getattr(error, "param", None)
    details = getattr(error.__cause__, "errors", None)  # of pydantic, which reads the values in newer versions of typer
    context: Any = getattr(error, "ctx", None)
    see = f"{context.command_path if context is not None else 'pushfric'} --help"
    if parameter is not None and details is not None:
        wrong = details()[0]
        return f"{_name(parameter)}: expected {_expected(parameter, wrong)}, got {wrong['input']!r}; see {see}"
    if hasattr(error, "possibilities"):
        known = [name for one in context.command.params for name in (*one.opts, *one.secondary_opts)] if context else []
        return no_such("option", error.option_name, [*known, "--help"], see)
    if hasattr(error, "param_type"):
        return f"{_name(parameter)} is missing: {(parameter.help or '').partition('. ')[0].rstrip('.')}; see {see}"
    if option := getattr(error, "option_name", None):
        return f"{option}: expected {_values(option, context.command)}; see {see}"
    return f"{error.format_message().rstrip('.')}; see {see}"


def _name(parameter: Any) -> str:
    return _argument(parameter) if parameter.param_type_name == "argument" else str(parameter.opts[0])


def _values(name: str, command: Any) -> str:
    """The value of an option, in words."""
    option = next(one for one in command.params if name in (*one.opts, *one.secondary_opts))
    return "no value" if option.is_flag else option.metavar or "|".join(option.type_descriptor.choices)


def _expected(parameter: Any, wrong: Mapping[str, Any]) -> str:
    """The values that a parameter can have, in words."""
    kind = str(wrong["type"])
    bounds = (getattr(parameter, "min", None), getattr(parameter, "max", None))
    low, high = (f"{bound:g}" if isinstance(bound, float) else bound for bound in bounds)
    if choices := getattr(getattr(parameter, "type_descriptor", None), "choices", None):
        return " or ".join(str(getattr(choice, "value", choice)) for choice in choices)
    number = "a whole number" if kind.startswith("int") or isinstance(low, int) else "a number"
    if low is not None and high is not None:
        return f"{number} from {low} to {high}"
    return f"{number}, {low} or more" if low is not None else f"{number}, at most {high}" if high is not None else number


STDOUT = "-"
"""The value of an option for a JSON file if no file is given."""

SUFFIX = ".json"


AUTO_VIEW = "auto"
"""The address that stands for a --view without an address."""

ADDRESS = re.compile(r"(?:(?P<host>\[[^\]]+\]|[^:/\s]+):)?(?P<port>[0-9]{1,5})")

_JSON = STDOUT, re.compile(rf"{STDOUT}|.*{re.escape(SUFFIX)}")

ALONE = {"--json": _JSON, "--ledger": _JSON, "--view": (AUTO_VIEW, ADDRESS)}
"""The options that may stand without a value: the value that they have then, and what one looks like."""


def spelled_out(arguments: Sequence[str]) -> list[str]:
    """Arguments in which each option of ALONE has a value: what follows, if that looks like one."""
    pairs = zip(arguments, [*arguments, ""][1:], strict=True)
    return [f"{one}={ALONE[one][0]}" if one in ALONE and not ALONE[one][1].fullmatch(after) else one for one, after in pairs]


def in_range(low: float, high: float, unit: str) -> dict[str, Any]:
    """For an option or argument: a number outside of its range is refused, with the unit in which it would make sense."""

    def check(parameter: typer.CallbackParam, value: float | None) -> float | None:
        if value is not None and not low <= value <= high:
            asked = other_unit(unit, lambda factor: low <= value * factor <= high)
            raise InvalidInput(f"{parameter.opts[0]} must lie in [{low:g}, {high:g}] {unit}, got {value:g}{asked}")
        return value

    return {"callback": check}
