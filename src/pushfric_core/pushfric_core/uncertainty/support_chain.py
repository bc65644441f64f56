"""A Markov chain over how an object may be supported: a pressure over an area and a few feet anywhere. Compiled.

Its state is a smooth pressure on the support points, feet with places and masses, a moment that depends on the side, and the
scales of all errors. Its stationary distribution is the posterior of docs/derivation.md. A foot may appear or vanish (Green,
"Reversible jump Markov chain Monte Carlo computation", Biometrika 1995); coefficients with a normal prior move on ellipses
(Murray, Adams, MacKay, "Elliptical slice sampling", AISTATS 2010); all else is Metropolis's rule.

A support of unit mass has a column of `ROWS` numbers for each observation: its moment about the contact if the turn is off by
some multiples of its error, `nodes`; how the moment changes with two more independent errors of the motion; and the variance of
what is unknown near the centre of rotation. All but the last are linear in the masses; that one is quadratic. In a push, the
object turns such that the sum of the moments is zero (eq. 4). It falls with the turn, so it has one root between the nodes: the
distance from the turn that was seen is the error of that.

`support_chain.pxd` declares the types of this module, and Cython compiles both when the package is built. As plain Python it
gives the same bits (see `solvers.pivoting`).
"""

import math

import numpy as np

from pushfric_core.geometry.planar import Array, Indices

NODES, MIDDLE = 9, 4
PIVOTED = NODES + 2
ROWS = NODES + 3
MOST_FEET = 12
FIELD, MASS, PLACE, SNAP, NUMBER, SPLIT, EXCHANGE, SIDES = 0.07, 0.22, 0.45, 0.53, 0.66, 0.77, 0.84, 0.87
"""Moves are drawn by these cumulative shares: of the pressure's shape, a mass, a foot's place, onto a support point or off it,
the number of feet, two feet for one, mass from one to another, the moment of the sides; the rest: of a scale of the errors."""

NEAR, APART = 0.03, 0.1
"""How far a foot moves off a support point, and how far apart the two feet are that are made of one: standard deviations along
each axis, as shares of the support's size."""

NOISE, MISFIT, PUSH, ROUGHNESS, PIVOT, SIDE = range(6)
"""The scales: of the camera's noise, of the moment's misfit in an observation and in a push, of the pressure's logarithm, of
the unknown force near the centre of rotation, and of the moment of the sides."""

LEAST_SLOPE = 1e-5
"""A standard deviation of the turn changes the moment by at least this share of the reach."""

DRAWS = 256
"""A step takes fewer random numbers than this."""

TAIL = 6.0
"""Degrees of freedom of the error of a push: a push may be unlike the others."""

LEAST_AREA, MOST_AREA = 1e-3, 1e2
"""The mass of the area lies between these; that of a foot is about 1."""

STILL = 1e-12
SHRINKS = 30
"""A slice shrinks at most so often."""


