"""The ledger: every message that came in ends in exactly one account, which says what became of it.

Accounts are counts, so a ledger stays small however long a run is. What does not add up is a doubt: observations may be
missing, or may not be what happened.
"""

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from enum import StrEnum, auto
from typing import Any, NamedTuple

POSES, STATES, WRENCHES, OBSERVATIONS, PUSHES = KINDS = ("poses", "pusher states", "wrenches", "observations", "pushes")
"""The kinds of messages that are accounted for."""

USED = "used"
BETWEEN_PUSHES = "between pushes"
NOT_PUSHED = "not pushed"
TOO_FEW = "too few frames"
BETWEEN_FRAMES = "between frames"
NOT_SEEN = "object not seen"
NO_PARTNER = "no partner"
NOT_JUDGED = "not judged"
AHEAD = "ahead"
OUT_OF_ORDER = "out of order"
REPEATED = "repeated"
REFUSED = "refused"
FOREIGN = "foreign namespace"
EXCLUDED = "excluded"
LEFT_OUT = "left out by screening"
WAITING = "waiting"
ABORTED = "aborted"
NO_OBSERVATION = "no observation"

REASONS = {
    USED: "an observation or a push: the estimate rests on it; all else: it is in an observation, or next to a pose of a push",
    BETWEEN_PUSHES: "the pusher was not pushing then",
    NOT_PUSHED: "in a push, but the tip was away, at a corner or changing its speed, or the object at rest or leaping",
    TOO_FEW: "the frames of a push were too few in a row, or too slow",
    BETWEEN_FRAMES: "other pusher states lie nearer to the poses",
    NOT_SEEN: "no pose came during this part of the push",
    NO_PARTNER: "there is no pusher state on both sides",
    NOT_JUDGED: "in a push of an object whose outline is not known",
    AHEAD: "its stamp lies ahead of those that follow, or far ahead",
    OUT_OF_ORDER: "its stamp does not lie after that of an earlier message",
    REPEATED: "it has the stamp of the message before, and nothing new",
    REFUSED: "its values are impossible, or say nothing",
    FOREIGN: "it belongs to another cell",
    EXCLUDED: "its push is excluded by a person or by the settings",
    LEFT_OUT: "its push is unlike the others",
    WAITING: "it was not judged yet",
    ABORTED: "it did not reach its end",
    NO_OBSERVATION: "it gave no observation, or a wrench found none",
}
"""Meaning of each account."""

LOST = frozenset((AHEAD, OUT_OF_ORDER, REFUSED, FOREIGN))
"""Accounts that stay empty in a sound run. A message in one of them is a doubt."""


class DoubtCode(StrEnum):
    """Codes of doubts."""

    # single messages
    STAMPS_AHEAD = auto()
    STAMPS_BEHIND = auto()
    VALUES_REFUSED = auto()

    # the streams of poses and pusher states
    POSES_MISSING = auto()
    POSES_DROPPED = auto()
    POSES_FROZEN = auto()
    STATES_MISSING = auto()
    BOTH_MISSING = auto()
    CLOCKS_STEP = auto()
    CLOCKS_DIFFER = auto()

    # the pushes
    FEW_OBSERVATIONS = auto()
    PUSHES_MISSING = auto()
    NO_BEGINNING = auto()
    NO_END = auto()

    # the bag
    EMPTY = auto()
    LOST_BEFORE = auto()
    NOT_UNDERSTOOD = auto()

    # what the run recorded about itself
    PLAN_UNFINISHED = auto()
    NO_OBSERVATIONS = auto()
    RUN_DIFFERS = auto()
    RUN_FAILED = auto()


OF_THE_OUTLINE = (DoubtCode.POSES_FROZEN, DoubtCode.CLOCKS_DIFFER, DoubtCode.FEW_OBSERVATIONS)
"""Doubts that the outline of the object decides: whether the tip touches it."""


class Doubt(NamedTuple):
    """Something that does not add up."""

    code: DoubtCode
    text: str  # a line with numbers
    stamp: int = 0  # when [ns]; 0: no time is known
    lost: int | None = None  # about how many observations it costs; None: nobody knows


@dataclass
class Account:
    """The account of the messages of one kind: `received` counts all, `ended` those whose end is known, by reason."""

    received: int = 0
    ended: Counter[str] = field(default_factory=Counter)

    def end(self, reason: str, number: int = 1) -> None:
        """That many messages, received before, end for this reason."""
        self.ended[reason] += number

    def enter(self, reason: str, number: int = 1) -> None:
        """That many messages come in and end at once."""
        self.received += number
        self.ended[reason] += number

    @property
    def open(self) -> int:
        """Messages without an end so far; never negative."""
        return self.received - self.ended.total()

    def add(self, other: "Account") -> None:
        """Take over all that another account holds."""
        self.received += other.received
        self.ended.update(other.ended)

    def sums(self) -> dict[str, int]:
        """The number received, then those in each account, in the order of REASONS; what is open counts as waiting."""
        ended = self.ended + Counter({WAITING: self.open})
        return {"received": self.received} | {reason: ended[reason] for reason in REASONS if ended[reason]}


