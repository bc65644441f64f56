"""The work for an estimate that is at rest."""

import time
from collections.abc import Callable, Generator

from rclpy.node import Node

from pushfric_core.estimation.estimate import Estimate

Steps = Generator[None, None, None]

QUIET = 0.5
"""During a push, the estimate is at rest if it has not changed for this time; between pushes, if it has not since the last look
[s of wall time]."""


class RestWatch:
    """Does in steps what takes longer than an observation may wait, for an estimate that stays for a while.

    Args:
        node: the estimator's.
        estimate: the present one.
        settle: makes the steps, one of which may itself change the estimate.
    Attributes:
        pushing: whether a push is under way, as far as is known.
    """

    def __init__(self, node: Node, estimate: Callable[[], Estimate | None], settle: Callable[[], Steps]) -> None:
        self._estimate, self._settle = estimate, settle
        self._previous: Estimate | None = None  # the estimate at the last look
        self._changed = 0.0  # when it was seen to have changed, by time.monotonic() [s]
        self.pushing = True
        self._steady: Estimate | None = None  # the last estimate that had not changed for a while
        self._steps: Steps | None = None
        self._more = node.create_guard_condition(self._go_on)

    def check(self) -> None:
        """See whether the estimate has come to rest."""
        estimate, now = self._estimate(), time.monotonic()
        if self._previous is not estimate:
            self._previous, self._changed = estimate, now
        elif self._steady is not estimate and not (self.pushing and now - self._changed < QUIET):
            self._steady, self._steps = estimate, self._settle()
            self._go_on()

    def _go_on(self) -> None:
        """Do a step, unless the estimate has changed meanwhile; messages that have come get their turn in between."""
        if self._steps is None or self._estimate() is not self._steady:
            self._steps = None
            return
        try:
            next(self._steps)
        except StopIteration:
            self._steps = None
        else:
            self._more.trigger()
        self._previous = self._steady = self._estimate()
