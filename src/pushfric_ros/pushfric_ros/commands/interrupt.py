"""Ctrl-C while there is nothing to undo: it ends the process at once and quietly."""

import os
import signal
from typing import Any

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
