"""`./pushfric study --constants`: do data still choose each number of the belief?

Each constant is halved and doubled, and what is then said about pushes is scored: p_CF by the logarithm of the density that the
belief gives to the truth, mu_c by the continuous ranked probability score (Gneiting and Raftery 2007), doubts and mistakes by
how many are right, where a false alarm counts as FALSE_ALARM misses. The pushes are simulated, and those of two halves of the
public objects. Then the numbers are chosen on the simulation and on one half, and the other half is judged by them, and the
other way round: no figure of these comes from pushes that a number was chosen on.
"""

import contextlib
import functools
import itertools
import math
import pathlib
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from bench.paper.pushes import CHANGE, NOISES, filmed, moved, objects, screened_runs
from bench.public_pushes import DRAWS, FEW, PublicSet, center_off, sets_in
from pushfric_core import Observation, Twist, believe
from pushfric_core.belief import constants
from pushfric_core.belief.judge import judging
from pushfric_core.belief.mistakes import LINEAR
from pushfric_core.estimation.push_plan import PlannedPush, even_pushes, slipping_pushes
from pushfric_core.geometry.planar import Array
from pushfric_core.geometry.table_1 import TABLE_1, TableObject
from pushfric_core.mechanics.prediction import ELLIPSE
from pushfric_core.steps import finished

FACTORS = (0.5, 2.0)

FALSE_ALARM = 10.0

CLEARLY = 2.0
"""Another value is better if its score is higher by this many standard errors."""

SIMULATION, HALVES = "simulation", ("one half", "other half")

CHOOSES: dict[str, tuple[str, ...]] = {
    "p_CF": (
        *("NU", "SMOOTH", "ORDER", "WHITES", "REACH", "ROUNDED", "LEAST_SCALE", "LONGEST_STRETCH", "USUAL_WAY"),
        *("MOST_STRETCHES", "SECTORS", "WIDER", "FLOOR", "COMMON", "PAIRS"),
    ),
    "mu_c": ("MU_C", "MU_C_SPREAD", "VARIES", "FORCE_SPREAD", "SURELY_SLID", "LEAST_RATIO", "OPEN"),
    "doubts": (
        *("FEWEST_COMPARED", "BAD_PUSH", "BROAD", "MANY_BAD", "CHANGED", "SHIFT", "LATEST"),
        *("FEWEST_AFTER", "FEWEST_BEFORE"),
    ),
    "mistakes": ("MISTAKE", "GEOMETRY", "MOST_COMPARED", "CLEAR", "REACH_OFF", "SMALL_SUPPORT"),
}
"""What is said with the help of each constant of the belief."""

Numbers = dict[str, Any]

Values = tuple[tuple[str, Any], ...]
"""Constants, and the values that they have meanwhile."""


class Case(NamedTuple):
    """Pushes of one object, and what should be said about them."""

    part: str  # SIMULATION, or one of HALVES
    points: Array  # (n, 2) support points [m]
    data: Sequence[Observation]
    right: Any  # p_CF (2,) [m]; mu_c; the bad push, CHANGE or None; the code of the mistake, or None


class Trial(NamedTuple):
    """The cases of a topic, judged with other values of some constants."""

    topic: str
    values: Values
    seeds: int
    folders: tuple[pathlib.Path, ...]


class Score(NamedTuple):
    """How well a case was judged; of p_CF, also whether it was in the 90 % region, and its error [m]."""

    part: str
    score: float
    held: bool = False
    error: float = 0.0


Scored = tuple[Trial, list[Score]]


