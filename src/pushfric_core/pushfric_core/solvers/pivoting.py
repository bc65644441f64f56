"""The simplex method for a piecewise linear cost, compiled: it pivots from one vertex to the next until none is better.

At a vertex n conditions a . x = 0 are active, x being w and, where there is one, the scale. Column i of B^-1, the inverse of
their normals, is the edge that leaves condition i alone; the first column is x itself.

1. Price.  With g the gradient of all inactive rows, lambda = g B^-1: leaving condition i upwards costs above_i + lambda_i per
   unit, downwards below_i - lambda_i. Where no edge descends, y = -lambda on the active rows completes the dual optimum.
2. Search. Along an edge F is convex and piecewise linear. Its breakpoints are the rows that reach zero; the slope grows by
   (above + below) |a . d| at each. The row that turns it upwards becomes active.
3. Exchange the two conditions: a rank-one update of B^-1.

Hard rows, including x_j >= 0, are met lexicographically. First the sum of their violations is minimised, by the same three
steps with other costs; then F, with infinite costs for them. If hard rows contradict each other, F is minimised among the x of
least violation. A new data point changes only g, so that a few exchanges restore optimality.

Numba compiles each function when it is first called, and keeps the result for later runs. It checks only the date of this file
to see whether the result is still valid, so everything the functions use is defined here or passed to them.
"""

import logging
import math
from collections.abc import Callable
from typing import NamedTuple, TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt
from numba.core import event

from pushfric_core.geometry.planar import Array

Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]
F = TypeVar("F", bound=Callable[..., object])

# Rows are scaled to a largest coefficient in [1/2, 1), so that tolerances on them are absolute.

ZERO = 1e-14
"""Values this close to zero are rounding; the side of such a row is remembered, not derived from its value."""

PARALLEL = 1e-9
"""A row that changes by less than this along an edge is parallel to it: exchanging it would make B nearly singular."""

TIE = 1e-15
"""Breakpoints closer than this count as one; the steepest of its rows makes the best-conditioned exchange."""

LEVEL = 1e-9
"""Edges whose slope is within this fraction of the gradient leave the violation as it is."""

STALLED = 12
"""After this many exchanges without progress, a degenerate vertex is perturbed: its conditions are shifted apart."""

PERTURBATION = 1e-10
"""By about this, on the way to an extreme of the level set."""

GOLDEN = (math.sqrt(5) - 1) / 2
"""Its multiples modulo 1 are as different from each other as can be, and the same on every run."""

SHORT = 1e-9
"""An extreme of the level set may fall short of its bound by this share of the range of the tilt: the rounding of bounds."""

REACH = 2.0
"""Pivoting goes no farther than this many radii from the center of its ball.

Outside, the rows settled there are taken for linear: F is underestimated, a little near the ball, where one descent ends
is a good start for the next, and without bound in the corners of the simplex, where a descent that believes it would end.
"""

REFRESH = 100
"""B^-1 is computed again from scratch after this many updates, before their rounding errors show."""

LARGEST = 1e150
"""No coefficient and no finite cost is larger; a row whose coefficients are all smaller than its inverse is one of zeros."""

VIOLATION, FIT = 0, 1  # the two costs, in lexicographic order
NO_STEP = -1.0  # what `ratio_test` returns without one
COUNT, UPDATES = 0, 1  # places in State.tally
ARRIVED, LED_OUT, ENDLESS, INEXACT = 0, 1, 2, 3  # how a walk to an extreme of the level set ends
COEFFICIENT, COST = -1.0, -2.0  # what `store` finds wrong


class State(NamedTuple):
    """A basis in arrays, with room for more rows than there are.

    Conditions are numbered by position: sum w = 1; then x_j >= 0, j = 1..n; then the rows that are not settled.
    """

    tally: Indices  # (2,) number of conditions; updates of the inverse since it was last computed from scratch
    number: Indices  # (room,) of the row, -1 for the other conditions
    a: Array  # (n, room) normals, one per column: along an edge all of them are met, component by component
    value: Array  # (room,) a . x, or shifted from it while a degenerate vertex is left
    side: Array  # (room,) +1, -1, or 0 while active: explicit, for at zero the value does not tell
    cost: Array  # (2, 2, room) VIOLATION and FIT; above and below zero
    settled: Array  # (n,) gradient of F of the settled rows: none of them is violated
    gradient: Array  # (2, n) of all inactive conditions, per cost; kept up to date, and summed up again with the inverse
    active: Indices  # (n,) positions; the first is always sum w = 1
    inverse: Array  # (n, n) B^-1
    x: Array  # (n,) the present vertex
    dual: Array  # (n,) multipliers of the active rows, as `bounds` left them


