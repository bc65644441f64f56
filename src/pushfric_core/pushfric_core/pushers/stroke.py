"""A stroke as the short pieces it is sent in, and the limits that reports must keep while it runs.

If the computer dies, the controller goes on only through what it was sent. So it gets a few pieces at a time, and the next one
when a report shows that it has come nearer to the end of the last. Nothing here depends on a protocol: positions and speeds
are along the stroke, in m and m/s; times are those of the controller, in s.
"""

import math
import statistics
from collections import deque
from collections.abc import Iterable

from pushfric_core.pushers.pusher import LeftTheWay, PusherReport, Timeout, TooFast

PIECES = 3  # queued ahead
MOST_PIECES = 12  # a controller's planner holds 15 lines or more
PIECE_LASTS = 1.2  # times as long as its answer takes
OFF_WAY = 2e-3  # a report this far off the commanded way ends the stroke [m]
FASTER, FASTER_BY = 1.2, 1e-3  # than asked: factor, and [m/s]
REPORTS_TOO_FAST = 2  # in a row
MIDDLE = (0.2, 0.8)  # of the way, where the ramps are over
FEWEST_SPEEDS = 5
PLANNED = 0.03  # a controller reckons with a new piece this long after it has accepted it [s]
FORESEEN = 0.12  # controllers report the speed of steps that they prepare, at most this long before they take them [s]
SLOWED = 0.5  # of the greatest speed
LONGER, LONGER_BY = 4.0, 5.0  # than a stroke should take: factor, and [s]


class Stroke:
    """From rest to rest, along one line, at one speed."""

    def __init__(
        self,
        start: float,
        target: float,
        speed: float,
        acceleration: float,
        ahead: float,
        wait: float = 0.0,
        latency: float = 0.0,
    ) -> None:
        """Begin at `start`.

        Args:
            start: where the pusher rests [m].
            target: where it should go [m].
            speed: > 0 [m/s]
            acceleration: of the controller; infinite if not known [m/s^2].
            ahead: how long it may go on without a new piece, before it brakes [s].
            wait: how much longer than usual each piece may wait for its answer [s].
            latency: how old a report is when it comes: the pusher has gone on meanwhile [s].
        """
        way = target - start
        braking = speed**2 / (2 * acceleration)
        self.start, self.target, self.speed = start, target, speed
        self.forward = math.copysign(1.0, way)
        self._room = speed * (ahead + latency) + braking
        # the next piece is sent when the answer to the last one has come
        piece = max(speed * ahead / PIECES, self._room / MOST_PIECES, PIECE_LASTS * speed * latency)
        self._count = max(1, math.ceil(abs(way) / piece))
        self._way = way
        self.began: float | None = None
        """When its first piece was due [s]."""
        self._sent = 0
        self._furthest = 0.0  # along the way
        self._too_fast = 0
        self._acceleration = acceleration
        self._accepted: deque[tuple[float, float]] = deque([(-math.inf, 0.0)])  # when, and up to where along the way
        self._fastest = 0.0
        ramps = 2 * speed / acceleration
        self.longest = LONGER * (abs(way) / speed + ramps) + LONGER_BY + self._count * wait
        """The stroke may take this long [s]."""

    @property
    def sent(self) -> float:
        """Where the last piece that was sent ends [m]."""
        return self._end_of(self._sent)

    @property
    def all_sent(self) -> bool:
        return self._sent == self._count

    def next_piece(self, position: float) -> float | None:
        """Where the next piece ends, if there is one and room for it; that piece then counts as sent.

        Args:
            position: as last reported [m].
        """
        if self.all_sent:
            return None
        end = self._end_of(self._sent + 1)
        if self.forward * (end - position) > self._room and self._sent:
            return None
        self._sent += 1
        return end

    def take_back(self) -> None:
        """The last piece was not accepted: it counts as not sent."""
        self._sent -= 1

    def accept(self, now: float) -> None:
        """The controller has accepted all that was sent, by `now` [s]."""
        if (end := self.forward * (self.sent - self.start)) != self._accepted[-1][1]:
            self._accepted.append((now, end))

    def is_slowed(self, position: float, speed: float, asked: float) -> bool:
        """Whether a report shows that the pusher slows down although its controller knows that it goes on.

        A feed hold of a moment, which no report shows, discards all pieces but one that arrives meanwhile.

        Args:
            position, speed: as reported [m], [m/s].
            asked: when the report was requested [s].
        """
        self._fastest = max(self._fastest, abs(speed))
        planned = asked - PLANNED - self._fastest / self._acceleration
        while len(self._accepted) > 1 and self._accepted[1][0] <= planned:
            self._accepted.popleft()
        room = self._accepted[0][1] - self.forward * (position - self.start)
        needed = FORESEEN * self._fastest + self._fastest**2 / (2 * self._acceleration)
        return not self.all_sent and abs(speed) < SLOWED * self._fastest and room > needed

    def check(self, position: float, speed: float) -> None:
        """Judge a report.

        Args:
            position: [m]
            speed: [m/s]
        Raises:
            LeftTheWay: the pusher is beyond the last piece that was sent or behind the start, or it went back.
            TooFast: it is too fast, for the second time in a row.
        """
        along = self.forward * (position - self.start)
        self._furthest = max(self._furthest, along)
        last = self.forward * (self.sent - self.start)
        if along > last + OFF_WAY or along < self._furthest - OFF_WAY:
            way = f"from {self.start:.4f} m to {self.sent:.4f} m"
            raise LeftTheWay(f"the pusher is at {position:.4f} m, off its way {way}")
        self._too_fast = self._too_fast + 1 if abs(speed) > FASTER * self.speed + FASTER_BY else 0
        if self._too_fast >= REPORTS_TOO_FAST:
            raise TooFast(f"the pusher moves at {abs(speed):.4f} m/s, was sent at {self.speed:.4f} m/s")

    def farthest(self, elapsed: float) -> float:
        """How far from the start a report may say that the pusher is, so long [s] after the beginning [m]."""
        return Plausibility.MARGIN * self.speed * elapsed + Plausibility.SLACK

    def check_time(self, elapsed: float) -> None:
        """Raises Timeout if the stroke takes much longer than it should; `elapsed` [s] counts from its beginning."""
        if elapsed > self.longest:
            raise Timeout(f"the stroke to {self.target:.4f} m is not done after {self.longest:.1f} s")

    def _end_of(self, piece: int) -> float:
        # from the start, never from the piece before, so that no errors add up
        return self.target if piece == self._count else self.start + self._way * piece / self._count


