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
least violation. A new observation changes only g, so that a few exchanges restore optimality.

`pivoting.pxd` declares the types of this module, and Cython compiles both when the package is built. As plain Python, which it
also is, it gives the same bits, a hundred times slower. So it contains loops over elements where NumPy would take a line, every
array is contiguous, and no function that runs in a loop allocates one: `State` has room for intermediate results.
"""

import math
from math import inf

import numpy as np

from pushfric_core.geometry.planar import Array, Indices
from pushfric_core.solvers.tableau import (
    COEFFICIENT,
    COST,
    FIT,
    LARGEST,
    REFRESH,
    VIOLATION,
    ZERO,
    Conditions,
    Rows,
)

PARALLEL = 1e-9
"""A row that changes by less than this along an edge is parallel to it: exchanging it would make B nearly singular."""

TIE = 1e-15
"""Breakpoints closer than this count as one; the steepest of its rows makes the best-conditioned exchange."""

LEVEL = 1e-9
"""Edges whose slope is within this fraction of the gradient leave the violation as it is."""

STALLED = 12
"""After this many exchanges without progress, a degenerate vertex is perturbed: its conditions are shifted apart."""

GOLDEN = (math.sqrt(5) - 1) / 2
"""Its multiples modulo 1 are as different from each other as can be, and the same on every run."""

REACH = 2.0
"""Pivoting goes no farther than this many radii from the center of its ball.

Outside, the rows settled there are taken for linear: F is underestimated, a little near the ball, where one descent ends
is a good start for the next, and without bound in the corners of the simplex, where a descent that believes it would end.
"""

NO_STEP = -1.0  # what `ratio_test` returns without one


class Scratch:
    """Room for intermediate results: for n support points, and so many conditions."""

    def __init__(self, n: int, room: int) -> None:
        self.direction, self.row, self.residual, self.total = np.empty((4, n))
        self.multipliers, self.correction, self.entering = np.empty((3, n))
        self.slopes = np.empty((2, 2 * n))
        self.change, self.distance, self.speed = np.empty((3, room))
        self.ahead, self.nonzero = np.empty(room, np.int64), np.empty(n, np.int64)


class State:
    """A basis as the functions of this module see it.

    Args:
        conditions: what it consists of; functions change these arrays.
        count: number of conditions.
        updates: of the inverse since it was last computed from scratch.
    """

    def __init__(self, conditions: Conditions, count: int, updates: int = 0) -> None:
        self.conditions, self.count, self.updates = conditions, count, updates
        self.number, self.a, self.value, self.side, self.cost, self.settled = conditions[:6]
        self.gradient, self.active, self.inverse, self.x, self.dual = conditions[6:]
        self.scratch = Scratch(len(conditions.x), len(conditions.value))

    def __reduce__(self) -> tuple[type["State"], tuple[Conditions, int, int]]:
        return State, (self.conditions, self.count, self.updates)


class Ball:
    """Where the rows settled around its center keep their sides.

    Args:
        metric: (n, n) lower triangular: |v| is the length of metric' v.
        center: (n,).
        radius: infinite where no row is settled.
    """

    def __init__(self, metric: Array, center: Array, radius: float) -> None:
        self.metric, self.center, self.radius = metric, center, radius
        self.place, self.moved = np.empty((2, len(center)))

    def __reduce__(self) -> tuple[type["Ball"], tuple[Array, Array, float]]:
        return Ball, (np.asarray(self.metric), np.asarray(self.center), self.radius)


# ---- the conditions


def slope(state: State, phase: int, k: int, side: float) -> float:
    """Derivative of a condition's cost on that side; 0 while active, or where the cost is infinite."""
    derivative = 0.0
    if side > 0:
        derivative = state.cost[phase, 0, k]
    elif side < 0:
        derivative = -state.cost[phase, 1, k]
    return 0.0 if abs(derivative) == inf else derivative


def put(state: State, k: int, side: float) -> None:
    """Put a condition on a side, or make it active, and change the gradients accordingly."""
    for phase in range(2):
        change = slope(state, phase, k, side) - slope(state, phase, k, state.side[k])
        if change != 0:
            for j in range(len(state.active)):
                state.gradient[phase, j] += change * state.a[j, k]
    state.side[k] = side


def append(state: State, numbers: Indices, rows: Rows) -> None:
    """Add some of the rows as inactive ones; where its value is zero, a row keeps its side."""
    a, cost, side = rows.a, rows.cost, rows.side
    for p in range(len(numbers)):
        enter(state, numbers[p], a, cost, side)