class CompilationNotice(event.Listener):  # type: ignore[misc]
    """Says once, as a warning, that functions of this module are being compiled; nothing where all come from the cache."""

    def __init__(self) -> None:
        self._given = False

    def on_start(self, started: event.Event) -> None:
        dispatcher = started.data["dispatcher"]
        if self._given or dispatcher.py_func.__module__ != __name__:
            return
        self._given = True
        folder = dispatcher.stats.cache_path
        later = f"later runs load it from {folder}" if folder else "every run does, as no folder for the result is writable"
        logging.getLogger(__name__).warning("compiling the solver, which takes some 20 seconds; %s", later)

    def on_end(self, ended: event.Event) -> None:
        pass


event.register("numba:compile", CompilationNotice())


def compiled(function: F) -> F:
    try:
        return cast(F, numba.njit(cache=True, error_model="numpy")(function))
    except RuntimeError:  # neither here nor in the user's cache can anything be kept: every process compiles for itself
        return cast(F, numba.njit(error_model="numpy")(function))


class Ball(NamedTuple):
    """Where the rows settled around its center keep their sides."""

    metric: Array  # (n, n) lower triangular: |v| is the length of metric' v
    center: Array  # (n,)
    radius: float


class Rows(NamedTuple):
    """Rows in order of arrival, scaled by powers of two to a largest coefficient of the weights in [1/2, 1)."""

    a: Array  # (m, n)
    cost: Array  # (m, 2) above and below
    scale: Array  # (m,) what they were divided by; 0 once removed
    norm: Array  # (m,) |a|*
    side: Array  # (m,) as last seen: +1, -1, or 0 while active
    group: Indices  # (m,)

    def part(self, which: slice | npt.NDArray[np.generic]) -> "Rows":
        a, cost, scale, norm, side, group = self
        return Rows(a[which], cost[which], scale[which], norm[which], side[which], group[which])

    def with_room(self, room: int) -> "Rows":
        grown = empty_rows(room, self.a.shape[1])
        for new, old in zip(grown, self, strict=True):
            new[: len(old)] = old
        return grown


def empty_rows(room: int, columns: int) -> Rows:
    scale, norm, side = np.zeros((3, room))
    return Rows(np.zeros((room, columns)), np.zeros((room, 2)), scale, norm, side, np.zeros(room, np.int64))


# ---- the conditions


@compiled
def slope(cost: Array, k: int, side: float) -> float:
    """Derivative of a condition's cost (2, room) on that side; 0 while active, or where the cost is infinite."""
    derivative = cost[0, k] if side > 0 else -cost[1, k] if side < 0 else 0.0
    return 0.0 if math.isinf(derivative) else derivative


@compiled
def put(state: State, k: int, side: float) -> None:
    """Put a condition on a side, or make it active, and change the gradients accordingly."""
    for phase in range(2):
        cost = state.cost[phase]
        change = slope(cost, k, side) - slope(cost, k, state.side[k])
        if change != 0:
            for j in range(len(state.active)):
                state.gradient[phase, j] += change * state.a[j, k]
    state.side[k] = side


@compiled
def append(state: State, numbers: Indices, rows: Rows) -> None:
    """Add some of the rows as inactive ones; where its value is zero, a row keeps its side."""
    for i in numbers:
        k = state.tally[COUNT]
        state.tally[COUNT] += 1
        value = 0.0
        for j in range(len(state.active)):
            state.a[j, k] = rows.a[i, j]
            value += rows.a[i, j] * state.x[j]
        for sign in range(2):
            state.cost[FIT, sign, k] = rows.cost[i, sign]
            state.cost[VIOLATION, sign, k] = 1.0 if math.isinf(rows.cost[i, sign]) else 0.0
        state.number[k] = i
        state.value[k] = value
        state.side[k] = 0.0
        put(state, k, side_of(value, rows.side[i]))


@compiled
def free(state: State, k: int) -> None:
    """Take the cost of a condition away."""
    side = state.side[k]
    put(state, k, 0.0)
    state.cost[:, :, k] = 0.0
    state.side[k] = side


