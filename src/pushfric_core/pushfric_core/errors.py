"""Errors with physical, numerical or input reasons; a wrong argument is a ValueError."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any


class PushfricError(Exception):
    """Base of all outcomes that a caller may want to catch and report.

    Example:
        >>> from pushfric_core import PushfricError, load
        >>> try:
        ...     recording = load("no such bag")
        ... except PushfricError as error:
        ...     print(error)
        no such bag: no such file; expected a bag, a CSV of observations, a model or an object
    """


LONGEST = 1000
"""Characters of the text of an InvalidInput, which may quote input of any length."""


class InvalidInput(PushfricError):
    """A file or value from outside cannot be used. The text says on one line what is wrong, where, and what was expected.

    Example:
        >>> from pushfric_core import InvalidInput, load
        >>> try:
        ...     recording = load("no such bag")
        ... except InvalidInput as error:
        ...     print(error)
        no such bag: no such file; expected a bag, a CSV of observations, a model or an object
    """

    def __init__(self, text: str) -> None:
        line = " ".join(text.splitlines())
        super().__init__(line if len(line) <= LONGEST else f"{line[:LONGEST]}...")


class UninformativePush(PushfricError):
    """A motion that says nothing about the support: the object did not move.

    Example:
        >>> from pushfric_core import Observation, Twist, UninformativePush
        >>> try:
        ...     Observation((0.01, -0.03), (0.0, -1.0), Twist(0.0, 0.0, 0.0))
        ... except UninformativePush:
        ...     print("the object did not move")
        the object did not move
    """


class SolverFailed(PushfricError):
    """The solver stopped without a solution that it could certify.

    Example:
        >>> from pushfric_core import PushfricError, SolverFailed
        >>> issubclass(SolverFailed, PushfricError)
        True
    """


class SolverUnavailable(PushfricError):
    """The solver that is asked for needs a package that is not installed.

    Example:
        >>> from pushfric_core import PushfricError, SolverUnavailable
        >>> issubclass(SolverUnavailable, PushfricError)
        True
    """


class MissingPackage(PushfricError, ImportError):
    """A package that is needed for this is not installed; the text names it, and the command that installs it.

    Example:
        >>> from pushfric_core import MissingPackage, PushfricError
        >>> issubclass(MissingPackage, PushfricError), issubclass(MissingPackage, ImportError)
        (True, True)
    """


@contextmanager
def blaming(where: object = "", *kinds: type[Exception], error: type[Exception] = InvalidInput) -> Iterator[None]:
    """A context in which what is wrong is blamed on something from outside.

    Args:
        where: the file, the option or the like; empty: the error names it.
        kinds: of what may be wrong; without any, ValueError.
        error: the kind that is raised.
    Raises:
        InvalidInput: something was wrong.
    """
    caught: tuple[type[Exception], ...] = kinds or (ValueError,)
    try:
        yield
    except caught as wrong:
        raise error(f"{where}: {wrong}" if where else str(wrong)) from wrong


@contextmanager
def extra(name: str, what: str) -> Iterator[None]:
    """Import the packages of an extra inside.

    Args:
        name: of the extra of pushfric_core.
        what: is asked for.
    Raises:
        MissingPackage: one of the packages is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise MissingPackage(f"{what} needs the package {error.name}: {installing(name)}") from error


def installing(name: str) -> str:
    """The command that installs an extra: from the folder that pushfric_core was installed from, or else from an index."""
    import json  # these three take longer to load than most commands need them
    from importlib.metadata import PackageNotFoundError, distribution
    from urllib.parse import unquote

    source = "pushfric_core"
    try:
        installed = distribution(source)
    except PackageNotFoundError:
        return f"pip install '{source}[{name}]'"
    origin = json.loads(installed.read_text("direct_url.json") or "{}")
    settings: Any = installed.locate_file("setup.cfg")
    if "dir_info" in origin:
        source = unquote(origin["url"].removeprefix("file://"))
    elif settings.exists():  # it runs from its source
        source = str(settings.resolve().parent)
    return f"pip install '{source}[{name}]'"


def warn_unless_compiled(module: ModuleType, what: str) -> None:
    """Log a warning if a module that should be compiled runs as Python; `what` is slow then, with its verb."""
    if (module.__file__ or "").endswith(".py"):
        logging.getLogger(module.__name__).warning(
            "%s not compiled, and a hundred times slower: install a C compiler and Cython 3, then pushfric_core again", what
        )
