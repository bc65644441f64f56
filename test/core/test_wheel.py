"""What goes to an index of pushfric_core, installed where nothing else of pushfric is: README's example runs."""

import os
import pathlib
import re
import shutil
import subprocess
import sys
import zipfile

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]
SOURCE = ROOT / "src/pushfric_core"

WHERE = """
import importlib.util, pushfric_core
assert importlib.util.find_spec("pushfric_ros") is None
print(pushfric_core.__file__)
"""


def test_the_wheel_runs_the_readmes_example(tmp_path):
    def run(*command):
        bare = {name: os.environ[name] for name in ("PATH", "HOME", "LD_LIBRARY_PATH") if name in os.environ}
        own = {"PYTHONPATH": str(tmp_path / "site"), "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
        done = subprocess.run(
            [sys.executable, *map(str, command)], env=bare | own, cwd=tmp_path, capture_output=True, text=True, timeout=280
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    shutil.copytree(SOURCE, tmp_path / "source", ignore=shutil.ignore_patterns("__pycache__", "*.egg-info", "*.so", "build"))
    run("-m", "build", "--no-isolation", "--outdir", tmp_path, tmp_path / "source")  # the wheel from the source distribution
    (source,), (wheel,) = tmp_path.glob("pushfric_core-*.tar.gz"), tmp_path.glob("pushfric_core-*.whl")
    run("-m", "twine", "check", "--strict", source, wheel)
    with zipfile.ZipFile(wheel) as opened:
        names = opened.namelist()
    assert "pushfric_core/py.typed" in names
    assert any(re.fullmatch(r"pushfric_core/solvers/pivoting\..*\.so", name) for name in names)
    assert any(name.endswith("LICENSE") for name in names)
    run("-m", "pip", "install", "--no-deps", "--no-index", "--target", tmp_path / "site", wheel)
    assert run("-c", WHERE).strip() == str(tmp_path / "site/pushfric_core/__init__.py")

    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (example,) = [block for block in re.findall(r"```python\n(.*?)```", readme, re.DOTALL) if "pushfric_core" in block]
    center, *_ = run("-c", example).splitlines()
    x, y, radius = (float(number) for number in re.findall(r"-?\d+\.\d+", center))
    assert (x, y, radius) == pytest.approx((13.0, 3.0, 5.6), abs=0.5)