@compiled
def side_of(value: float, side: float) -> float:
    """The side of a row, read off its value where that is clear; an active row stays so."""
    if side == 0 or abs(value) <= ZERO:
        return side
    return 1.0 if value > 0 else -1.0


@compiled
def sum_gradients(state: State) -> None:
    """Compute both gradients from scratch."""
    count = state.tally[COUNT]
    sloping, slopes = np.empty(count, np.int64), np.empty(count)
    for phase in range(2):
        size = 0
        for k in range(count):
            slopes[size] = slope(state.cost[phase], k, state.side[k])
            if slopes[size] != 0:
                sloping[size] = k
                size += 1
        for j in range(len(state.active)):
            total = state.settled[j] if phase == FIT else 0.0
            for p in range(size):
                total += slopes[p] * state.a[j, sloping[p]]
            state.gradient[phase, j] = total


# ---- the present vertex


@compiled
def holds(ball: Ball, x: Array, reach: float) -> bool:
    """Whether x lies in the ball with its radius multiplied by this factor."""
    if math.isinf(ball.radius):
        return True
    return norm(transformed(ball.metric, x - ball.center)) <= reach * ball.radius


@compiled
def transformed(metric: Array, v: Array) -> Array:
    """metric' v"""
    image = np.zeros(len(v))
    for j in range(len(v)):
        for i in range(j + 1):
            image[i] += metric[j, i] * v[j]
    return image


@compiled
def evaluate(state: State, direction: Array, out: Array) -> None:
    """a . direction of every condition."""
    count = state.tally[COUNT]
    for k in range(count):
        out[k] = 0.0
    for j in range(len(direction)):
        factor = direction[j]
        if factor != 0:
            for k in range(count):
                out[k] += factor * state.a[j, k]


@compiled
def locate(state: State, tolerance: float) -> bool:
    """Compute x and all values from the active conditions; False if a condition turns out to be on its other side.

    Hard rows may be violated by the tolerance before they count as such.
    """
    n, count = len(state.active), state.tally[COUNT]
    x = state.x
    for j in range(n):
        x[j] = state.inverse[j, 0]
    error = np.zeros(n)
    for i in range(n):
        for j in range(n):
            error[i] += state.a[j, state.active[i]] * x[j]
    error[0] -= 1.0
    for j in range(n):
        for i in range(n):
            x[j] -= state.inverse[j, i] * error[i]
        if abs(x[j]) < ZERO:
            x[j] = 0.0
    evaluate(state, x, state.value)
    consistent = True
    for k in range(count):
        wrong = -state.side[k] * state.value[k]
        if wrong > ZERO:
            hard = math.isinf(state.cost[FIT, 0 if state.value[k] > 0 else 1, k])
            if not hard or wrong > tolerance:
                put(state, k, -state.side[k])
                consistent = False
    return consistent


@compiled
def violation(state: State) -> float:
    """The largest of a hard condition."""
    largest = 0.0
    for k in range(1, state.tally[COUNT]):
        if slope(state.cost[VIOLATION], k, state.side[k]) != 0:
            largest = max(largest, abs(state.value[k]))
    return largest


# ---- pivoting


@compiled
def improve(
    state: State, ball: Ball, weights: int, flat: float, shift: float, tolerance: float
) -> tuple[bool, bool, bool, bool, float, float, float]:
    """Descend to the least violation, then to the least F; it also stops for a new inverse, and before it leaves the ball.

    Args:
        weights: number of columns, the first ones, that are weights.
        flat: slopes within this fraction of the gradient do not descend.
        shift: conditions of a degenerate vertex are moved apart by about this.
        tolerance: hard rows violated by no more are met.
    Returns:
        Whether it ends in the ball; whether the hard rows contradict each other; whether rounding left the result consistent;
        whether it meets the hard rows; and its bounds.
    """
    stays, contradicted, updates = True, False, state.tally[UPDATES]
    for k in range(1, state.tally[COUNT]):
        if state.side[k] * state.value[k] < -ZERO:  # one that was tolerated
            put(state, k, -state.side[k])
    for phase in range(2):
        if phase == FIT:
            contradicted = violation(state) > tolerance
            if not contradicted:
                meet(state)
        elif violation(state) <= ZERO:
            continue
        stays = descend(state, ball, phase, contradicted, flat, shift)
        consistent = locate(state, tolerance if phase == FIT and not contradicted else 0.0)
        if not stays:
            break
    if state.tally[UPDATES] > updates:
        sum_gradients(state)  # rounding left by costs that came and went
    return stays and holds(ball, state.x, 1.0), contradicted, consistent, violation(state) <= tolerance, *bounds(state, weights)


