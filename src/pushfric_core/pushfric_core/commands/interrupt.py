"""Ctrl-C: a command says what it leaves; with nothing to undo, the process ends at once and quietly."""

import contextlib
import functools
import os
import signal
import sys
from collections.abc import Callable, Iterator
from typing import Any

EXIT_INTERRUPTED = 130

INTERRUPT = {signal.SIGINT}


def _end(*_: object) -> None:
    os._exit(EXIT_INTERRUPTED)


def end_at_once() -> None:
    """Let SIGINT end the process from now on, even one that came while it was blocked.

    It stays ignored if it is, as in a background job. A KeyboardInterrupt could strike anywhere: in an import or a __del__ it
    is printed, in compiled code it becomes another error.
    """
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, _end)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, INTERRUPT)


def undoing(command: Callable[..., Any]) -> Callable[..., Any]:
    """The same command, which SIGINT ends by a KeyboardInterrupt, so that it undoes what it has begun."""

    @functools.wraps(command)
    def interruptible(*args: Any, **kwargs: Any) -> Any:
        if signal.getsignal(signal.SIGINT) is _end:
            signal.signal(signal.SIGINT, signal.default_int_handler)
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
