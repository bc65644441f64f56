"""What `import pushfric_core` offers, and what it needs for that."""

import importlib
import subprocess
import sys

import pushfric_core


def test_every_public_name_is_where_type_checkers_are_told():
    assert set(pushfric_core.__all__) <= set(dir(pushfric_core))
    for name, module in pushfric_core._HOMES.items():
        assert getattr(pushfric_core, name) is getattr(importlib.import_module(module), name)


def test_importing_the_package_loads_nothing_heavy():
    code = "import sys, pushfric_core; print(*{'numpy', 'scipy', 'shapely', 'osqp'} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "\n"