def enter(state: State, i: int, a: Array, cost: Array, side: Array) -> None:
    """Add the i-th of these rows."""
    k = state.count
    state.count += 1
    value = 0.0
    for j in range(len(state.active)):
        state.a[j, k] = a[i, j]
        value += a[i, j] * state.x[j]
    for sign in range(2):
        state.cost[FIT, sign, k] = cost[i, sign]
        state.cost[VIOLATION, sign, k] = 1.0 if cost[i, sign] == inf else 0.0
    state.number[k] = i
    state.value[k] = value
    state.side[k] = 0.0
    put(state, k, side_of(value, side[i]))


def free(state: State, k: int) -> None:
    """Take the cost of a condition away."""
    side = state.side[k]
    put(state, k, 0.0)
    for phase in range(2):
        state.cost[phase, 0, k] = state.cost[phase, 1, k] = 0.0
    state.side[k] = side


def side_of(value: float, side: float) -> float:
    """The side of a row, read off its value where that is clear; an active row stays so."""
    if side == 0 or abs(value) <= ZERO:
        return side
    return 1.0 if value > 0 else -1.0


def sum_gradients(state: State) -> None:
    """Compute both gradients from scratch."""
    sloping, slopes, a = state.scratch.ahead, state.scratch.change, state.a
    for phase in range(2):
        size = 0
        for k in range(state.count):
            slopes[size] = slope(state, phase, k, state.side[k])
            if slopes[size] != 0:
                sloping[size] = k
                size += 1
        for j in range(len(state.active)):
            total = state.settled[j] if phase == FIT else 0.0
            for p in range(size):
                total += slopes[p] * a[j, sloping[p]]
            state.gradient[phase, j] = total


# ---- the present vertex


def holds(ball: Ball, x: Array, reach: float) -> bool:
    """Whether x lies in the ball with its radius multiplied by this factor."""
    return ball.radius == inf or move_to(ball, x) <= reach * ball.radius


def move_to(ball: Ball, x: Array) -> float:
    """Set `ball.place` to that of x, metric' (x - center), and return its length."""
    for j in range(len(x)):
        ball.moved[j] = x[j] - ball.center[j]
    transform(ball.metric, ball.moved, ball.place)
    return norm(ball.place)


def transform(metric: Array, v: Array, out: Array) -> None:
    """metric' v"""
    for i in range(len(v)):
        out[i] = 0.0
    for j in range(len(v)):
        for i in range(j + 1):
            out[i] += metric[j, i] * v[j]


def combine(state: State, factors: Array, matrix: Array, count: int, out: Array) -> None:
    """factors' matrix, of its first `count` columns. Nearly all time is spent here, hence four rows in one pass."""
    nonzero = state.scratch.nonzero
    size = 0
    for j in range(len(factors)):
        if factors[j] != 0:
            nonzero[size] = j
            size += 1
    for k in range(count):
        out[k] = 0.0
    whole = size - size % 4
    for p in range(0, whole, 4):
        j, j_2, j_3, j_4 = nonzero[p], nonzero[p + 1], nonzero[p + 2], nonzero[p + 3]
        d, d_2, d_3, d_4 = factors[j], factors[j_2], factors[j_3], factors[j_4]
        for k in range(count):
            out[k] = out[k] + d * matrix[j, k] + d_2 * matrix[j_2, k] + d_3 * matrix[j_3, k] + d_4 * matrix[j_4, k]
    for p in range(whole, size):
        j = nonzero[p]
        d = factors[j]
        for k in range(count):
            out[k] += d * matrix[j, k]


def locate(state: State, tolerance: float) -> bool:
    """Compute x and all values from the active conditions; False if a condition turns out to be on its other side.

    Hard rows may be violated by the tolerance before they count as such.
    """
    n, count = len(state.active), state.count
    x = state.x
    for j in range(n):
        x[j] = state.inverse[j, 0]
    error = state.scratch.residual
    for i in range(n):
        error[i] = 0.0
    for j in range(n):
        if x[j] != 0:
            for i in range(n):
                error[i] += state.a[j, state.active[i]] * x[j]
    error[0] -= 1.0
    size = 0
    for i in range(n):
        if error[i] != 0:
            state.scratch.nonzero[size] = i
            size += 1
    for j in range(n):
        for p in range(size):
            x[j] -= state.inverse[j, state.scratch.nonzero[p]] * error[state.scratch.nonzero[p]]
        if abs(x[j]) < ZERO:
            x[j] = 0.0
    combine(state, x, state.a, count, state.value)
    consistent = True
    for k in range(count):
        wrong = -state.side[k] * state.value[k]
        if wrong > ZERO:
            hard = state.cost[FIT, 0 if state.value[k] > 0 else 1, k] == inf
            if not hard or wrong > tolerance:
                put(state, k, -state.side[k])
                consistent = False
    return consistent