@compiled
def meet(state: State) -> None:
    """Ignore the tolerable violations of hard conditions."""
    for k in range(1, state.tally[COUNT]):
        if slope(state.cost[VIOLATION], k, state.side[k]) != 0:
            state.value[k] = 0.0
            put(state, k, -state.side[k])


@compiled
def descend(state: State, ball: Ball, phase: int, level: bool, flat: float, shift: float) -> bool:
    """Exchange conditions until no edge descends; if asked to, along edges that leave the violation as it is.

    Returns:
        False if it stopped because the edge to follow leads too far out of the ball, or is turned by a settled row.
    """
    slopes = np.empty((2, 2 * len(state.active)))
    room = np.empty((3, len(state.value)))
    ahead = np.empty(len(state.value), np.int64)
    place = state.x - ball.center
    if not math.isinf(ball.radius):
        place = transformed(ball.metric, place)
    stalled = 0
    while state.tally[UPDATES] < REFRESH:
        edge = choose(state, phase, level, flat, slopes)
        if edge < 0:
            return True
        firm = phase == FIT and not level
        step = ratio_test(state, ball, place, edge, phase, firm, slopes[phase, edge], room, ahead)
        if step == NO_STEP:
            return math.isinf(ball.radius)  # with no row settled, rounding alone keeps an edge from turning
        stalled = stalled + 1 if step < TIE else 0
        if stalled == STALLED:
            perturb(state, shift)
            stalled = 0
    return True


@compiled
def choose(state: State, phase: int, level: bool, flat: float, slopes: Array) -> int:
    """The edge to follow, or -1 if none descends; and the slopes (2, 2n) of all edges."""
    price(state, phase, slopes[phase])
    flattest = -flat * norm(state.gradient[phase])
    highest = LEVEL * norm(state.gradient[VIOLATION])
    if phase == VIOLATION or level:
        price(state, 1 - phase, slopes[1 - phase])
    best, edge = math.inf, -1
    for i in range(slopes.shape[1]):
        if slopes[phase, i] < flattest and not (level and slopes[VIOLATION, i] > highest):
            # the steepest; but of those that lessen the violation, the one that raises F least for it: the dual simplex rule
            merit = slopes[FIT, i] if phase == FIT else slopes[FIT, i] / -slopes[VIOLATION, i]
            if merit < best or edge < 0:
                best, edge = merit, i
    return edge


@compiled
def norm(vector: Array) -> float:
    total = 0.0
    for j in range(len(vector)):
        total += vector[j] * vector[j]
    return math.sqrt(total)


@compiled
def price(state: State, phase: int, slopes: Array) -> None:
    """The slope of every edge (2n,), upwards and downwards."""
    n = len(state.active)
    for i in range(n):
        slopes[i] = 0.0
    for j in range(n):
        g = state.gradient[phase, j]
        if g != 0:
            for i in range(n):
                slopes[i] += g * state.inverse[j, i]
    for i in range(n):
        slopes[n + i] = state.cost[phase, 1, state.active[i]] - slopes[i]
        slopes[i] += state.cost[phase, 0, state.active[i]]


@compiled
def rises(state: State, steep: float) -> bool:
    """Whether F rises along every edge by more than this fraction of the largest component of its gradient."""
    n = len(state.active)
    slopes = np.empty(2 * n)
    price(state, FIT, slopes)
    largest = 0.0
    for j in range(n):
        largest = max(largest, abs(state.gradient[FIT, j]))
    smallest = math.inf
    for i in range(2 * n):
        smallest = min(smallest, slopes[i])
    return smallest > steep * largest


