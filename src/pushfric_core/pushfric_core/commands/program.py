"""How a program of the command line begins and ends: Ctrl-C is quiet, and output that is lost is one line and exit code 1.

It imports the standard library alone, because Ctrl-C is held back only when it has been loaded.
"""

import atexit
import contextlib
import functools
import io
import os
import signal
import sys
from collections.abc import Callable, Iterator
from typing import Any, NoReturn

EXIT_OUTPUT_LOST = 1


class OutputLost(Exception):
    """Output could not be written: the disk is full, or its reader has gone."""


class _Stream(io.TextIOWrapper):
    """stdout or stderr; an error names it, and is no OSError, for which libraries have answers of their own."""

    def write(self, text: str) -> int:
        with self._named():
            return super().write(text)

    def flush(self) -> None:
        with self._named():
            super().flush()

    @contextlib.contextmanager
    def _named(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise OutputLost(f"{'stdout' if self.fileno() == 1 else 'stderr'} cannot be written: {error.strerror}") from error


def run(main: Callable[[], int | None]) -> NoReturn:
    """Run a program and end the process; `main` returns the exit code, or raises SystemExit with it."""
    end_at_once()
    # Last of all, because Python ends a process by SIGINT if a KeyboardInterrupt has passed through `exec`, which dataclasses
    # use, and takes its handlers away before the process ends; what is ignored stays so, for threads of the middleware, too.
    atexit.register(signal.pthread_sigmask, signal.SIG_BLOCK, INTERRUPT)
    atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)
    sys.unraisablehook = _unraisable
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:  # closed: what is opened next would take its place, and get what is printed
            os.open(os.devnull, os.O_RDONLY)
    sys.stdout, sys.stderr = _checked(sys.stdout, 1), _checked(sys.stderr, 2)
    try:
        try:
            code: Any = main()
        except SystemExit as end:
            code = end.code
        except KeyboardInterrupt:
            code = EXIT_INTERRUPTED
        finally:
            end_at_once()
        sys.stdout.flush()
        sys.stderr.flush()
    except OutputLost as error:
        code = EXIT_OUTPUT_LOST
        _give_up(str(error))
    sys.exit(code)


def _unraisable(what: Any) -> None:
    """A KeyboardInterrupt in a __del__ would only be printed, and the program would go on."""
    if what.exc_type is KeyboardInterrupt:
        os._exit(EXIT_INTERRUPTED)
    sys.__unraisablehook__(what)


def _checked(stream: Any, number: int) -> _Stream:
    """The same stream, whose errors are OutputLost; None stands for a closed one."""
    return _Stream(
        io.BufferedWriter(io.FileIO(number, "w", closefd=False)),
        encoding=getattr(stream, "encoding", "utf-8"),
        errors=getattr(stream, "errors", "backslashreplace"),
        line_buffering=getattr(stream, "line_buffering", False),
        write_through=getattr(stream, "write_through", False),
    )


def _give_up(reason: str) -> None:
    """Write what can be written, and a last line on stderr; whatever is printed later goes nowhere."""
    with contextlib.suppress(OutputLost):
        sys.stdout.flush()
    with contextlib.suppress(OSError):
        os.write(2, f"error: {reason}\n".encode(errors="backslashreplace"))
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for number in (1, 2):
        os.dup2(nowhere, number)


EXIT_INTERRUPTED = 130

INTERRUPT = {signal.SIGINT}
ENDING = (signal.SIGINT, signal.SIGTERM)


def _end(*_: object) -> None:
    os._exit(EXIT_INTERRUPTED)


def end_at_once() -> None:
    """Let SIGINT and SIGTERM end the process from now on, even one that came while it was blocked.

    A signal stays ignored if it is, as in a background job. A KeyboardInterrupt could strike anywhere: in an import or a
    __del__ it is printed, in compiled code it becomes another error.
    """
    for number in ENDING:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _end)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, INTERRUPT)


def undoing(command: Callable[..., Any]) -> Callable[..., Any]:
    """The same command, which SIGINT or SIGTERM ends by a KeyboardInterrupt, so that it undoes what it has begun."""

    @functools.wraps(command)
    def interruptible(*args: Any, **kwargs: Any) -> Any:
        for number in ENDING:
            if signal.getsignal(number) is _end:
                signal.signal(number, signal.default_int_handler)
        return command(*args, **kwargs)

    return interruptible


@contextlib.contextmanager
def telling_what_is_left(left: Callable[[], str]) -> Iterator[None]:
    """If Ctrl-C, or a no to a question, ends what is done within, print what that leaves: what `left` says."""
    import typer  # late: Ctrl-C is held back from the first instruction on, not only when this has been loaded

    try:
        yield
    except (KeyboardInterrupt, typer.Abort):
        # not by rich: a line that was being printed when the interrupt struck would come a second time
        print(left(), file=sys.stderr, flush=True)
        raise
