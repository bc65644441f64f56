"""All that is said about a run: what is believed, and what speaks against its data."""

import math
from collections.abc import Collection, Generator, Sequence
from typing import NamedTuple

from pushfric_core.belief.believe import drawing
from pushfric_core.belief.constants import CLEAR, FEWEST_COMPARED
from pushfric_core.belief.doubts import Change, Rejected, bad_pushes, changed
from pushfric_core.belief.mistakes import Mistake, explaining
from pushfric_core.belief.mode import finding
from pushfric_core.belief.stretches import size_of, steps_of
from pushfric_core.belief.symptoms import TipOff, forces_off, normals_inward, tip_off, too_fast
from pushfric_core.geometry.planar import Array
from pushfric_core.mechanics.prediction import FrictionModel
from pushfric_core.trajectories.observation import Observation
from pushfric_core.wording import Reason


class Doubts(NamedTuple):
    """Doubts about the data of a run.

    Attributes:
        rejected: the pushes that are left out because the others contradict them, each with the reason.
        change: of the object; None as long as it seems to be the same.
        mistakes: that are more probable than none, likeliest first.
        misfit: by how much motions are typically off [rad]; None: too few pushes tell.
        symptoms: what single observations show to be wrong.
        tip_off: that tips touch elsewhere than on the outline; None: they do not seem to.
    """

    rejected: tuple[Rejected, ...] = ()
    change: Change | None = None
    mistakes: tuple[Mistake, ...] = ()
    misfit: float | None = None
    symptoms: tuple[Reason, ...] = ()
    tip_off: TipOff | None = None


class Judgement(NamedTuple):
    """The belief after the pushes that are not left out, and the doubts about all."""

    belief: FrictionModel | None = None
    doubts: Doubts = Doubts()


def judging(
    points: Array, observations: Sequence[Observation], kept: Collection[int] | None = ()
) -> Generator[None, None, Judgement]:
    """Judge a run; pauses after each step, for a program that has other things to do meanwhile.

    Args:
        points: (n, 2) support points [m].
        observations: m, whose order does not matter.
        kept: pushes that are not left out, whatever speaks against them; None: all.
    """
    if not observations:
        return Judgement()
    inward = normals_inward(points, observations)
    size, doubts = size_of(points), Doubts()
    steps = steps_of(observations, size)
    yield
    mode = yield from finding(points, steps, size)
    if inward is None and len({*steps.push.tolist()}) >= FEWEST_COMPARED and len(points) > 2:
        mistakes, misfit = yield from explaining(points, steps, size)
        found = None if mode is None else changed(mode)
        change = None
        if found is not None and (not mistakes or found[1] > mistakes[0].odds):
            (change, _), mistakes = found, ()
        yield
        # to leave pushes out is no remedy for wrong units or signs, nor for another object
        sound = kept is not None and all(math.isfinite(one.size) for one in mistakes)
        bad = (yield from bad_pushes(mode)) if sound and mode is not None else ()
        bad = [one for one in bad if change is None or one.push_id < change.since_push]
        doubts = Doubts(tuple(one for one in bad if one.push_id not in (kept or ())), change, mistakes, misfit)
        yield
    fast = too_fast(points, observations, only_timed=doubts.misfit is None or doubts.misfit < CLEAR)
    # against a wrong motion, forces would seem turned
    forces = None if doubts.mistakes or inward else forces_off(points, observations)
    symptoms = tuple(one for one in (inward, fast, forces) if one is not None)
    doubts = doubts._replace(symptoms=symptoms, tip_off=tip_off(observations))
    if doubts.rejected:
        out = {one.push_id for one in doubts.rejected}
        observations = [one for one in observations if one.push_id not in out]
        mode = yield from finding(points, steps_of(observations, size), size)
    return Judgement(None if mode is None else (yield from drawing(mode, len(observations))), doubts)