@compiled
def ratio_test(
    state: State, ball: Ball, place: Array, edge: int, phase: int, firm: bool, initial: float, room: Array, ahead: Indices
) -> float:
    """Move along a descending edge to the condition that turns it upwards, and exchange; the length of the step.

    It is NO_STEP, and nothing has changed, if that condition is too far out of the ball, or if nothing turns the edge.

    Args:
        place: metric' (x - center of the ball); it is updated.
        firm: hard rows are met and must stay met.
    """
    n, count = len(state.active), state.tally[COUNT]
    i = edge % n
    upwards = 1.0 if edge < n else -1.0
    change, distance, speed = room[0], room[1], room[2]
    direction = np.empty(n)
    for j in range(n):
        direction[j] = upwards * state.inverse[j, i]
    evaluate(state, direction, change)
    size = 0
    for k in range(count):
        approach = -state.side[k] * change[k]
        if firm and approach < -PARALLEL and math.isinf(state.cost[FIT, 0 if state.side[k] > 0 else 1, k]):
            # hard on the side it is on, and met: it is zero, and hard on the other side, too
            ahead[size] = k
            speed[size] = -approach
            distance[size] = 0.0
            size += 1
        elif approach > PARALLEL:
            ahead[size] = k
            speed[size] = approach
            distance[size] = max(state.side[k] * state.value[k], 0.0) / approach
            size += 1
    # the breakpoints in order of distance, as far as needed
    crossed, steepness = 0, initial
    while True:
        if crossed == size:
            # F is bounded below: with no row settled, rounding hides that the last crossed that costs anything turns the edge
            while crossed > 0 and state.cost[phase, 0, ahead[crossed - 1]] + state.cost[phase, 1, ahead[crossed - 1]] == 0:
                crossed -= 1
            if crossed == 0 or not math.isinf(ball.radius):
                return NO_STEP
            crossed -= 1
            nearest = crossed
            break
        nearest = crossed
        for p in range(crossed + 1, size):
            if distance[p] < distance[nearest]:
                nearest = p
        k = ahead[nearest]
        steepness += (state.cost[phase, 0, k] + state.cost[phase, 1, k]) * speed[nearest]
        if steepness >= 0:
            break
        ahead[crossed], ahead[nearest] = k, ahead[crossed]
        distance[crossed], distance[nearest] = distance[nearest], distance[crossed]
        speed[crossed], speed[nearest] = speed[nearest], speed[crossed]
        crossed += 1
    limit = distance[nearest] + TIE
    for p in range(crossed, size):
        if distance[p] <= limit and speed[p] > speed[nearest]:
            nearest = p
    step: float = distance[nearest]
    if not math.isinf(ball.radius):
        moved = transformed(ball.metric, direction)
        for j in range(n):
            moved[j] = place[j] + step * moved[j]
        if norm(moved) > REACH * ball.radius:
            return NO_STEP
        place[:] = moved
    for k in range(count):
        state.value[k] += step * change[k]
    for p in range(crossed):
        put(state, ahead[p], -state.side[ahead[p]])
    put(state, state.active[i], upwards)
    entering = ahead[nearest]
    put(state, entering, 0.0)
    state.value[entering] = 0.0
    exchange(state, i, entering)
    return step


@compiled
def exchange(state: State, i: int, entering: int) -> None:
    """Put a condition in the place of the i-th active one."""
    n = len(state.active)
    inverse = state.inverse
    state.active[i] = entering
    state.tally[UPDATES] += 1
    row = np.zeros(n)
    for j in range(n):
        factor = state.a[j, entering]
        for p in range(n):
            row[p] += factor * inverse[j, p]
    pivot = row[i]
    row[i] = 0.0
    for j in range(n):
        column = inverse[j, i] / pivot
        for p in range(n):
            inverse[j, p] -= column * row[p]
        inverse[j, i] = column


@compiled
def perturb(state: State, shift: float) -> None:
    """Move the conditions that are nearly zero away from zero, each by another amount, so that edges have a length."""
    for k in range(state.tally[COUNT]):
        if state.side[k] * state.value[k] < shift:
            state.value[k] += state.side[k] * shift * (1.0 + k * GOLDEN % 1.0)


# ---- how far the objective leaves it free