class Chain:
    """The data, the hypotheses, and the present state.

    Args:
        motions: (m, 3) displacements in the observations, object frame, about the middle of the support [m, m, rad].
        errors: (m, 3, 3) a unit of each of three independent errors moves them by its columns.
        contacts: (m, 2) [m], from the same middle.
        sides: (m, h) of the moments of the sides.
        pushes: (pushes + 1,) where each push begins.
        links: (m,) correlation of an observation's errors with those of the one before; 0 at the begin of a push.
        points: (n, 2) [m], from the middle.
        modes: (n, b) of the logarithm of the pressure.
        extent: area of the hull [m^2].
        hull: (edges, 3) a foot at p lies in the hull if hull[:, :2] p <= hull[:, 2]; none: feet are at points alone.
        nodes: (NODES,) multiples of the first error, ascending from a negative one to a positive one, 0 in the middle.
        reach: the force of a support nearer to the centre of rotation is unknown in part [m].
        priors: (6, 2) middle and standard deviation of the logarithm of each scale.
        numbers: (MOST_FEET + 1,) logarithm of the prior of each number of feet.
    """

    def __init__(
        self,
        motions: Array,
        errors: Array,
        contacts: Array,
        sides: Array,
        pushes: Indices,
        links: Array,
        points: Array,
        modes: Array,
        extent: float,
        hull: Array,
        nodes: Array,
        reach: float,
        priors: Array,
        numbers: Array,
    ) -> None:
        self.motions, self.errors, self.contacts, self.sides = motions, errors, contacts, sides
        self.pushes, self.links, self.points, self.modes, self.hull = pushes, links, points, modes, hull
        self.nodes, self.reach, self.priors, self.numbers = nodes, reach, priors, numbers
        self.extent = extent
        m, n = len(motions), len(points)
        self.low, self.high = points.min(axis=0), points.max(axis=0)
        self.size = max(float(np.ptp(points, axis=0).max()), 1e-6)
        self.columns = np.zeros((n, ROWS, m))
        for j in range(n):
            put_column(self, points[j, 0], points[j, 1], self.columns[j])
        self.feet, self.mass, self.at_point = np.zeros((MOST_FEET, 2)), np.zeros(MOST_FEET + 1), np.zeros(MOST_FEET, np.int64)
        self.foot_columns = np.zeros((MOST_FEET, ROWS, m))
        self.count = 0  # of feet
        self.field, self.new_field = np.zeros((2, modes.shape[1]))
        self.moments, self.new_moments = np.zeros((2, sides.shape[1]))
        self.scales = priors[:, 0].copy()
        self.pressure, self.new_pressure = np.zeros((2, n))
        self.area, self.new_area, self.total, self.trial = np.zeros((4, ROWS, m))
        self.column, self.place = np.zeros((ROWS, m)), np.zeros(2)
        self.draws, self.drawn = np.zeros(0), 0
        self.fit, self.warmth = 0.0, 1.0

    def start(self, area: float, feet: Array, masses: Array) -> None:
        """Begin with a uniform area of this mass, and with these feet (k, 2) at points, of masses (k,)."""
        self.count, self.mass[0] = len(feet), area
        for k in range(self.count):
            self.feet[k, 0], self.feet[k, 1] = feet[k, 0], feet[k, 1]
            self.mass[k + 1], self.at_point[k] = masses[k], 1
            put_column(self, feet[k, 0], feet[k, 1], self.foot_columns[k])
        self.field[:], self.moments[:] = 0.0, 0.0
        press(self, self.field, self.scales[ROUGHNESS], self.pressure, self.area)
        add_up(self, self.count, self.area, self.total)
        self.fit = log_likelihood(self, self.total, self.moments)

    def weights(self) -> tuple[Array, Array, Array]:
        """The share of each support point in the area's weight (n,), the feet (k, 2), and their weights (k,); sum 1."""
        masses = np.asarray(self.mass)[: self.count + 1]
        masses = masses / masses.sum()
        return np.asarray(self.pressure) * masses[0], np.asarray(self.feet)[: self.count].copy(), masses[1:]

    def misfit(self) -> float:
        """Variance of the moment that no support explains, in an observation and in a push [m^2]."""
        return math.exp(2 * self.scales[MISFIT]) + math.exp(2 * self.scales[PUSH])


def put_column(chain: Chain, x: float, y: float, column: Array) -> None:
    """The contribution of a foot of unit mass at (x, y) to each observation."""
    root = math.sqrt(3.0)  # far enough to see more than the tangent
    motions, errors, contacts, nodes = chain.motions, chain.errors, chain.contacts, chain.nodes
    for i in range(len(contacts)):
        arm_x, arm_y = x - contacts[i, 0], y - contacts[i, 1]
        velocity_x, velocity_y = motions[i, 0] - motions[i, 2] * y, motions[i, 1] + motions[i, 2] * x
        for a in range(3):
            error_x, error_y = errors[i, 0, a] - errors[i, 2, a] * y, errors[i, 1, a] + errors[i, 2, a] * x
            if a == 0:
                for node in range(NODES):
                    moved_x, moved_y = velocity_x + nodes[node] * error_x, velocity_y + nodes[node] * error_y
                    speed = math.sqrt(moved_x * moved_x + moved_y * moved_y)
                    column[node, i] = (arm_y * moved_x - arm_x * moved_y) / (speed + STILL)
            else:
                moved_x, moved_y = velocity_x + root * error_x, velocity_y + root * error_y
                above = (arm_y * moved_x - arm_x * moved_y) / (math.sqrt(moved_x * moved_x + moved_y * moved_y) + STILL)
                moved_x, moved_y = velocity_x - root * error_x, velocity_y - root * error_y
                below = (arm_y * moved_x - arm_x * moved_y) / (math.sqrt(moved_x * moved_x + moved_y * moved_y) + STILL)
                column[NODES + a - 1, i] = (above - below) / (2 * root)
        speed = math.sqrt(velocity_x * velocity_x + velocity_y * velocity_y)
        near = 1.0 - speed / (abs(motions[i, 2]) * chain.reach + STILL)
        column[PIVOTED, i] = near * near * (arm_x * arm_x + arm_y * arm_y) if near > 0 else 0.0


