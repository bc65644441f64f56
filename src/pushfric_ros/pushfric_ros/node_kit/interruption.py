"""Ctrl-C while rclpy works: held back until it is done.

A KeyboardInterrupt in the middle of the conversion of a message would be taken for a failure of the conversion.
"""

import contextlib
import signal
import threading
from collections.abc import Iterator


@contextlib.contextmanager
def held_back() -> Iterator[None]:
    """Let a SIGINT that comes within the block take effect at its end. Threads other than the main one get none anyway."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    handler = signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
    if came and callable(handler):
        handler(came[0], None)