@compiled
def stretch(state: State, ball: Ball, tilt: Array, level: float, limit: int, weights: int) -> int:
    """Walk from the optimum to the x of largest tilt . x among those with F(x) <= level: a parametric simplex method.

    On the way F - lambda tilt . x is at its least, for a lambda that rises from 0. The last step ends where F is the level.

    Args:
        state: at the least F; it is used up.
        tilt: (n,).
        limit: of exchanges.
        weights: number of columns, the first ones, that are weights.
    Returns:
        ARRIVED if `state.x` is proven to be that x; INEXACT if rounding prevents the proof; LED_OUT if the way there leads out
        of the ball; ENDLESS if the limit was reached.
    """
    n = len(state.active)
    slopes = np.empty(2 * n)
    rates = np.empty(n)
    direction = np.empty(n)
    change = np.empty(len(state.value))
    x = state.x
    f = 0.0
    for j in range(n):
        f += state.settled[j] * x[j]
    for k in range(state.tally[COUNT]):
        f += state.value[k] * slope(state.cost[FIT], k, np.sign(state.value[k]))
    stalled = 0
    for _ in range(limit):
        price(state, FIT, slopes)
        for i in range(n):
            rates[i] = 0.0
        for j in range(n):
            if tilt[j] != 0:
                for i in range(n):
                    rates[i] += tilt[j] * state.inverse[j, i]
        best, edge = math.inf, -1
        for i in range(1, n):
            if rates[i] > PARALLEL:
                merit, candidate = slopes[i] / rates[i], i
            elif rates[i] < -PARALLEL:
                merit, candidate = slopes[n + i] / -rates[i], n + i
            else:
                continue
            if merit < best:
                best, edge = merit, candidate
        if edge < 0:
            if not holds(ball, x, 1.0):
                return LED_OUT
            return ARRIVED if falls_short(tilt, x, weights, np.max(tilt[:weights])) <= SHORT else INEXACT
        steepness = max(slopes[edge], 0.0)
        i = edge % n
        upwards = 1.0 if edge < n else -1.0
        for j in range(n):
            direction[j] = upwards * state.inverse[j, i]
        evaluate(state, direction, change)
        step, speed, entering = math.inf, 0.0, -1
        for k in range(state.tally[COUNT]):
            approach = -state.side[k] * change[k]
            if approach > PARALLEL and state.cost[FIT, 0, k] + state.cost[FIT, 1, k] > 0:
                distance = max(state.side[k] * state.value[k], 0.0) / approach
                if distance < step - TIE or (distance <= step + TIE and approach > speed):
                    step, speed, entering = distance, approach, k
        end = steepness > 0 and f + steepness * step >= level
        if end:
            step = max(0.0, (level - f) / steepness)
        if math.isinf(step):
            return LED_OUT
        f += steepness * step
        for j in range(n):
            x[j] += step * direction[j]
        if not holds(ball, x, 1.0):
            return LED_OUT
        if end:
            return ARRIVED if proven(state, tilt, level, edge, weights) else INEXACT
        for k in range(state.tally[COUNT]):
            state.value[k] += step * change[k]
        put(state, state.active[i], upwards)
        put(state, entering, 0.0)
        state.value[entering] = 0.0
        exchange(state, i, entering)
        stalled = stalled + 1 if step < TIE else 0
        if stalled == STALLED:
            perturb(state, PERTURBATION)
            stalled = 0
    return ENDLESS


@compiled
def proven(state: State, tilt: Array, level: float, edge: int, weights: int) -> bool:
    """Compute x, where an edge reaches the level, once more without the rounding of the walk; and whether it is proven that no
    x with F(x) <= level has a larger tilt . x.

    For any rate > 0 and any multipliers y in their box, tilt . x is at most (level - min_j (A' y - rate tilt)_j) / rate. The
    bound is sharp at the rate at which the cost along the edge is level.
    """
    n, x = len(state.active), state.x
    i = edge % n
    basis, direction = np.empty((n, n)), np.empty(n)
    for j in range(n):
        for p in range(n):
            basis[p, j] = state.a[j, state.active[p]]
    solve_basis(state, basis, 0, 1.0, x)
    solve_basis(state, basis, i, 1.0 if edge < n else -1.0, direction)
    evaluate(state, x, state.value)
    sum_gradients(state)
    slope_along, rate_along, f = state.cost[FIT, 0 if edge < n else 1, state.active[i]], 0.0, 0.0
    for j in range(n):
        slope_along += state.gradient[FIT, j] * direction[j]
        rate_along += tilt[j] * direction[j]
        f += state.settled[j] * x[j]
    for k in range(state.tally[COUNT]):
        f += state.value[k] * slope(state.cost[FIT], k, np.sign(state.value[k]))
    if not (slope_along > 0 and rate_along > 0):
        return False
    step, rate = max(0.0, (level - f) / slope_along), slope_along / rate_along
    for j in range(n):
        x[j] += step * direction[j]
        state.gradient[FIT, j] -= rate * tilt[j]
    evaluate(state, x, state.value)
    f, lower_bound, smallest = bounds(state, weights)
    if f > level + SHORT * abs(level) or smallest < -SHORT:
        return False
    return falls_short(tilt, x, weights, (level - lower_bound) / rate) <= SHORT