def log_likelihood(chain: Chain, rows: Array, moments: Array) -> float:
    """The logarithm of the likelihood, up to a constant, of the sums of all columns (ROWS, m)."""
    scales, links, sides, pushes, nodes = chain.scales, chain.links, chain.sides, chain.pushes, chain.nodes
    noise, misfit, shared = math.exp(2 * scales[NOISE]), math.exp(2 * scales[MISFIT]), math.exp(2 * scales[PUSH])
    pivot, side = math.exp(2 * scales[PIVOT]), math.exp(scales[SIDE])
    total = 0.0
    for p in range(len(pushes) - 1):
        squares, cross, ones = 0.0, 0.0, 0.0
        logs, ratio = 0.0, 1.0
        before, before_r, before_one = 1.0, 0.0, 0.0
        slope_before, first_before, second_before = 0.0, 0.0, 0.0
        for i in range(pushes[p], pushes[p + 1]):
            moment = 0.0
            for h in range(len(moments)):
                moment += side * sides[i, h] * moments[h]
            # the friction opposes the turn: its moment falls from node to node
            node = MIDDLE
            if rows[node, i] + moment > 0:
                while node < NODES - 2 and rows[node + 1, i] + moment > 0:
                    node += 1
            else:
                node -= 1
                while node > 0 and rows[node, i] + moment < 0:
                    node -= 1
            slope = (rows[node, i] - rows[node + 1, i]) / (nodes[node + 1] - nodes[node])
            slope = max(slope, LEAST_SLOPE * chain.reach)
            r = slope * nodes[node] + rows[node, i] + moment
            first, second = rows[NODES, i], rows[NODES + 1, i]
            variance = noise * (slope * slope + first * first + second * second) + misfit + pivot * rows[PIVOTED, i]
            one = 1.0
            ratio *= variance / (slope * slope)
            if links[i] != 0:
                linked = slope * slope_before + first * first_before + second * second_before
                linked *= noise * links[i]
                factor = linked / before
                ratio *= 1 - factor * linked / variance
                variance -= factor * linked
                r -= factor * before_r
                one -= factor * before_one
            squares += r * r / variance
            cross += r * one / variance
            ones += one * one / variance
            if not 1e-200 < ratio < 1e200:
                logs += math.log(ratio)
                ratio = 1.0
            before, before_r, before_one = variance, r, one
            slope_before, first_before, second_before = slope, first, second
        spread = 1 + shared * ones
        squares -= shared * cross * cross / spread
        logs += math.log(ratio) + math.log(spread)
        size = pushes[p + 1] - pushes[p]
        total -= 0.5 * logs + 0.5 * (TAIL + size) * math.log(1 + squares / (TAIL - 2))
    return total


def uniform(chain: Chain) -> float:
    """In (0, 1]."""
    chain.drawn += 1
    return 1.0 - float(chain.draws[chain.drawn - 1])


def normal(chain: Chain) -> float:
    """Of the standard normal distribution (Box and Muller)."""
    length = math.sqrt(-2 * math.log(uniform(chain)))
    return length * math.cos(2 * math.pi * uniform(chain))


def index(chain: Chain, size: int) -> int:
    """One of a number of things."""
    return min(int(uniform(chain) * size), size - 1)


