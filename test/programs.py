"""Programs for the tests of solvers, and their optimum by HiGHS."""

import numpy as np
from scipy.optimize import linprog

from pushfric_core.geometry.planar import cross, left_of
from pushfric_core.program.constraints import ConstraintRows


def highs(rows, n=None, direction=None, limit=None):
    """Optimal F, or None if the hard rows contradict each other; or the least direction . w for which F is within its limit."""
    m, columns = rows.a.shape
    n = n or columns
    sides = np.concatenate((rows.above, rows.below))
    cost = np.concatenate((np.zeros(columns), np.where(np.isinf(sides), 0.0, sides)))
    weights = np.arange(columns + 2 * m) < n
    for tolerance in (1e-10, 1e-7):  # with very unequal costs, HiGHS sometimes gives up at the first
        result = linprog(
            cost if direction is None else np.concatenate((direction, np.zeros(columns - n + 2 * m))),
            A_eq=np.vstack((np.hstack((rows.a, -np.eye(m), np.eye(m))), weights)),
            b_eq=np.append(np.zeros(m), 1.0),
            A_ub=None if direction is None else cost[None],
            b_ub=None if direction is None else [limit],
            bounds=[(0, 1)] * n + [(0, None)] * (columns - n) + [(0, 0 if np.isinf(side) else None) for side in sides],
            method="highs",
            options={"primal_feasibility_tolerance": tolerance, "dual_feasibility_tolerance": tolerance},
        )
        if result.status in (0, 2):
            break
    assert result.status in (0, 2), result.message
    return result.fun if result.status == 0 else None


def group(a, above=1.0, below=1.0):
    a = np.atleast_2d(np.asarray(a, dtype=float))
    return ConstraintRows(a, np.broadcast_to(above, len(a)).astype(float), np.broadcast_to(below, len(a)).astype(float))


def filled(program, *groups):
    """The program, with these groups of rows."""
    for rows in groups:
        program.add(rows)
    return program


def solved_with(program, rows):
    """The optimum of a program after these rows were added."""
    program.add(rows)
    return program.solve()


def pushes(rng, n, count, noise=1e-3, half_width=0.0, bearing=3):
    """Observations of an object 0.1 m wide on some of n supports: moment rows and the hard row f.n >= 0 of each; and w."""
    points = rng.uniform(-0.05, 0.05, (n, 2))
    w = np.zeros(n)
    bearing = min(n, bearing)
    w[rng.choice(n, bearing, replace=False)] = rng.dirichlet(np.ones(bearing))
    groups = []
    while len(groups) < count:
        velocities = rng.choice((-1, 1)) * left_of(points - rng.uniform(-0.15, 0.15, 2))
        directions = -velocities / np.hypot(*velocities.T)[:, None]
        force, moment = w @ directions, w @ cross(points, directions)
        if np.hypot(*force) < 0.1:
            continue
        contact = left_of(force) * -moment / (force @ force) + noise * rng.normal(size=2)
        tilt = rng.uniform(-1.4, 1.4)
        normal = (force * np.cos(tilt) + left_of(force) * np.sin(tilt)) / np.hypot(*force)
        low, high = (cross(points - contact - side * half_width * left_of(normal), directions) for side in (-1, 1))
        if half_width:
            groups.append(group([low, high, directions @ normal], (1, 0, 0), (0, 1, np.inf)))
        else:
            groups.append(group([low, directions @ normal], (1, 0), (1, np.inf)))
    return groups, w


def solved_while_rows_come_and_go(program, rng, rows):
    """Add groups of rows to a program and solve it after each, while some are removed again; return those that are left."""
    present = {}
    for number, group in enumerate(np.array_split(np.arange(len(rows.above)), 1 + len(rows.above) // 4)):
        present[number] = ConstraintRows(*(part[group] for part in rows))
        solved_with(program, present[number])
        if len(present) > 2 and rng.random() < 0.3:
            gone = int(rng.choice(list(present)))
            program.remove(gone)
            del present[gone]
    return list(present.values())