def measure(seeds: int, folders: Sequence[pathlib.Path], run: Callable[[list[Trial]], Iterable[Scored]]) -> Numbers:
    """What other values of each constant gain, and how either half of the public pushes is judged by what the rest chooses.

    Args:
        seeds: simulated runs of each object.
        folders: of public sets, as `bench.public_pushes.sets_in` reads them.
        run: calls `scores` for each trial.
    Returns:
        {"gains": {"NAME = VALUE": {"topic", and for each part, such as "simulation", the gain and "... error", its standard
        error}}, "halves": {"HALF, used" or "HALF, chosen": {"values", "cases", "held", "score", "error_mm"}}}; "chosen" are the
        values that the simulation and the other half choose, "held" counts the 90 % regions that hold p_CF, and "error_mm" is
        the median.
    """
    where = tuple(folders)
    plain = {topic: Trial(topic, (), seeds, where) for topic in CHOOSES}
    other = [
        Trial(topic, ((name, value),), seeds, where) for topic in CHOOSES for name in CHOOSES[topic] for value in others(name)
    ]
    found = dict(run([*plain.values(), *other]))
    gains = {trial: _gains(found[trial], found[plain[trial.topic]]) for trial in other}
    halves: Numbers = {}
    if folders:
        chosen = {half: Trial("p_CF", _chosen(gains, half), seeds, where) for half in HALVES}
        found |= dict(run(list(chosen.values())))
        for half, trial in chosen.items():
            for whose, one in (("used", plain["p_CF"]), ("chosen", trial)):
                halves[f"{half}, {whose}"] = {"values": _said(one.values), **_judged(found[one], half)}
    return {"gains": {_said(trial.values): {"topic": trial.topic, **gain} for trial, gain in gains.items()}, "halves": halves}


def _gains(scored: Sequence[Score], before: Sequence[Score]) -> Numbers:
    numbers: Numbers = {}
    for part in dict.fromkeys(one.part for one in scored):
        gain = [one.score - other.score for one, other in zip(scored, before, strict=True) if one.part == part]
        numbers |= {part: float(np.mean(gain)), f"{part} error": float(np.std(gain)) / math.sqrt(len(gain))}
    return numbers


def _chosen(gains: Mapping[Trial, Numbers], half: str) -> Values:
    """The values that are clearly better on the simulation and the other half together; of each constant, the best."""
    (rest,) = set(HALVES) - {half}
    best: dict[str, tuple[float, Any]] = {}
    for trial, gain in gains.items():
        if rest not in gain:
            continue
        ((name, value),) = trial.values
        clearly = CLEARLY * math.hypot(gain[f"{SIMULATION} error"], gain[f"{rest} error"])
        if (total := gain[SIMULATION] + gain[rest]) > max(clearly, best.get(name, (0.0,))[0]):
            best[name] = total, value
    return tuple((name, value) for name, (_, value) in best.items())


def _judged(scored: Sequence[Score], half: str) -> Numbers:
    cases = [one for one in scored if one.part == half]
    return {
        "cases": len(cases),
        "held": sum(one.held for one in cases),
        "score": float(np.mean([one.score for one in cases])),
        "error_mm": 1e3 * float(np.median([one.error for one in cases])),
    }


def _said(values: Values) -> str:
    return ", ".join(f"{name} = {value}" for name, value in values)


def others(name: str) -> list[Any]:
    """Other values of a constant: each of its numbers by each of the FACTORS."""
    value = getattr(constants, name)
    if isinstance(value, tuple):
        each = itertools.product(range(len(value)), FACTORS)
        return [(*value[:at], factor * value[at], *value[at + 1 :]) for at, factor in each]
    return [factor * value if isinstance(value, float) else max(1, round(factor * value)) for factor in FACTORS]


@contextlib.contextmanager
def set_to(values: Values) -> Iterator[None]:
    """Constants of the belief have these values meanwhile, in all of its modules."""
    room = constants.__name__.rpartition(".")[0]
    modules = [module for name, module in list(sys.modules.items()) if name.startswith(room)]
    with contextlib.ExitStack() as stack:
        for module, (name, value) in itertools.product(modules, values):
            if hasattr(module, name):
                stack.callback(setattr, module, name, getattr(module, name))
                setattr(module, name, value)
        yield


def scores(trial: Trial) -> Scored:
    """How well each case of a trial is judged."""
    judge = {"p_CF": _region, "mu_c": _mu_c, "doubts": _doubts, "mistakes": _mistakes}[trial.topic]
    with set_to(trial.values):
        return trial, [judge(case) for case in cases(trial.topic, trial.seeds, trial.folders)]


def _region(case: Case) -> Score:
    model = believe(case.points, case.data)
    error, square = center_off(model, case.right)
    size = float(np.ptp(case.points, axis=0).max())
    density = -square / 2 - math.log(np.linalg.det(model.covariance) / size**4) / 2
    return Score(case.part, density, square <= ELLIPSE, error)


def _mu_c(case: Case) -> Score:
    model = believe(case.points, case.data)
    return Score(case.part, -ranked(np.log(model.mu_c), model.share, math.log(case.right)))