def press(chain: Chain, field: Array, roughness: float, pressure: Array, rows: Array) -> None:
    """The pressure on the support points, sum 1, and what it adds in each observation."""
    modes, columns = chain.modes, chain.columns
    scale = math.exp(roughness)
    highest = -1e300
    for j in range(len(pressure)):
        value = 0.0
        for b in range(len(field)):
            value += modes[j, b] * field[b]
        pressure[j] = scale * value
        highest = max(highest, pressure[j])
    total = 0.0
    for j in range(len(pressure)):
        pressure[j] = math.exp(pressure[j] - highest)
        total += pressure[j]
    for row in range(rows.shape[0]):
        for i in range(rows.shape[1]):
            rows[row, i] = 0.0
    for j in range(len(pressure)):
        share = pressure[j] / total
        pressure[j] = share
        for row in range(PIVOTED):
            for i in range(rows.shape[1]):
                rows[row, i] += share * columns[j, row, i]
        for i in range(rows.shape[1]):
            rows[PIVOTED, i] += share * share * columns[j, PIVOTED, i]


def add_up(chain: Chain, count: int, area: Array, out: Array) -> None:
    """The sums over the area and the first feet of their columns, by their shares of the mass."""
    columns, mass = chain.foot_columns, chain.mass
    total = 0.0
    for k in range(count + 1):
        total += mass[k]
    share = mass[0] / total
    for row in range(PIVOTED):
        for i in range(out.shape[1]):
            out[row, i] = share * area[row, i]
    for i in range(out.shape[1]):
        out[PIVOTED, i] = share * share * area[PIVOTED, i]
    for k in range(count):
        share = mass[k + 1] / total
        for row in range(PIVOTED):
            for i in range(out.shape[1]):
                out[row, i] += share * columns[k, row, i]
        for i in range(out.shape[1]):
            out[PIVOTED, i] += share * share * columns[k, PIVOTED, i]


def assign(source: Array, target: Array) -> None:
    for row in range(source.shape[0]):
        for i in range(source.shape[1]):
            target[row, i] = source[row, i]


def accept(chain: Chain, prior: float) -> bool:
    """Metropolis's rule for the trial sums; the logarithm of the ratio of the priors, and of the proposals, is given."""
    fit = log_likelihood(chain, chain.trial, chain.moments)
    if not math.log(uniform(chain)) < chain.warmth * (fit - chain.fit) + prior:
        return False
    chain.fit = fit
    assign(chain.trial, chain.total)
    return True


def choose_place(chain: Chain) -> int:
    """Draw a place from the prior: a support point, or anywhere in the hull; whether it is a point."""
    place, points = chain.place, chain.points
    if len(chain.hull) == 0 or uniform(chain) < 0.5:
        j = index(chain, len(points))
        place[0], place[1] = points[j, 0], points[j, 1]
        return 1
    for _ in range(SHRINKS):
        place[0] = chain.low[0] + (chain.high[0] - chain.low[0]) * uniform(chain)
        place[1] = chain.low[1] + (chain.high[1] - chain.low[1]) * uniform(chain)
        if in_hull(chain):
            return 0
    return -1


def in_hull(chain: Chain) -> bool:
    hull, place, inside = chain.hull, chain.place, True
    for edge in range(len(hull)):
        if hull[edge, 0] * place[0] + hull[edge, 1] * place[1] > hull[edge, 2]:
            inside = False
    return inside


def total_mass(chain: Chain) -> float:
    total = 0.0
    for k in range(chain.count + 1):
        total += chain.mass[k]
    return total


def move_field(chain: Chain) -> None:
    """Another shape of the pressure."""
    if chain.mass[0] >= 1e-4 * total_mass(chain):
        move_on_ellipse(chain, chain.field, chain.new_field, True)


def move_on_ellipse(chain: Chain, values: Array, others: Array, pressing: bool) -> None:
    """Other coefficients, on an ellipse through the present ones: of the pressure, or the moments of the sides.

    Args:
        chain: whose state changes.
        values: (b,) the coefficients, with a standard normal prior.
        others: (b,) room for the end of the ellipse's other axis.
        pressing: whether they are those of the pressure.
    """
    for b in range(len(values)):
        others[b] = normal(chain)
    rows = chain.trial if pressing else chain.total
    level = chain.warmth * chain.fit + math.log(uniform(chain))
    angle = 2 * math.pi * uniform(chain)
    lowest, highest = angle - 2 * math.pi, angle
    for _ in range(SHRINKS):
        turn(values, others, math.cos(angle), math.sin(angle))
        if pressing:
            press(chain, values, chain.scales[ROUGHNESS], chain.new_pressure, chain.new_area)
            add_up(chain, chain.count, chain.new_area, rows)
        fit = log_likelihood(chain, rows, chain.moments)
        if chain.warmth * fit > level:
            chain.fit = fit
            if pressing:
                assign(rows, chain.total)
                keep_pressure(chain)
            return
        turn(values, others, math.cos(angle), -math.sin(angle))
        if angle < 0:
            lowest = angle
        else:
            highest = angle
        angle = lowest + (highest - lowest) * uniform(chain)


