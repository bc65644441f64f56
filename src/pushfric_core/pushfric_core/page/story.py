"""The story of a run so far, for the page: everything that a visitor who comes late must know, live or from a bag.

The story is one flat dict; a change is a part of it. A value of None removes a key. Units are SI, frames as in the messages.

    cell, object     where the run comes from, the object's name, and its outline
    recorded         whether the run is over
    reading          what is done with a recorded run that is not all told yet, and how far, in words
    estimate         the present estimate as the command line's JSON names it, with mu_c's histogram; None: no data yet
    moment/N         an observation: what was seen, what had been predicted, and the estimate after it
    push/ID          a push: whether it was left out or aborted
    event/N          what happened between two moments
    picture/N        an image that was kept: its time, and the observations before it
    support/NAME     the support points of an object
    plan             the last plan_progress
    played           whether the page teaches, card by card
    report           file of the page that the run leaves behind; empty: none
    fault            why the pusher has stopped
    node/NAME        the last diagnostics of a node
    pose, pusher     where the object and the pusher are; told only while somebody looks
    ages             how long ago what passes (PASSING) came [s], for a visitor who comes late

What only the end of a run can tell:

    reported         whether its report can be had
    doubts           what does not add up, in words
    tables           by the id of its section: text, heads, rows, and which rows are in bold; a row of one cell spans all
    files            to hand on: their texts, by name
    data             where the recorded data lie, as seen from the page's file; empty: nowhere
    made             by what the page was made, in words
    src/picture/N    an image, as an address; only where the page is one file
"""

import math
import pathlib
from collections import OrderedDict, deque
from typing import Any

import numpy as np

from pushfric_core.bags.run_record import PHASES
from pushfric_core.bags.samples import pose_from_msg, stamp_from_msg
from pushfric_core.errors import PushfricError
from pushfric_core.estimation.estimate_report import BIN_WIDTH, BoundsReport, EstimateReport
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.object_file import ObjectModel
from pushfric_core.geometry.support import Support
from pushfric_core.mechanics.prediction import STICKING, FrictionModel, predicted_motions
from pushfric_core.pushers.pusher import PusherFault
from pushfric_core.records import mapped, to_json
from pushfric_core.trajectories.observation import Observation

Change = dict[str, Any]

PASSING = ("node/", "pose", "pusher")
"""The beginnings of the keys whose values are true only for a moment; the page shows none beyond its age (run.js)."""

RUN_PAGE = pathlib.Path(__file__).parent / "run"
"""Folder of the page that shows a story."""

REMEMBERED = 1000
"""Observations and estimates come on two topics. One waits for its counterpart until this many more of its kind have come."""

MOST_PICTURES = 15e6
"""Size of all pictures of a story [byte]; beyond it, every second one is given up."""

DIGITS = 6
"""Significant digits of what is kept of each moment."""

AFTER = (
    "belief", "center_of_friction", "data_points", "gap", "mu_c", "object", "objective", "pushes", "status", "w",
)  # fmt: skip
"""The parts of an estimate that its moment keeps."""

BELIEF = ("center_of_friction", "covariance", "radius", "mu_c", "w")
"""... and those of its belief."""

PLAN_FIGURES = ("count", "completed", "aborted", "skipped", "in_place", "purpose", "message", "details")
"""Fields of the plan that the page shows as the message has them."""

PHASE_NAMES = {number: name.removeprefix("PHASE_").lower() for name, number in PHASES.items()}


