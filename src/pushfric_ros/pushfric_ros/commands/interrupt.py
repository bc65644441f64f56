"""Ctrl-C: what it leaves is said; while there is nothing to undo, it ends the process at once and quietly."""

import contextlib
import os
import signal
import sys
from collections.abc import Callable, Iterator
from typing import Any

import typer

EXIT_INTERRUPTED = 130


def end_at_once() -> Any:
    """Let SIGINT end the process from now on, unless it is ignored, as in a background job; return the earlier handler.

    A KeyboardInterrupt could strike anywhere: in an import or a __del__ it is printed, in compiled code it becomes another
    error.
    """
    before = signal.getsignal(signal.SIGINT)
    if before is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, lambda *_: os._exit(EXIT_INTERRUPTED))
    return before


@contextlib.contextmanager
def telling_what_is_left(left: Callable[[], str]) -> Iterator[None]:
    """If Ctrl-C, or a no to a question, ends what is done within, tell the operator what that leaves: what `left` says."""
    try:
        yield
    except (KeyboardInterrupt, typer.Abort):
        # not by rich: a line that was being printed when the interrupt struck would come a second time
        print(left(), file=sys.stderr, flush=True)
        raise