def turn(values: Array, others: Array, cosine: float, sine: float) -> None:
    """Go along the ellipse of which these (b,) are the axes, by an angle; the opposite angle leads back."""
    for b in range(len(values)):
        old, other = values[b], others[b]
        values[b], others[b] = old * cosine + other * sine, other * cosine - old * sine


def keep_pressure(chain: Chain) -> None:
    """The trial pressure becomes the present one."""
    assign(chain.new_area, chain.area)
    for j in range(len(chain.pressure)):
        chain.pressure[j] = chain.new_pressure[j]


def move_mass(chain: Chain) -> None:
    """More or less mass of the area, whose logarithm is even, or of a foot, whose prior is exponential."""
    if chain.count == 0:
        return
    k = index(chain, chain.count + 1)
    wide = 0.3 if uniform(chain) < 0.6 else 1.2
    change, old = wide * normal(chain), chain.mass[k]
    new = old * math.exp(change)
    if k == 0 and not LEAST_AREA < new < MOST_AREA:
        return
    chain.mass[k] = new
    add_up(chain, chain.count, chain.area, chain.trial)
    if not accept(chain, 0.0 if k == 0 else change - (new - old)):
        chain.mass[k] = old


def exchange_mass(chain: Chain) -> None:
    """Mass from a foot to another, or to the area."""
    if chain.count == 0:
        return
    k, j = index(chain, chain.count) + 1, index(chain, chain.count + 1)
    if j == k:
        return
    old_k, old_j = chain.mass[k], chain.mass[j]
    if j == 0:
        change = 0.3 * normal(chain)
        new_k = old_k * math.exp(change)
        new_j = old_k + old_j - new_k
        if not LEAST_AREA < new_j < MOST_AREA:
            return
        prior = change - (new_k - old_k) + math.log(old_j / new_j)
    else:
        new_k = (old_k + old_j) * uniform(chain)
        new_j, prior = old_k + old_j - new_k, 0.0
        if new_j <= 0:
            return
    chain.mass[k], chain.mass[j] = new_k, new_j
    add_up(chain, chain.count, chain.area, chain.trial)
    if not accept(chain, prior):
        chain.mass[k], chain.mass[j] = old_k, old_j


def move_foot(chain: Chain) -> None:
    """A foot to another place: from the prior, to another support point, or a little aside."""
    if chain.count == 0:
        return
    k = index(chain, chain.count)
    feet, place = chain.feet, chain.place
    at_point = chain.at_point[k]
    if uniform(chain) < 0.15:
        at_point = choose_place(chain)
        if at_point < 0:
            return
    elif at_point == 1:
        j = index(chain, len(chain.points))
        place[0], place[1] = chain.points[j, 0], chain.points[j, 1]
        aside = math.sqrt((place[0] - feet[k, 0]) ** 2 + (place[1] - feet[k, 1]) ** 2)
        if aside > 0.3 * chain.size:
            return
    else:
        which = uniform(chain)
        wide = chain.size * (0.01 if which < 0.5 else 0.04 if which < 0.8 else 0.15)
        place[0] = feet[k, 0] + wide * normal(chain)
        place[1] = feet[k, 1] + wide * normal(chain)
        if not in_hull(chain):
            return
    move_to(chain, k, at_point, 0.0)