def violation(state: State) -> float:
    """The largest of a hard condition."""
    largest = 0.0
    for k in range(1, state.count):
        if slope(state, VIOLATION, k, state.side[k]) != 0:
            largest = max(largest, abs(state.value[k]))
    return largest


# ---- pivoting


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
    stays, contradicted, consistent, updates = True, False, True, state.updates
    for k in range(1, state.count):
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
    if state.updates > updates:
        sum_gradients(state)  # rounding left by costs that came and went
    stays = stays and holds(ball, state.x, 1.0)
    objective, lower_bound, smallest = bounds(state, weights)
    return stays, contradicted, consistent, violation(state) <= tolerance, objective, lower_bound, smallest


def meet(state: State) -> None:
    """Ignore the tolerable violations of hard conditions."""
    for k in range(1, state.count):
        if slope(state, VIOLATION, k, state.side[k]) != 0:
            state.value[k] = 0.0
            put(state, k, -state.side[k])


def descend(state: State, ball: Ball, phase: int, level: bool, flat: float, shift: float) -> bool:
    """Exchange conditions until no edge descends; if asked to, along edges that leave the violation as it is.

    Returns:
        False if it stopped because the edge to follow leads too far out of the ball, or is turned by a settled row.
    """
    if ball.radius != inf:
        move_to(ball, state.x)
    stalled = 0
    while state.updates < REFRESH:
        edge = choose(state, phase, level, flat)
        if edge < 0:
            return True
        firm = phase == FIT and not level
        step = ratio_test(state, ball, edge, phase, firm)
        if step == NO_STEP:
            return ball.radius == inf  # with no row settled, rounding alone keeps an edge from turning
        stalled = stalled + 1 if step < TIE else 0
        if stalled == STALLED:
            perturb(state, shift)
            stalled = 0
    return True


def choose(state: State, phase: int, level: bool, flat: float) -> int:
    """The edge to follow, or -1 if none descends; `state.scratch.slopes` are then those (2, 2n) of all edges."""
    slopes = state.scratch.slopes
    price(state, phase, slopes[phase])
    flattest = -flat * norm(state.gradient[phase])
    highest = LEVEL * norm(state.gradient[VIOLATION])
    if phase == VIOLATION or level:
        price(state, 1 - phase, slopes[1 - phase])
    best, edge = inf, -1
    for i in range(slopes.shape[1]):
        if slopes[phase, i] < flattest and not (level and slopes[VIOLATION, i] > highest):
            # the steepest; but of those that lessen the violation, the one that raises F least for it: the dual simplex rule
            merit = slopes[FIT, i] if phase == FIT else slopes[FIT, i] / -slopes[VIOLATION, i]
            if merit < best or edge < 0:
                best, edge = merit, i
    return edge


def norm(vector: Array) -> float:
    total = 0.0
    for j in range(len(vector)):
        total += vector[j] * vector[j]
    return math.sqrt(total)


def price(state: State, phase: int, slopes: Array) -> None:
    """The slope of every edge (2n,), upwards and downwards."""
    n = len(state.active)
    combine(state, state.gradient[phase], state.inverse, n, slopes)
    for i in range(n):
        slopes[n + i] = state.cost[phase, 1, state.active[i]] - slopes[i]
        slopes[i] += state.cost[phase, 0, state.active[i]]


def rises(state: State, steep: float) -> bool:
    """Whether F rises along every edge by more than this fraction of the largest component of its gradient."""
    n = len(state.active)
    slopes = state.scratch.slopes[FIT]
    price(state, FIT, slopes)
    largest = 0.0
    for j in range(n):
        largest = max(largest, abs(state.gradient[FIT, j]))
    smallest = inf
    for i in range(2 * n):
        smallest = min(smallest, slopes[i])
    return smallest > steep * largest


