"""What pushfric costs, beside its peers, in one run: `python bench`.

Importing it pins the libraries that numpy and the solvers call to one thread, which must come before numpy.
"""

import os

for _library in ("OPENBLAS", "OMP", "MKL", "NUMEXPR", "NUMBA", "RAYON"):
    os.environ[f"{_library}_NUM_THREADS"] = "1"
