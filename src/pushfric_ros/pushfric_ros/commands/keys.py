"""Single keys of the operator's terminal, without Enter."""

import contextlib
import os
import select
import sys
import termios
import tty


class Keys(contextlib.AbstractContextManager["Keys"]):
    """Reads keys as they are pressed, if the process is in the foreground of a terminal; the terminal then shows none of them.

    Attributes:
        work: whether there is a terminal to press keys in.
    """

    def __init__(self) -> None:
        self.work = sys.stdin is not None and sys.stdin.isatty() and _in_foreground()

    def __enter__(self) -> "Keys":
        if self.work:
            self._before = termios.tcgetattr(sys.stdin)
            tty.setcbreak(sys.stdin)
        return self

    def __exit__(self, *_: object) -> None:
        if self.work:
            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._before)

    def pressed(self) -> str:
        """The keys pressed since the last call; Ctrl-C is not among them."""
        if not self.work or not select.select([sys.stdin], [], [], 0)[0]:
            return ""
        keys = os.read(sys.stdin.fileno(), 64).decode(errors="replace")
        self.work = bool(keys)  # the terminal has gone
        return keys


def _in_foreground() -> bool:
    try:
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except OSError:  # this terminal does not control the process, and so has no background
        return True
