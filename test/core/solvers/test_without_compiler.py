"""The solver where nothing could be compiled: the same bits, and a warning."""

import pathlib
import subprocess
import sys

import pytest

from pushfric_core.solvers import pivoting

SOURCE = pathlib.Path(pivoting.__file__).with_name("pivoting.py")

AS_PYTHON = f"""
import importlib.util, sys
spec = importlib.util.spec_from_file_location("pushfric_core.solvers.pivoting", {str(SOURCE)!r})
sys.modules[spec.name] = module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)
"""

PROGRAM = """
import copy, pickle
import numpy as np
from pushfric_core.program.constraint_rows import ConstraintRows
from pushfric_core.solvers.simplex import Simplex

rng = np.random.default_rng(5)
for with_scale in (False, True):
    n, true = 7, rng.dirichlet(np.ones(7))
    simplex = Simplex(n, with_scale)
    for k in range(160):
        a = rng.normal(size=(2, n + with_scale)) * 10.0 ** rng.integers(-3, 3)
        a[:, :n] -= (a[:, :n] @ true)[:, None] * (1 + 0.05 * rng.normal(size=(2, 1)))
        simplex.add(ConstraintRows(a, np.array([1.0, np.inf if k % 20 == 0 else 1.0]), np.ones(2)))
        if k % 50 == 30:
            simplex.remove(k - 3)
            simplex = [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))][with_scale](simplex)
            extremes = simplex.extremes(rng.normal(size=(3, n)), 0.1)
            print(None if extremes is None else extremes.tobytes().hex())
        optimum = simplex.solve()
        print(optimum.w.tobytes().hex(), optimum.objective.hex(), optimum.status, simplex.unique())
    print(simplex.multipliers().tobytes().hex(), simplex.conflicts())
"""


def run(program):
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=250, check=True)
    return done.stdout, done.stderr


@pytest.mark.skipif(pivoting.__file__ == str(SOURCE), reason="nothing is compiled here")
def test_python_gives_the_bits_of_the_compiled_solver():
    compiled, nothing = run(PROGRAM)
    interpreted, warning = run(AS_PYTHON + PROGRAM)
    assert compiled.count("OPTIMAL") + compiled.count("optimal") > 200
    assert (interpreted, nothing) == (compiled, "")
    assert warning == (
        "the solver is not compiled, and a hundred times slower: install a C compiler and Cython 3, then pushfric_core again\n"
    )