def unevenness(reports: Iterable[PusherReport], start: float, target: float) -> float:
    """How much the speed varied in the middle of a stroke: its standard deviation as a share of its mean; 0 if too few reports.

    Args:
        reports: of the stroke.
        start, target: of the stroke [m].
    """
    low, high = (start + share * (target - start) for share in MIDDLE)
    speeds = [abs(report.speed) for report in reports if min(low, high) <= report.position <= max(low, high)]
    if len(speeds) < FEWEST_SPEEDS or not any(speeds):
        return 0.0
    return statistics.pstdev(speeds) / statistics.fmean(speeds)


class Plausibility:
    """Tells reports that can be true from damaged ones.

    From one report to the next, a pusher cannot go further than its speed allows. A report that says so is not believed until
    the next one agrees with it; then the pusher is there, however it got there.
    """

    SLACK = 0.5e-3  # [m]
    JITTER = 0.05  # of the moment that a report describes: somebody else may have asked, or the line repeated a question [s]
    MARGIN = 1.2

    def __init__(self) -> None:
        self.dropped = 0
        """Number of reports that were not believed."""
        self.forget()

    def forget(self) -> None:
        """Believe the next report wherever it is, as after homing."""
        self._believed: float | None = None
        self._since = 0.0
        self._doubted: float | None = None
        self._doubted_since = 0.0

    def judge(
        self, position: float, asked: float, now: float, fastest: float, reported: float, limit: float, forward: float = 0.0
    ) -> tuple[bool, float | None]:
        """Whether a report is believed, and where it was before, if it jumped.

        Args:
            position: as reported [m].
            asked: the latest time at which it can have been requested [s].
            now: when it was read [s].
            fastest: greatest speed at present: the one it was sent at, or else the reported one [m/s].
            reported: greatest speed that this report and the one before speak of [m/s].
            limit: greatest speed that the pusher is capable of [m/s].
            forward: 1 or -1 in a stroke and while it brakes: the only way it can go; 0 if it may go either way.
        """
        if self._believed is None:
            self._believed, self._since = position, asked
            return True, None
        back = forward * (position - self._believed) < 0
        if self._near(self._believed, position, now - self._since, 0.0 if back else fastest):
            self._believed, self._since, self._doubted = position, asked, None
            return True, None
        speed = max(fastest, reported)
        if self._doubted is not None and self._near(self._doubted, position, now - self._doubted_since, speed):
            # it moved faster than it was sent: this is a motion if the pusher is capable of it, and a jump if not
            capable = self._near(self._believed, position, now - self._since, 0.0 if back else limit)
            jumped = None if capable else self._believed
            self._believed, self._since, self._doubted = position, asked, None
            return True, jumped
        self._doubted, self._doubted_since = position, asked
        self.dropped += 1
        return False, None

    def _near(self, before: float, after: float, seconds: float, speed: float) -> bool:
        return abs(after - before) <= self.MARGIN * speed * (seconds + self.JITTER) + self.SLACK
