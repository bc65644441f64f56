"""What pushfric costs compared with its peers, measured in one run: `python bench`.

Importing this package pins the libraries that numpy and the solvers call to one thread, so it must come before numpy.
"""

import os

for _library in ("OPENBLAS", "OMP", "MKL", "NUMEXPR", "NUMBA", "RAYON"):
    os.environ[f"{_library}_NUM_THREADS"] = "1"