def ranked(values: Array, shares: Array, truth: float) -> float:
    """The continuous ranked probability score of samples (s,) with these shares; 0 if all are the truth."""
    apart = np.abs(values[:, None] - values)
    return float(shares @ np.abs(values - truth) - shares @ apart @ shares / 2)


def _doubts(case: Case) -> Score:
    doubts = finished(judging(case.points, case.data)).doubts
    rejected, changed = {one.push_id for one in doubts.rejected}, doubts.change is not None
    if case.right is None:
        return Score(case.part, -FALSE_ALARM * (changed or bool(rejected)))
    return Score(case.part, float(changed if case.right == CHANGE else case.right in rejected))


def _mistakes(case: Case) -> Score:
    codes = [one.reason.code for one in finished(judging(case.points, case.data)).doubts.mistakes]
    if case.right is None:
        return Score(case.part, -FALSE_ALARM * bool(codes))
    return Score(case.part, float(codes[:1] == [case.right]))


@functools.cache
def cases(topic: str, seeds: int, folders: tuple[pathlib.Path, ...]) -> list[Case]:
    """What a topic is judged by."""
    if topic == "p_CF":
        return [*_simulated(seeds), *_public([one for folder in folders for one in sets_in(folder)])]
    return list({"mu_c": _sliding, "doubts": _spoilt, "mistakes": _wrong}[topic](seeds))


def _studied(
    known: Iterable[TableObject], seeds: int, salt: int
) -> Iterator[tuple[TableObject, list[PlannedPush], np.random.Generator]]:
    """Each known object with all its pushes, and chance of its own."""
    for seed, (number, studied) in itertools.product(range(seeds), enumerate(known)):
        yield studied, even_pushes(studied.outline, studied.pushes), np.random.default_rng((seed, number, salt))


def _simulated(seeds: int) -> Iterator[Case]:
    """After FEW pushes, and after all."""
    for studied, plan, rng in _studied(objects().values(), seeds, 7):
        pushed = moved(studied, plan, rng)
        order = rng.permutation(len(pushed)).tolist()
        for spread, count in itertools.product(NOISES.values(), (FEW, len(pushed))):
            data = filmed(studied.outline, [pushed[index] for index in order[:count]], spread, rng)
            yield Case(SIMULATION, studied.support_points, data, studied.support.center_of_friction)


def _public(sets: Sequence[PublicSet]) -> Iterator[Case]:
    """After FEW strokes, and after all. Every other object belongs to the other half."""
    names = sorted({one.model.name for one in sets})
    for number, one in enumerate(sets):
        part, rng = HALVES[names.index(one.model.name) % 2], np.random.default_rng((number, 7))
        chosen = [rng.permutation(len(one.steps))[:FEW].tolist() for _ in range(DRAWS)]
        for rows in (*chosen, range(len(one.steps))):
            yield Case(part, one.model.support_points, [step for row in rows for step in one.steps[row]], one.label)


def _sliding(seeds: int) -> Iterator[Case]:
    for known, pushes, rng in _studied(TABLE_1.values(), seeds, 8):
        for plan in (pushes, pushes + slipping_pushes(known.outline, (0, 2))):
            data = filmed(known.outline, moved(known, plan, rng), known.noise, rng)
            yield Case(SIMULATION, known.support_points, data, known.mu_c)


def _spoilt(seeds: int) -> Iterator[Case]:
    for studied, _, rng in _studied(objects().values(), seeds, 9):
        for _, right, data in screened_runs(studied, rng):
            yield Case(SIMULATION, studied.support_points, data, right)


def _wrong(seeds: int) -> Iterator[Case]:
    """Motions that a mistake spoilt, without the tip, which would say much of them by itself."""
    for studied, plan, rng in _studied(objects().values(), seeds, 10):
        pushed = moved(studied, plan, rng)
        data = [replace(one, tip_velocity=None) for one in filmed(studied.outline, pushed, NOISES["FEET"], rng)]
        yield Case(SIMULATION, studied.support_points, data, None)
        for code, undone, _ in LINEAR:
            done = np.linalg.inv(np.array(undone, dtype=float))
            wrong = [replace(one, twist=Twist(*(done @ one.twist).tolist())) for one in data]
            yield Case(SIMULATION, studied.support_points, wrong, code)