def ratio_test(state: State, ball: Ball, edge: int, phase: int, firm: bool) -> float:
    """Move along a descending edge to the condition that turns it upwards, and exchange; the length of the step.

    It is NO_STEP, and nothing has changed, if that condition is too far out of the ball, or if nothing turns the edge.
    `ball.place` moves along.

    Args:
        firm: hard rows are met and must stay met.
    """
    n, count = len(state.active), state.count
    i = edge % n
    upwards = 1.0 if edge < n else -1.0
    change, distance, speed, ahead = state.scratch.change, state.scratch.distance, state.scratch.speed, state.scratch.ahead
    for j in range(n):
        state.scratch.direction[j] = upwards * state.inverse[j, i]
    combine(state, state.scratch.direction, state.a, count, change)
    size = 0
    for k in range(count):
        approach = -state.side[k] * change[k]
        if firm and approach < -PARALLEL and state.cost[FIT, 0 if state.side[k] > 0 else 1, k] == inf:
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
    crossed = 0
    steepness = state.scratch.slopes[phase, edge]
    while True:
        if crossed == size:
            # F is bounded below: with no row settled, rounding hides that the last crossed that costs anything turns the edge
            while crossed > 0 and state.cost[phase, 0, ahead[crossed - 1]] + state.cost[phase, 1, ahead[crossed - 1]] == 0:
                crossed -= 1
            if crossed == 0 or ball.radius != inf:
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
        swap(state, crossed, nearest)
        crossed += 1
    limit = distance[nearest] + TIE
    for p in range(crossed, size):
        if distance[p] <= limit and speed[p] > speed[nearest]:
            nearest = p
    step: float = distance[nearest]
    if ball.radius != inf:
        transform(ball.metric, state.scratch.direction, ball.moved)
        for j in range(n):
            ball.moved[j] = ball.place[j] + step * ball.moved[j]
        if norm(ball.moved) > REACH * ball.radius:
            return NO_STEP
        ball.place[:] = ball.moved
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


def swap(state: State, p: int, q: int) -> None:
    """Let two of the conditions ahead change places."""
    ahead, distance, speed = state.scratch.ahead, state.scratch.distance, state.scratch.speed
    ahead[p], ahead[q] = ahead[q], ahead[p]
    distance[p], distance[q] = distance[q], distance[p]
    speed[p], speed[q] = speed[q], speed[p]


def exchange(state: State, i: int, entering: int) -> None:
    """Put a condition in the place of the i-th active one."""
    n = len(state.active)
    inverse, a = state.inverse, state.a
    state.active[i] = entering
    state.updates += 1
    row = state.scratch.row
    for j in range(n):
        state.scratch.entering[j] = a[j, entering]
    combine(state, state.scratch.entering, inverse, n, row)
    pivot = row[i]
    row[i] = 0.0
    for j in range(n):
        column = inverse[j, i] / pivot
        if column != 0:  # most weights are zero, and stay so
            for p in range(n):
                inverse[j, p] -= column * row[p]
            inverse[j, i] = column


def perturb(state: State, shift: float) -> None:
    """Move the conditions that are nearly zero away from zero, each by another amount, so that edges have a length."""
    for k in range(state.count):
        if state.side[k] * state.value[k] < shift:
            state.value[k] += state.side[k] * shift * (1.0 + k * GOLDEN % 1.0)


# ---- the certificate


def bounds(state: State, weights: int) -> tuple[float, float, float]:
    """F(x), a bound below it from the multipliers, and the least x_j."""
    n, count = len(state.active), state.count
    objective = 0.0
    for j in range(n):
        objective += state.settled[j] * state.x[j]
    for k in range(count):
        objective += state.value[k] * slope(state, FIT, k, state.value[k])
    total, y, correction = state.scratch.total, state.scratch.multipliers, state.scratch.correction
    for j in range(n):
        y[j] = 0.0
        total[j] = state.gradient[FIT, j]
    for _ in range(2):  # the second time for the rounding of the first
        combine(state, total, state.inverse, n, correction)
        for i in range(n):
            correction[i] = -correction[i]
            y[i] += correction[i]
        add_active(state, correction, total)
    for i in range(n):
        k = state.active[i]
        clipped = min(max(y[i], -state.cost[FIT, 1, k]), state.cost[FIT, 0, k])
        state.dual[i] = 0.0 if k <= n else clipped
    for j in range(n):
        total[j] = state.gradient[FIT, j]
    add_active(state, state.dual, total)
    lower_bound = inf
    for j in range(weights):
        lower_bound = min(lower_bound, total[j])
    if weights < n and total[weights] < 0:
        lower_bound += total[weights] * largest_scale(state, objective)
    smallest = inf
    for j in range(n):
        smallest = min(smallest, state.x[j])
    return objective, lower_bound, smallest


def add_active(state: State, multipliers: Array, total: Array) -> None:
    """total += multipliers B"""
    n = len(total)
    for i in range(n):
        k = state.active[i]
        if 0 < k <= n:  # x_j >= 0 has a single coefficient
            total[k - 1] += multipliers[i]
        elif multipliers[i] != 0:
            for j in range(n):
                total[j] += multipliers[i] * state.a[j, k]