class Story:
    """The story of one run. Each method takes what has come and returns what it changes.

    Args:
        model: the object.
        cell: its namespace, or where else the run comes from.
    """

    def __init__(self, model: ObjectModel, cell: str) -> None:
        self._model, self._cell = model, cell
        self._pushes: dict[int, Change] = {}
        self._moments: dict[int, Change] = {}
        self._moment_of: OrderedDict[int, int] = OrderedDict()  # stamp of an observation [ns] -> its moment
        self._after: OrderedDict[int, Change] = OrderedDict()  # stamp of the newest observation [ns] -> the estimate
        self._recent: deque[EstimateReport] = deque(maxlen=8)
        self._learnt: tuple[int, FrictionModel | None] | None = None  # the push under way, and what was known before it
        self._support: dict[str, Any] = {}
        self._pictures: dict[int, int] = {}  # -> its size
        self._every = 1  # each how many-th picture is kept
        self._seen = self._happened = self._taken = 0  # numbers of moments, events and pictures so far
        self._excluded: set[int] = set()
        self._plan: Any = None
        self._fault = PusherFault.NONE.value
        self._changed_since: int | None = None
        self._start: int | None = None  # first stamp [ns]
        self._now = 0  # last stamp [ns]

    @property
    def is_over(self) -> bool:
        """Whether the plan is finished."""
        return self._plan is not None and bool(self._plan.phase == PHASES["PHASE_FINISHED"])

    def begin(self) -> Change:
        """The story before anything comes."""
        model = {"name": self._model.name, "outline": self._model.outline.vertices.tolist()}
        return {"cell": self._cell, "object": model, "estimate": None}

    def on_estimate(self, report: EstimateReport | None) -> Change:
        """The estimate, and the moment that its newest observation belongs to; None: estimation starts again."""
        if report is None:
            return self._without_data()
        told = with_histogram(report.to_dict(), report.mu_c)
        kept = {key: told[key] for key in (*AFTER, "histogram") if key in told}
        if "w" in told["belief"]:  # it is drawn in the place of the program's
            del kept["w"]
        kept["belief"] = {key: told["belief"][key] for key in BELIEF if key in told["belief"]}
        kept = _rounded(kept)
        _remember(self._after, report.stamp, kept)
        self._recent.append(report)
        change: Change = {"estimate": told}
        if self._support.get(report.object) != told["support_points"]:
            self._support[report.object] = change[f"support/{report.object}"] = told["support_points"]
        change_of = report.belief.change
        since = None if change_of is None else change_of.since_push
        if since is not None and since != self._changed_since:
            change |= self._event("bad", "the object seems to be another one")
        self._changed_since = since
        return change | self._joined(report.stamp)

    def on_observation(self, observation: Observation) -> Change:
        """An observation: what was seen, and what had been predicted from the pushes before."""
        seen, stamp, push = self._seen, observation.stamp, observation.push_id
        self._seen += 1
        predicted, angle = self._predicted(observation)
        self._moments[seen] = {
            "push": push,
            "t": self._time(stamp),
            "contact": _rounded([*observation.contact_point, *observation.contact_normal]),
            "twist": _rounded(list(observation.twist)),
            "pose": observation.pose and _rounded(list(observation.pose)),
            "predicted": predicted,
            "off": angle,
            "after": None,
        }
        _remember(self._moment_of, stamp, seen)
        change = {} if push in self._pushes else self._told(push)
        return change | {f"moment/{seen}": dict(self._moments[seen])} | self._joined(stamp)

    def on_settings(self, text: str) -> Change:
        """The pushes that are left out, from the estimator's settings.

        Raises:
            ValueError: the estimator did not write them.
        """
        before, self._excluded = self._excluded, set(EstimatorSettings.from_text(text).excluded)
        changed: Change = {}
        for push in before ^ self._excluded:
            changed |= self._told(push, excluded=push in self._excluded)
        return changed

    def on_plan(self, msg: Any) -> Change:
        """The plan's progress, and the push that begins or was given up; from a message `plan_progress`."""
        before, self._plan = self._plan, msg
        self._time(stamp_from_msg(msg.header.stamp))
        plan = {
            "phase": PHASE_NAMES.get(msg.phase, "waiting"),
            "push": msg.push_id,
            "placement": list(pose_from_msg(msg.placement)),
            **{name: getattr(msg, name) for name in PLAN_FIGURES},
        }
        changed: Change = {"plan": plan}
        if before is not None and msg.completed == before.completed:
            stopped = before.phase == PHASES["PHASE_PUSHING"] != msg.phase
            if stopped or msg.aborted + msg.skipped > before.aborted + before.skipped:
                changed |= self._told(before.push_id, aborted=True)
                changed |= self._event("bad" if stopped else "note", msg.message if stopped else "a push was given up")
        if msg.phase == PHASES["PHASE_PUSHING"]:
            changed |= self._told(msg.push_id)
        return changed

    def on_fault(self, text: str) -> Change:
        """Why the pusher has stopped: one of the values of `PusherFault`."""
        before, self._fault = self._fault, text
        news = self._pushes and text not in (before, PusherFault.NONE.value)
        return {"fault": text} | (self._event("bad", f"the pusher stops ({text})") if news else {})

    def on_picture(self, stamp: int, size: int) -> Change:
        """An image was taken [ns, byte]. Those that the story gives up have the value None in the change."""
        taken, self._taken = self._taken, self._taken + 1
        if taken % self._every:
            return {}
        self._pictures[taken] = size
        change: Change = {f"picture/{taken}": {"t": self._time(stamp), "at": self._seen}}
        if sum(self._pictures.values()) > MOST_PICTURES:
            self._every *= 2
            gone = [number for number in self._pictures if number % self._every]
            for number in gone:
                del self._pictures[number]
            change |= {f"picture/{number}": None for number in gone}
        return change

    def _predicted(self, observation: Observation) -> tuple[list[float] | None, float | None]:
        """The twist that the pushes before predict, and its angle to the measured one [degree]; None: nothing is known."""
        if self._learnt is None or self._learnt[0] != observation.push_id:
            known = [report for report in self._recent if report.stamp < observation.stamp or not observation.stamp]
            self._learnt = observation.push_id, _model_of(known[-1]) if known else None
        model = self._learnt[1]
        if model is None:
            return None, None
        try:
            twist = predicted_motions(model, [observation]).twists[0]
        except PushfricError:  # no motion follows from this contact
            return None, None
        return _rounded(twist[0].tolist()), _rounded(math.degrees(model.angles(twist[0], observation.twist)))

    def _without_data(self) -> Change:
        """The change when estimation starts again; pushes that were left out stay left out."""
        gone = [push for push in self._pushes if push not in self._excluded]
        forgotten = [seen for seen, moment in self._moments.items() if moment["push"] in gone]
        for push in gone:
            del self._pushes[push]
        for seen in forgotten:
            del self._moments[seen]
        for kept in (self._moment_of, self._after, self._recent):
            kept.clear()
        self._learnt = None
        removed = (*(f"push/{push}" for push in gone), *(f"moment/{seen}" for seen in forgotten))
        return {"estimate": None, **dict.fromkeys(removed)}

    def _joined(self, stamp: int) -> Change:
        """A moment with the estimate after it, once both have come."""
        seen, after = self._moment_of.get(stamp), self._after.get(stamp)
        if seen is None or after is None or seen not in self._moments:
            return {}
        self._moments[seen]["after"] = after
        return {f"moment/{seen}": dict(self._moments[seen])}

    def _told(self, push: int, **values: bool) -> Change:
        row = self._pushes.setdefault(push, {"push": push, "excluded": False, "aborted": False})
        row |= values
        return {f"push/{push}": dict(row)}

    def _event(self, kind: str, text: str) -> Change:
        number, self._happened = self._happened, self._happened + 1
        return {f"event/{number}": {"t": self._time(self._now), "at": self._seen, "kind": kind, "text": text}}

    def _time(self, stamp: int) -> float:
        """The time since the first stamp [s]."""
        if self._start is None and stamp:
            self._start = stamp
        self._now = max(self._now, stamp)
        return round((stamp - (self._start or stamp)) * 1e-9, 3)