@compiled
def solve_basis(state: State, basis: Array, i: int, value: float, solution: Array) -> None:
    """The x at which the i-th active condition has this value and the others zero, without the rounding of the inverse.

    Args:
        basis: (n, n) the normals of the active conditions.
        solution: (n,) takes x.
    """
    n = len(solution)
    for j in range(n):
        solution[j] = value * state.inverse[j, i]
    residual = np.empty(n)
    for _ in range(2):
        largest = 0.0
        for p in range(n):
            residual[p] = value if p == i else 0.0
            for j in range(n):
                residual[p] -= basis[p, j] * solution[j]
            largest = max(largest, abs(residual[p]))
        if largest <= ZERO:
            break
        for j in range(n):
            for p in range(n):
                solution[j] += state.inverse[j, p] * residual[p]


@compiled
def falls_short(tilt: Array, x: Array, weights: int, bound: float) -> float:
    """By how much tilt . x is below a bound, as a share of the range of the tilt over the weights."""
    reached = 0.0
    for j in range(len(x)):
        reached += tilt[j] * x[j]
    return (bound - reached) / (np.max(tilt[:weights]) - np.min(tilt[:weights]) + TIE)


@compiled
def stretch_each(
    state: State, ball: Ball, tilts: Array, level: float, limit: int, found: Array, first: int, weights: int
) -> tuple[int, int]:
    """Walk along each of some tilts in turn, always from the same optimum, until a walk does not arrive.

    Args:
        state: at the least F; it stays as it is.
        tilts: (k, n).
        found: (k, n) takes the x of each walk that arrived.
        first: the tilt to begin with.
        weights: number of columns, the first ones, that are weights.
    Returns:
        The number of the tilt whose walk did not arrive, k if all did; and how the last walk ended.
    """
    for t in range(first, len(tilts)):
        walker = State(
            state.tally.copy(),
            state.number,
            state.a,
            state.value.copy(),
            state.side.copy(),
            state.cost,
            state.settled,
            state.gradient.copy(),
            state.active.copy(),
            state.inverse.copy(),
            state.x.copy(),
            state.dual.copy(),
        )
        end = stretch(walker, ball, tilts[t], level, limit, weights)
        if end != ARRIVED:
            return t, end
        found[t] = walker.x
    return len(tilts), ARRIVED


# ---- the certificate


@compiled
def bounds(state: State, weights: int) -> tuple[float, float, float]:
    """F(x), a bound below it from the multipliers, and the least x_j."""
    n, count = len(state.active), state.tally[COUNT]
    objective = 0.0
    for j in range(n):
        objective += state.settled[j] * state.x[j]
    for k in range(count):
        objective += state.value[k] * slope(state.cost[FIT], k, np.sign(state.value[k]))
    total, y, correction = np.empty(n), np.zeros(n), np.empty(n)
    for j in range(n):
        total[j] = state.gradient[FIT, j]
    for _ in range(2):  # the second time for the rounding of the first
        for i in range(n):
            correction[i] = 0.0
        for j in range(n):
            for i in range(n):
                correction[i] -= total[j] * state.inverse[j, i]
        for i in range(n):
            y[i] += correction[i]
        add_active(state, correction, total)
    for i in range(n):
        k = state.active[i]
        clipped = min(max(y[i], -state.cost[FIT, 1, k]), state.cost[FIT, 0, k])
        state.dual[i] = 0.0 if k <= n else clipped
    for j in range(n):
        total[j] = state.gradient[FIT, j]
    add_active(state, state.dual, total)
    lower_bound = math.inf
    for j in range(weights):
        lower_bound = min(lower_bound, total[j])
    if weights < n and total[weights] < 0:
        lower_bound += total[weights] * largest_scale(state, objective)
    smallest = math.inf
    for j in range(n):
        smallest = min(smallest, state.x[j])
    return objective, lower_bound, smallest


@compiled
def add_active(state: State, multipliers: Array, total: Array) -> None:
    """total += multipliers B"""
    for i in range(len(multipliers)):
        if multipliers[i] != 0:
            for j in range(len(total)):
                total[j] += multipliers[i] * state.a[j, state.active[i]]


