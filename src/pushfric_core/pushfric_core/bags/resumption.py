"""Resume after a crash: replay the bag up to the first live message, then switch to the topics.

A message that was published before the new estimator's subscriptions were matched is in the bag, at the latest after the
recorder's next flush; a later one comes by topic. So the bag is read until it holds, for each input, the first message that
also came by topic. What the bag holds is then left out of what came by topic: each message counts once. Nothing is taken before
the bag also holds the first message of the new estimator: all those of the old one came before it.
"""

import pathlib
import time
from collections.abc import Sequence
from typing import Any

from pushfric_core.bags.contents import mcap_file
from pushfric_core.bags.mcap_file import GrowingFile, Input
from pushfric_core.bags.run_record import PLAN
from pushfric_core.bags.samples import INPUTS, stamp_from_msg
from pushfric_core.errors import blaming
from pushfric_core.files.estimator_settings import START_TOPIC, EstimatorSettings
from pushfric_core.files.estimator_settings import TOPIC as SETTINGS_TOPIC

TOPICS = (*INPUTS, PLAN, START_TOPIC, SETTINGS_TOPIC)
"""Relative names of the topics that are read."""


class Resumption:
    """The bag of a run whose estimator may have died, read while it is recorded.

    Args:
        bag: its folder; it need not exist yet.
        namespace: of the cell.
        inputs: relative names of the topics that observations are made from.
    Attributes:
        start: the last message of earlier estimators about what they estimate, and since when; None if there was none.
        settings: the last settings that they published; None if they published none.
        continuation: the new estimator's number, which it is to publish.
        heard: whether the bag held that number at the last reading.
        published: (push id, stamp [ns]) of the observations in the bag.
    Raises:
        InvalidInput: the bag cannot be read, or it, or a message in it, is not what it should be.
    """

    def __init__(self, bag: pathlib.Path, namespace: str, inputs: Sequence[str]) -> None:
        self._bag, self._file, self._inputs = bag, GrowingFile(mcap_file(bag), namespace, TOPICS), inputs
        self._recorded: dict[str, int] = {}  # newest stamp of each input in the bag [ns]
        self._came: dict[str, int] = {}  # stamp of the first message of each that came by topic [ns]
        self._known: set[tuple[str, int]] = set()  # topics and stamps [ns] of what the bag holds
        self._held: list[Input] = []
        self.published: set[tuple[int, int]] = set()
        self.start: Any = None
        self.settings: EstimatorSettings | None = None
        self.continuation = time.time_ns()
        self._since = 0  # when the estimate began, by the clock of the cell [ns]
        self.heard = False
        self._past = self._read()

    def hold(self, topic: str, msg: Any, received: int | None) -> None:
        """Keep a message that came by topic, then [ns], until the bag has been read up to it."""
        self._came.setdefault(topic, stamp_from_msg(msg.header.stamp))
        self._held.append(Input(topic, msg, received))

    def read_on(self) -> list[Input] | None:
        """The messages of the inputs that came into the bag since the last call; at the first call, since the estimate began.

        It returns None while the bag does not hold the new estimator's number. It raises the errors of the class.
        """
        self._past += self._read()
        if not self.heard:
            return None
        past, self._past = self._past, []
        # messages recorded earlier belong to an abandoned estimate; a start may itself be recorded late
        return [each for each in past if each.received is not None and each.received >= self._since]

    @property
    def held(self) -> list[Input] | None:
        """The messages that came by topic alone, in order, once the bag holds all earlier ones; None until then."""
        if all(name in self._came and self._recorded.get(name, -1) >= self._came[name] for name in self._inputs):
            return [one for one in self._held if (one.topic, stamp_from_msg(one.msg.header.stamp)) not in self._known]
        return None

    def _read(self) -> list[Input]:
        found: list[Input] = []
        with blaming(f"{self._bag}: the estimate cannot go on from it", OSError, ValueError):
            for one in self._file.read_on():
                name, msg, _ = one
                if name == START_TOPIC and msg.continuation:
                    self.heard = self.heard or msg.continuation == self.continuation
                elif name == START_TOPIC:
                    self.start, self._since = msg, stamp_from_msg(msg.header.stamp)
                elif name == SETTINGS_TOPIC:
                    self.settings = EstimatorSettings.from_text(msg.data)
                elif name == "observation":
                    self.published.add((msg.push_id, stamp_from_msg(msg.header.stamp)))
                elif name == PLAN or name in self._inputs:
                    self._recorded[name] = stamp = stamp_from_msg(msg.header.stamp)
                    self._known.add((name, stamp))
                    found.append(one)
        return found


class PushCount:
    """The pushes in the bag of a run, counted while it is recorded.

    Args:
        bag: its folder; it need not exist yet.
        namespace: of the cell.
    Attributes:
        pushes: the largest number of a push in the bag, plus one.
        newest: stamp of the newest pusher state in the bag [ns]; None: it holds none.
    Raises:
        InvalidInput: the bag cannot be read, or its messages are not what they should be.
    """

    def __init__(self, bag: pathlib.Path, namespace: str) -> None:
        self._bag, self._file = bag, GrowingFile(mcap_file(bag), namespace, ["pusher_state"])
        self.pushes = 0
        self.newest: int | None = None
        self.read_on()

    def read_on(self) -> None:
        """Count what was recorded since the last call. Raises as the class."""
        with blaming(f"{self._bag}: its pushes cannot be counted", OSError, ValueError):
            for _, state, _ in self._file.read_on():
                self.pushes = max(self.pushes, state.push_id + 1)
                self.newest = stamp_from_msg(state.header.stamp)