class Broadcast:
    """All that was told of a story: each value as JSON, and the pictures, both by their keys."""

    def __init__(self) -> None:
        self.values: dict[str, str] = {}
        self.pictures: dict[str, bytes] = {}

    def take(self, change: Change, jpeg: bytes = b"") -> dict[str, str]:
        """Note a change, and the picture that it tells of, if any; returns the change with each value as JSON."""
        told = {key: to_json(value) for key, value in change.items()}
        self.values |= told
        self.pictures |= {key: jpeg for key in change if jpeg and key.startswith("picture/")}
        for key in [key for key, value in change.items() if value is None and key != "estimate"]:
            del self.values[key]
            self.pictures.pop(key, None)
        return told


def as_object(values: dict[str, str]) -> str:
    """JSON of values that are JSON already."""
    return f"{{{', '.join(f'{to_json(key)}: {value}' for key, value in values.items())}}}"


def with_histogram(figures: Change, bounds: BoundsReport) -> Change:
    """The figures of an estimate, as the command line's JSON names them, with the histogram of the bounds on mu_c."""
    return figures | {"histogram": {"bin_width": BIN_WIDTH, "counts": list(bounds.histogram)}}


def _model_of(report: EstimateReport) -> FrictionModel | None:
    """The model that an estimate alone predicts with, without its spread; None if it cannot predict."""
    believed = report.belief.mu_c
    mu_c = report.mu_c.p90 if believed is None or believed.value is None else believed.value
    w = np.clip(report.w, 0.0, 1.0)
    try:
        return FrictionModel.of(Support(report.support_points, w / w.sum()), mu_c if math.isfinite(mu_c) else STICKING)
    except ValueError:  # as that of contradicting constraints
        return None


def _rounded(value: Any) -> Any:
    """The same with DIGITS significant digits."""
    return mapped(value, lambda one: float(f"{one:.{DIGITS}g}") if isinstance(one, float) else one)


def _remember(kept: OrderedDict[int, Any], stamp: int, value: Any) -> None:
    kept[stamp] = value
    while len(kept) > REMEMBERED:
        kept.popitem(last=False)