class Ledger:
    """The accounts of one run or bag, and what does not add up.

    Attributes:
        accounts: by kind.
        doubts: what does not add up, each once.
        remarks: dropped poses that cost nothing: cameras drop single frames, so all may be as it should.
        pushes: the ids of those that the pusher states tell of.
    """

    def __init__(self) -> None:
        self.accounts = {kind: Account() for kind in KINDS}
        self.pushes: set[int] = set()
        self.doubts: list[Doubt] = []
        self.remarks: list[Doubt] = []

    def doubt(self, code: DoubtCode, text: str, stamp: int = 0, lost: int | None = None) -> None:
        """Note what does not add up, as `Doubt`, or remark it."""
        noted = self.remarks if code is DoubtCode.POSES_DROPPED and not lost else self.doubts
        if (one := Doubt(code, text, stamp, lost)) not in noted:
            noted.append(one)

    def forget_the_outline(self) -> None:
        """Leave out what only the outline of the object shows, which is not known."""
        self.doubts = [one for one in self.doubts if one.code not in OF_THE_OUTLINE]
        poses = self.accounts[POSES].ended
        poses[NOT_JUDGED] = sum(poses.pop(reason, 0) for reason in (USED, NOT_PUSHED, TOO_FEW))

    @property
    def lines(self) -> list[str]:
        """The doubts and the remarks, one line each."""
        return [one.text for one in (*self.doubts, *self.remarks)]

    def doubt_refused(self) -> None:
        """Doubt the messages that were refused."""
        for kind, account in self.accounts.items():
            if number := account.ended[REFUSED]:
                text = f"{counted_of(number, account.received, kind)} refused: the values are impossible"
                self.doubt(DoubtCode.VALUES_REFUSED, text)

    def absorb(self, other: "Ledger") -> None:
        """Take over all that another ledger holds."""
        for kind, account in other.accounts.items():
            self.accounts[kind].add(account)
        for doubt in (*other.doubts, *other.remarks):
            self.doubt(*doubt)
        self.pushes |= other.pushes

    def settle(
        self,
        made: Mapping[int, int],
        used: Mapping[int, int],
        excluded: Collection[int],
        rejected: Collection[int],
        started: Collection[int] = (),
        aborted: Collection[int] = (),
    ) -> None:
        """Enter what became of the observations and of the pushes.

        Args:
            made: number of observations of each push, by its id.
            used: how many of these the estimate rests on.
            excluded: ids of the pushes that a person or the settings left out.
            rejected: ids of the pushes that are unlike the others.
            started, aborted: ids of the pushes of the plan, as far as it is known.
        """
        observations, pushes = self.accounts[OBSERVATIONS], self.accounts[PUSHES]
        for push_id in sorted({*made, *self.pushes, *started, *aborted}):
            number, taken = made.get(push_id, 0), used.get(push_id, 0)
            why = EXCLUDED if push_id in excluded else LEFT_OUT if push_id in rejected else REFUSED
            observations.enter(USED, taken)
            observations.enter(why, number - taken)
            without = ABORTED if push_id in aborted else NO_OBSERVATION
            pushes.enter(USED if taken else why if number or why != REFUSED else without)

    def sums(self) -> dict[str, dict[str, int]]:
        """By kind, for those of which any came, as `Account.sums`."""
        return {kind: account.sums() for kind, account in self.accounts.items() if account.received}

    def rows(self) -> list[list[str]]:
        """A line for each reason that occurs: its name, and the number of each kind, in the order of `sums`."""
        sums = self.sums().values()
        reasons = [reason for reason in ("received", *REASONS) if any(reason in account for account in sums)]
        return [[reason, *(str(account.get(reason, "")) for account in sums)] for reason in reasons]

    def to_dict(self) -> dict[str, Any]:
        """The accounts by kind, and what does not add up, as the command line's JSON has them."""
        doubts, remarks = ([one._asdict() for one in noted] for noted in (self.doubts, self.remarks))
        return {"accounts": self.sums(), "doubts": doubts, "remarks": remarks}


def counted_of(number: int, total: int, kind: str) -> str:
    """Some of a kind as the subject of a sentence, with its verb: 1 of 871 poses is."""
    return f"{number} of {total} {kind} {'is' if number == 1 else 'are'}"
