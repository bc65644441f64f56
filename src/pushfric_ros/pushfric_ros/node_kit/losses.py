"""The messages of a topic that were published but did not arrive: counted here for every node that must not miss any."""

from collections.abc import Callable

from rclpy.event_handler import QoSMessageLostInfo


class Losses:
    """Counts what one subscription misses.

    The middleware reports what it lost on the way, but not what a full queue dropped while this process was busy or stopped.
    The publisher's numbers show both, but only if there is a single publisher.
    """

    def __init__(self) -> None:
        self._told = 0
        self._missing = 0  # from the publisher's numbers
        self._last: int | None = None
        self._last_ns = 0  # when the last message came
        self.first_ns: int | None = None  # before the first loss, by the clock that `count` is given
        self.until_ns = 0  # after the last one

    @property
    def messages(self) -> int:
        """Number of messages lost so far."""
        return max(self._told, self._missing)

    def told(self, event: QoSMessageLostInfo) -> None:
        """Take the middleware's report; the callback for its event `message_lost`."""
        self._told += event.total_count_change
        self._note(self._last_ns)

    def count(self, number: int | None, publishers: Callable[[], int], now_ns: int = 0) -> None:
        """Take the publisher's number of a message that came; None if the middleware has no numbers."""
        # numbers that start again come from a restarted publisher
        if number is not None and self._last is not None and number > self._last + 1 and publishers() == 1:
            self._missing += number - self._last - 1
            self._note(now_ns)
        self._last, self._last_ns = number, now_ns

    def _note(self, now_ns: int) -> None:
        self.first_ns = self._last_ns if self.first_ns is None else self.first_ns
        self.until_ns = now_ns