def move_to(chain: Chain, k: int, at_point: int, prior: float) -> None:
    """A foot to the trial place, by Metropolis's rule."""
    feet, place = chain.feet, chain.place
    put_column(chain, place[0], place[1], chain.column)
    share = chain.mass[k + 1] / total_mass(chain)
    columns, column, total, trial = chain.foot_columns, chain.column, chain.total, chain.trial
    for row in range(PIVOTED):
        for i in range(trial.shape[1]):
            trial[row, i] = total[row, i] + share * (column[row, i] - columns[k, row, i])
    for i in range(trial.shape[1]):
        trial[PIVOTED, i] = max(total[PIVOTED, i] + share * share * (column[PIVOTED, i] - columns[k, PIVOTED, i]), 0.0)
    if accept(chain, prior):
        assign(column, columns[k])
        feet[k, 0], feet[k, 1], chain.at_point[k] = place[0], place[1], at_point
        add_up(chain, chain.count, chain.area, total)  # so that rounding does not add up


def add_or_remove(chain: Chain) -> None:
    """One foot more, drawn from the prior, or one less."""
    count = chain.count
    if uniform(chain) < 0.5:
        if count == len(chain.feet):
            return
        at_point = choose_place(chain)
        if at_point < 0:
            return
        put_column(chain, chain.place[0], chain.place[1], chain.foot_columns[count])
        chain.mass[count + 1] = -math.log(uniform(chain)) + STILL
        add_up(chain, count + 1, chain.area, chain.trial)
        if accept(chain, chain.numbers[count + 1] - chain.numbers[count]):
            chain.feet[count, 0], chain.feet[count, 1], chain.at_point[count] = chain.place[0], chain.place[1], at_point
            chain.count = count + 1
        return
    if count == 0:
        return
    k = index(chain, count)
    swap_last(chain, k)
    add_up(chain, count - 1, chain.area, chain.trial)
    if accept(chain, chain.numbers[count - 1] - chain.numbers[count]):
        chain.count = count - 1


def swap_last(chain: Chain, k: int) -> None:
    """Exchange the number of a foot with that of the last one."""
    last = chain.count - 1
    if k == last:
        return
    feet, mass, columns = chain.feet, chain.mass, chain.foot_columns
    for a in range(2):
        feet[k, a], feet[last, a] = feet[last, a], feet[k, a]
    chain.at_point[k], chain.at_point[last] = chain.at_point[last], chain.at_point[k]
    mass[k + 1], mass[last + 1] = mass[last + 1], mass[k + 1]
    assign(columns[k], chain.column)
    assign(columns[last], columns[k])
    assign(chain.column, columns[last])


def log_density(x: float, y: float, deviation: float) -> float:
    """Of a normal distribution in the plane."""
    return -(x * x + y * y) / (2 * deviation * deviation) - math.log(2 * math.pi * deviation * deviation)


def nearest(chain: Chain, x: float, y: float) -> int:
    """The support point nearest to a place."""
    points, best, least = chain.points, 0, 1e300
    for j in range(len(points)):
        apart = (points[j, 0] - x) ** 2 + (points[j, 1] - y) ** 2
        if apart < least:
            best, least = j, apart
    return best


def snap(chain: Chain) -> None:
    """A foot onto the nearest support point, or off its point."""
    if chain.count == 0 or len(chain.hull) == 0:
        return
    k = index(chain, chain.count)
    feet, place, points = chain.feet, chain.place, chain.points
    wide = NEAR * chain.size
    if chain.at_point[k]:
        place[0], place[1] = feet[k, 0] + wide * normal(chain), feet[k, 1] + wide * normal(chain)
        j = nearest(chain, place[0], place[1])
        if points[j, 0] != feet[k, 0] or points[j, 1] != feet[k, 1] or not in_hull(chain):
            return
        density = log_density(place[0] - feet[k, 0], place[1] - feet[k, 1], wide)
        move_to(chain, k, 0, math.log(len(points) / chain.extent) - density)
    else:
        j = nearest(chain, feet[k, 0], feet[k, 1])
        place[0], place[1] = points[j, 0], points[j, 1]
        density = log_density(place[0] - feet[k, 0], place[1] - feet[k, 1], wide)
        move_to(chain, k, 1, density - math.log(len(points) / chain.extent))


