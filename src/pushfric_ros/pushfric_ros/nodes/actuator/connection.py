"""The connection to the pusher: when it is tried again, and whether the pusher stands where it rested when it was lost."""

import math
from typing import Any

from pushfric_core.pushers.clock import clock
from pushfric_core.pushers.position_memory import PositionMemory
from pushfric_core.pushers.pusher import Mode, Pusher, PusherError, PusherReport

FIRST_RETRY, LAST_RETRY = 0.1, 5.0  # [s], as all below
GRACE = 3.0  # a port may appear this late without an error message; simulated time begins once a simulated port is there
KEPT = 1e-4  # a controller that kept its position while disconnected reports it this exactly [m]


class Connection:
    """Connects to a pusher, and remembers where it rested, over processes too.

    Args:
        pusher: the pusher.
        memory: folder that keeps where it rests, as `PusherConfig.memory`.
        log: the node's logger.
    """

    def __init__(self, pusher: Pusher, memory: str, log: Any) -> None:
        self._pusher, self._folder, self._log = pusher, memory, log
        self._lost_at: float | None = None  # where it rested when the connection was lost; NaN: it did not rest
        self._quiet_until = math.inf  # set when time has begun
        self._told: str | None = None  # the last problem logged
        self._memory: PositionMemory | None = None  # of the pusher that is connected, or was last
        self.renew()

    def renew(self) -> None:
        """Try at once from now on."""
        self._retry_at, self._retry_after = 0.0, FIRST_RETRY

    def begin_time(self) -> None:
        """The node's time runs: a port that is missing for long now is worth a message."""
        if math.isinf(self._quiet_until):
            self._quiet_until = clock() + GRACE

    def open(self) -> bool:
        """Connect if there is no connection and it is time to; False: it is not yet. Raises PusherError."""
        if self._pusher.mode is Mode.DISCONNECTED and not self._pusher.busy:
            if clock() < self._retry_at:
                return False
            self._pusher.connect()
        return True

    def made(self, position: float, counted_from_home: bool) -> list[str]:
        """It is made, and the pusher reports this position [m]: why that may be wrong.

        Args:
            position: reported [m].
            counted_from_home: whether it counts from the same place as before.
        """
        self._log.info(f"connected to {self._pusher.name}")
        self._recall()
        before, self._lost_at, self._told = self._lost_at, None, None
        self._retry_after, self._quiet_until = FIRST_RETRY, 0.0
        doubts = [] if self._pusher.doubt is None else [self._pusher.doubt]
        if before is None or (abs(position - before) <= KEPT if counted_from_home else not math.isnan(before)):
            return doubts
        where = "not idle" if math.isnan(before) else f"at {before:.4f} m"
        return [f"{where} when the connection was lost, said to be at {position:.4f} m now", *doubts]

    def _recall(self) -> None:
        """Find out what was kept about the pusher that is connected now."""
        before, place = self._memory, self._pusher.place
        if before is not None and before.place == place:
            return
        self._memory = PositionMemory(self._folder, place)
        if before is None:
            self._lost_at = self._memory.recall()
            if self._folder and place.startswith("/"):
                self._log.info(f"{place} has no serial number: where it rests is kept by this path")
        elif not place.startswith("/"):
            self._lost_at = math.nan  # another one

    def lost(self, report: PusherReport, rests: bool) -> None:
        """It is lost after this last report, with the pusher at rest or not."""
        if report.mode is not Mode.DISCONNECTED:
            self._lost_at = report.position if rests else math.nan

    def log_error(self, error: PusherError, lost: bool) -> None:
        """Log an error; one of a connection that cannot be made is logged once."""
        if not lost or (str(error) != self._told and clock() >= self._quiet_until):
            self._log.error(f"{error}, retrying" if lost else str(error))
            self._told = str(error)
        if lost:
            self._retry_at = clock() + self._retry_after
            self._retry_after = min(2 * self._retry_after, LAST_RETRY)

    def keep(self, position: float) -> None:
        """Keep where the pusher rests [m] for the next process; NaN: it does not rest, or its position is not known."""
        if self._memory is not None:
            self._memory.keep(position)
            self.settle(0.0)

    @property
    def kept(self) -> bool:
        """Whether the disk has what was last to be kept, or has refused it."""
        return self._memory is None or self._memory.settled

    def settle(self, seconds: float) -> None:
        """Wait for the disk, at most so long, and say once if it refuses."""
        if self._memory is not None and (problem := self._memory.settle(seconds)) is not None:
            self._log.warning(f"the pusher's position is not kept: {problem}", once=True)