@compiled
def largest_scale(state: State, objective: float) -> float:
    """A bound on the scale of any x that is as good: see `program.largest_scale`. From the unsettled rows alone."""
    n = len(state.active)
    bound, steepness, constant = math.inf, 0.0, objective
    for k in range(n + 1, state.tally[COUNT]):
        b = state.a[n - 1, k]
        if b != 0:
            cost = state.cost[FIT, 0 if b > 0 else 1, k]
            relief = -math.inf
            for j in range(n - 1):
                relief = max(relief, -np.sign(b) * state.a[j, k])
            if math.isinf(cost):
                bound = min(bound, relief / abs(b))
            else:
                steepness += cost * abs(b)
                constant += cost * relief
    return max(0.0, min(bound, constant / steepness)) if steepness > 0 else bound


# ---- the rows


@compiled
def receive(
    state: State, rows: Rows, first: int, group: int, a: Array, above: Array, below: Array, weights: int, unsettled: bool
) -> float:
    """Store the rows of a group, and append them to the basis if they are to be unsettled; returns what `store` does.

    In one function: entering a compiled one takes longer than this.
    """
    worst = store(rows, first, group, a, above, below, weights)
    if unsettled and worst >= 0:
        append(state, np.arange(first, first + len(a)), rows)
    return worst


@compiled
def store(rows: Rows, first: int, group: int, a: Array, above: Array, below: Array, weights: int) -> float:
    """Put the rows a (m, n) of a group from `first` on, scaled in place by powers of two, which is exact.

    Returns:
        The most that weights alone make them cost; COEFFICIENT or COST where one of these cannot be used.
    """
    worst = 0.0
    for p in range(len(a)):
        i = first + p
        largest = 0.0
        for j in range(a.shape[1]):
            if not abs(a[p, j]) <= LARGEST:
                return COEFFICIENT
            if j < weights:
                largest = max(largest, abs(a[p, j]))
        if largest < 1 / LARGEST:
            largest = 0.0
        peak = largest if largest > 0 else abs(a[p, -1])  # that of the scale, if there is one
        if peak < 1 / LARGEST:
            peak = 0.0
        rows.group[i] = group
        rows.scale[i] = 2.0 ** math.frexp(peak)[1]
        for j in range(a.shape[1]):
            rows.a[i, j] = a[p, j] / rows.scale[i] if peak > 0 else 0.0
        rows.cost[i, 0], rows.cost[i, 1] = above[p], below[p]
        highest = 0.0
        for sign in range(2):
            if not (0 <= rows.cost[i, sign] <= LARGEST or rows.cost[i, sign] == math.inf):
                return COST
            # a row of zeros costs nothing, and no x violates it
            rows.cost[i, sign] = rows.cost[i, sign] * rows.scale[i] if peak > 0 else 0.0
            if rows.cost[i, sign] < math.inf:
                highest = max(highest, rows.cost[i, sign])
        rows.side[i] = 1.0 if rows.cost[i, 0] <= rows.cost[i, 1] else -1.0
        worst += highest * largest / rows.scale[i]
    return worst


@compiled
def rank(numbers: Indices, x: Array, rows: Rows, distance: Array) -> None:
    """How far from x the nearest point is where each of some rows may be on another side; updates their sides."""
    for p in range(len(numbers)):
        i = numbers[p]
        value = 0.0
        for j in range(len(x)):
            value += rows.a[i, j] * x[j]
        side = rows.side[i] = side_of(value, rows.side[i])
        if side == 0 or math.isinf(rows.cost[i, 0 if side > 0 else 1]):
            distance[p] = 0.0  # active rows and hard rows on their hard side are never settled
        elif rows.cost[i, 0] == 0 and rows.cost[i, 1] == 0:
            distance[p] = math.inf  # rows without cost, removed ones among them, always are
        else:
            distance[p] = abs(value) / rows.norm[i]


@compiled
def add_gradients(numbers: Indices, rows: Rows, total: Array) -> None:
    """Add the gradients of these rows' costs on their sides, finite ones."""
    for p in range(len(numbers)):
        i = numbers[p]
        derivative = rows.cost[i, 0] if rows.side[i] > 0 else -rows.cost[i, 1]
        if not math.isinf(derivative):
            for j in range(len(total)):
                total[j] += derivative * rows.a[i, j]