def split_or_merge(chain: Chain) -> None:
    """Two feet for one, neither at a support point, with the same mass and the same centre; or one for two."""
    count, feet, mass, place = chain.count, chain.feet, chain.mass, chain.place
    if count == 0 or len(chain.hull) == 0:
        return
    k, wide = index(chain, count), APART * chain.size
    if uniform(chain) < 0.5:
        if count == len(feet) or chain.at_point[k]:
            return
        x, y, whole = feet[k, 0], feet[k, 1], mass[k + 1]
        aside_x, aside_y, part = wide * normal(chain), wide * normal(chain), uniform(chain)
        place[0], place[1] = x - part * aside_x, y - part * aside_y
        if not in_hull(chain):
            return
        put_column(chain, place[0], place[1], chain.foot_columns[count])
        feet[count, 0], feet[count, 1], chain.at_point[count] = place[0], place[1], 0
        place[0], place[1] = x + (1 - part) * aside_x, y + (1 - part) * aside_y
        if not in_hull(chain):
            return
        assign(chain.foot_columns[k], chain.column)
        put_column(chain, place[0], place[1], chain.foot_columns[k])
        mass[k + 1], mass[count + 1] = part * whole, (1 - part) * whole
        add_up(chain, count + 1, chain.area, chain.trial)
        prior = chain.numbers[count + 1] - chain.numbers[count] + math.log(whole / (2 * chain.extent))
        if accept(chain, prior - log_density(aside_x, aside_y, wide)):
            feet[k, 0], feet[k, 1] = place[0], place[1]
            chain.count = count + 1
        else:
            mass[k + 1] = whole
            assign(chain.column, chain.foot_columns[k])
        return
    if count == 1:
        return
    swap_last(chain, k)
    last, k = count - 1, index(chain, count - 1)
    if chain.at_point[k] or chain.at_point[last]:
        return
    one, other = mass[k + 1], mass[last + 1]
    whole = one + other
    aside_x, aside_y = feet[k, 0] - feet[last, 0], feet[k, 1] - feet[last, 1]
    place[0] = (one * feet[k, 0] + other * feet[last, 0]) / whole
    place[1] = (one * feet[k, 1] + other * feet[last, 1]) / whole
    assign(chain.foot_columns[k], chain.column)
    put_column(chain, place[0], place[1], chain.foot_columns[k])
    mass[k + 1] = whole
    add_up(chain, count - 1, chain.area, chain.trial)
    prior = chain.numbers[count - 1] - chain.numbers[count] - math.log(whole / (2 * chain.extent))
    if accept(chain, prior + log_density(aside_x, aside_y, wide)):
        feet[k, 0], feet[k, 1] = place[0], place[1]
        chain.count = count - 1
    else:
        mass[k + 1] = one
        assign(chain.column, chain.foot_columns[k])


def move_scale(chain: Chain) -> None:
    """Another scale of the errors, or of the pressure's logarithm."""
    scale = index(chain, 6)
    middle, deviation = chain.priors[scale, 0], chain.priors[scale, 1]
    old = chain.scales[scale]
    new = old + (0.2 + 0.3 * uniform(chain)) * normal(chain)
    prior = ((old - middle) ** 2 - (new - middle) ** 2) / (2 * deviation * deviation)
    chain.scales[scale] = new
    if scale == ROUGHNESS:
        press(chain, chain.field, new, chain.new_pressure, chain.new_area)
        add_up(chain, chain.count, chain.new_area, chain.trial)
    else:
        assign(chain.total, chain.trial)
    if not accept(chain, prior):
        chain.scales[scale] = old
    elif scale == ROUGHNESS:
        keep_pressure(chain)


def walk(chain: Chain, steps: int, warmth: float, draws: Array) -> int:
    """Take steps while random numbers last; the number taken.

    Args:
        chain: whose state changes.
        steps: at most.
        warmth: power of the likelihood: 1 for the posterior, less on the way to it.
        draws: (d,) even in [0, 1).
    """
    chain.draws, chain.drawn, chain.warmth = draws, 0, warmth
    for step in range(steps):
        if chain.drawn + DRAWS > len(draws):
            return step
        which = uniform(chain)
        if which < FIELD:
            move_field(chain)
        elif which < MASS:
            move_mass(chain)
        elif which < PLACE:
            move_foot(chain)
        elif which < SNAP:
            snap(chain)
        elif which < NUMBER:
            add_or_remove(chain)
        elif which < SPLIT:
            split_or_merge(chain)
        elif which < EXCHANGE:
            exchange_mass(chain)
        elif which < SIDES:
            move_on_ellipse(chain, chain.moments, chain.new_moments, False)
        else:
            move_scale(chain)
    return steps