def largest_scale(state: State, objective: float) -> float:
    """A bound on the scale of any x that is as good: see `program.largest_scale`. From the unsettled rows alone."""
    n = len(state.active)
    bound, steepness, constant = inf, 0.0, objective
    for k in range(n + 1, state.count):
        b = state.a[n - 1, k]
        if b != 0:
            cost = state.cost[FIT, 0 if b > 0 else 1, k]
            against = -1.0 if b > 0 else 1.0
            relief = -inf
            for j in range(n - 1):
                relief = max(relief, against * state.a[j, k])
            if cost == inf:
                bound = min(bound, relief / abs(b))
            else:
                steepness += cost * abs(b)
                constant += cost * relief
    return max(0.0, min(bound, constant / steepness)) if steepness > 0 else bound


# ---- the rows


def receive(
    state: State, rows: Rows, first: int, group: int, a: Array, above: Array, below: Array, weights: int, unsettled: bool
) -> float:
    """Store the rows of a group, and append them to the basis if they are to be unsettled; returns what `store` does.

    In one function: entering a compiled one takes longer than this.
    """
    worst = store(rows, first, group, a, above, below, weights)
    if unsettled and worst >= 0:
        row_a, row_cost, row_side = rows.a, rows.cost, rows.side
        for i in range(first, first + len(a)):
            enter(state, i, row_a, row_cost, row_side)
    return worst


def store(rows: Rows, first: int, group: int, a: Array, above: Array, below: Array, weights: int) -> float:
    """Put the rows a (m, n) of a group from `first` on, scaled in place by powers of two, which is exact.

    Returns:
        The most that weights alone make them cost; COEFFICIENT or COST where one of these cannot be used.
    """
    row_a, cost, scale, side, groups = rows.a, rows.cost, rows.scale, rows.side, rows.group
    columns = a.shape[1]
    worst = 0.0
    for p in range(len(a)):
        i = first + p
        largest = 0.0
        for j in range(columns):
            if not abs(a[p, j]) <= LARGEST:
                return COEFFICIENT
            if j < weights:
                largest = max(largest, abs(a[p, j]))
        if largest < 1 / LARGEST:
            largest = 0.0
        peak = largest if largest > 0 else abs(a[p, columns - 1])  # that of the scale, if there is one
        if peak < 1 / LARGEST:
            peak = 0.0
        groups[i] = group
        scale[i] = power_above(peak)
        for j in range(columns):
            row_a[i, j] = a[p, j] / scale[i] if peak > 0 else 0.0
        cost[i, 0], cost[i, 1] = above[p], below[p]
        highest = 0.0
        for sign in range(2):
            if not (0 <= cost[i, sign] <= LARGEST or cost[i, sign] == inf):
                return COST
            # a row of zeros costs nothing, and no x violates it
            cost[i, sign] = cost[i, sign] * scale[i] if peak > 0 else 0.0
            if cost[i, sign] < inf:
                highest = max(highest, cost[i, sign])
        side[i] = 1.0 if cost[i, 0] <= cost[i, 1] else -1.0
        worst += highest * largest / scale[i]
    return worst


def power_above(peak: float) -> float:
    """The least power of two that is larger; 1 for zero."""
    power = 1.0
    while power <= peak:
        power *= 2
    while peak > 0 and power > 2 * peak:
        power /= 2
    return power


def rank(numbers: Indices, x: Array, rows: Rows, distance: Array) -> None:
    """How far from x the nearest point is where each of some rows may be on another side; updates their sides."""
    a, cost, norms, sides = rows.a, rows.cost, rows.norm, rows.side
    for p in range(len(numbers)):
        i = numbers[p]
        value = 0.0
        for j in range(len(x)):
            value += a[i, j] * x[j]
        side = sides[i] = side_of(value, sides[i])
        if side == 0 or cost[i, 0 if side > 0 else 1] == inf:
            distance[p] = 0.0  # active rows and hard rows on their hard side are never settled
        elif cost[i, 0] == 0 and cost[i, 1] == 0:
            distance[p] = inf  # rows without cost, removed ones among them, always are
        else:
            distance[p] = abs(value) / norms[i]


def add_gradients(numbers: Indices, rows: Rows, total: Array) -> None:
    """Add the gradients of these rows' costs on their sides, finite ones."""
    a, cost, side = rows.a, rows.cost, rows.side
    for p in range(len(numbers)):
        i = numbers[p]
        derivative = cost[i, 0] if side[i] > 0 else -cost[i, 1]
        if abs(derivative) != inf:
            for j in range(len(total)):
                total[j] += derivative * a[i, j]
