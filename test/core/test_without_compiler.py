"""What is compiled, where nothing could be compiled: the same bits, and a warning."""

import importlib
import pathlib
import re
import subprocess
import sys

import pytest

PACKAGE = "pushfric_core"
PIVOTING, MOTIONS, BELIEFS, SLIDES = (
    f"{PACKAGE}.{name}" for name in ("solvers.pivoting", "mechanics.least_dissipation", "belief.inner_loops", "program.sliding")
)

AS_PYTHON = """
import importlib.util, sys
spec = importlib.util.spec_from_file_location({name!r}, {source!r})
sys.modules[spec.name] = module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)
"""

SOLVING = """
import copy, pickle
import numpy as np
from pushfric_core.program.constraints import ConstraintRows
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
        optimum = simplex.solve()
        print(optimum.w.tobytes().hex(), optimum.objective.hex(), optimum.status, simplex.unique())
    print(simplex.multipliers().tobytes().hex(), simplex.conflicts())
"""


MOVING = """
import numpy as np
from pushfric_core import TABLE_1, FrictionModel, motion_cone, predict

rng = np.random.default_rng(7)
for name, known in TABLE_1.items():
    points = known.outline.grid(7, 5, known.inset)
    corner = known.outline.vertices[:1] * 0.9  # a lone support, which may be at the contact
    w = np.vstack((np.eye(len(points) + 1)[-1:], rng.dirichlet(np.full(len(points) + 1, 0.1), 3)))
    model = FrictionModel(np.vstack((points, corner)), w / w.sum(axis=1, keepdims=True), rng.uniform(0, 1, 4), np.full(4, 0.25))
    edges = rng.integers(len(known.outline.edges), size=40)
    contacts = known.outline.vertices[edges] + rng.uniform(0, 1, (40, 1)) * known.outline.edges[edges]
    contacts[0] = corner
    normals = known.outline.normals[edges]
    found = predict(model, contacts, normals, rng.normal(size=(40, 2)) - normals)
    print(*(array.tobytes().hex() for array in found.samples), *np.unique(found.samples.modes))
    print(*(array.tobytes().hex() for array in motion_cone(model, contacts, normals)))
"""

BELIEVING = """
import numpy as np
from pushfric_core import TABLE_1, FrictionModel, Observation, Twist, believe, predict

known = TABLE_1["wood_rect3"]
rng = np.random.default_rng(11)
edges = rng.integers(4, size=8)
contacts = known.outline.vertices[edges] + rng.uniform(0.2, 0.8, (8, 1)) * known.outline.edges[edges]
normals = known.outline.normals[edges]
tips = 0.005 * (0.4 * rng.normal(size=(8, 2)) - normals)
twists = predict(FrictionModel.of(known.support, known.mu_c), contacts, normals, tips).twists
rows = np.hstack((contacts, normals, tips, twists)).tolist()
for seen in (False, True):
    data = [
        Observation((cx, cy), (nx, ny), Twist(*twist), push, tip_velocity=(vx, vy) if seen else None)
        for push, (cx, cy, nx, ny, vx, vy, *twist) in enumerate(rows)
    ]
    model = believe(known.outline.grid(5, 3, known.inset), data)
    print("believed", *(one.tobytes().hex() for one in (model.w, model.mu_c, model.covariance)))
"""

SLIDING = """
import numpy as np
from pushfric_core.program.contact_friction import Tip
print("slides", Tip(*np.random.default_rng(3).normal(0, 0.1, (3, 60)), np.arange(60) // 5).directions.tobytes().hex())
"""

CASES = [
    (PIVOTING, SOLVING, "the solver is", "(?i)optimal", 201),
    (MOTIONS, MOVING, "predictions are", " 0 1 2\n", 6),  # all modes, for each object
    (BELIEFS, BELIEVING, "beliefs are", "believed", 2),  # of contacts and of tips
    (SLIDES, SLIDING, "slips are", "slides", 1),
]


def run(program):
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=250, check=True)
    return done.stdout, done.stderr


@pytest.mark.parametrize(("name", "program", "what", "printed", "least"), CASES)
def test_python_gives_the_bits_of_what_is_compiled(name, program, what, printed, least):
    installed = pathlib.Path(importlib.import_module(name).__file__)
    source = installed.with_name(f"{name.rpartition('.')[2]}.py")
    if installed == source:
        pytest.skip("nothing is compiled here")
    compiled, nothing = run(program)
    interpreted, warning = run(AS_PYTHON.format(name=name, source=str(source)) + program)
    assert len(re.findall(printed, compiled)) >= least
    assert (interpreted, nothing) == (compiled, "")
    assert warning == (
        f"{what} not compiled, and a hundred times slower: install a C compiler and Cython 3, then pushfric_core again\n"
    )
