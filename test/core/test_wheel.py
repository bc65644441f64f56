"""What goes to an index of pushfric_core, installed where nothing else of pushfric is: README's example, and each extra."""

import os
import pathlib
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from typing import NamedTuple

import pytest
from missing import extras
from problems import four_feet, save_observations

ROOT = pathlib.Path(__file__).resolve().parents[2]
SOURCE, MESSAGES = ROOT / "src/pushfric_core", ROOT / "src/pushfric_msgs/msg"
UV = shutil.which("uv") or shutil.which("uv", path=pathlib.Path(sys.executable).parent)

BARE = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL_ENV", "AMENT", "ROS"))}


def run(folder, *command, **settings):
    given = {"cwd": folder, "env": BARE | settings, "capture_output": True, "text": True, "timeout": 280, "check": False}
    return subprocess.run([*map(str, command)], **given)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A folder with the source distribution, and the wheel that is made from it."""
    folder = tmp_path_factory.mktemp("built")
    left = shutil.ignore_patterns("__pycache__", "*.egg-info", "*.so", "build")
    shutil.copytree(SOURCE, folder / "src/pushfric_core", symlinks=True, ignore=left)
    shutil.copytree(MESSAGES, folder / "src/pushfric_msgs/msg")
    done = run(folder, sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, folder / "src/pushfric_core")
    assert done.returncode == 0, done.stderr
    return folder


WHERE = """
import importlib.util, pushfric_core
assert importlib.util.find_spec("pushfric_ros") is None
print(pushfric_core.__file__)
"""


def test_the_wheel_runs_the_readmes_example(built, tmp_path):
    def python(*arguments):
        own = {"PYTHONPATH": str(tmp_path / "site"), "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
        done = run(tmp_path, sys.executable, *arguments, **own)
        assert done.returncode == 0, done.stderr
        return done.stdout

    (source,), (wheel,) = built.glob("pushfric_core-*.tar.gz"), built.glob("pushfric_core-*.whl")
    python("-m", "twine", "check", "--strict", source, wheel)
    with zipfile.ZipFile(wheel) as opened:
        names = opened.namelist()
    assert "pushfric_core/py.typed" in names
    compiled = {name.partition(".")[0] for name in names if name.endswith(".so")}
    assert compiled == {name.partition(".")[0] for name in names if name.endswith(".pxd")} | {"pushfric_core/_cyutility"}
    assert compiled
    assert any(name.endswith("LICENSE") for name in names)
    definitions = {path.name for path in MESSAGES.glob("*.msg")}
    assert {pathlib.PurePath(name).name for name in names if name.startswith("pushfric_core/bags/msg/")} == definitions
    python("-m", "pip", "install", "--no-deps", "--no-index", "--target", tmp_path / "site", wheel)
    assert python("-c", WHERE).strip() == str(tmp_path / "site/pushfric_core/__init__.py")

    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (example,) = [block for block in re.findall(r"```python\n(.*?)```", readme, re.DOTALL) if "pushfric_core" in block]
    center, *_ = python("-c", example).splitlines()
    x, y, radius, *by_program = (float(number) for number in re.findall(r"-?\d+\.\d+", center))
    assert by_program == pytest.approx((13.0, 3.0), abs=0.5)
    assert (x, y) == pytest.approx((13.0, 3.0), abs=2.0)
    assert 2.0 < radius < 20.0


ESTIMATE = ("estimate", "pushes.csv", "--object", "square.yaml")

TRACK = """
import numpy as np
from pushfric_core import TABLE_1, Pose
from pushfric_core.vision.camera import Camera
from pushfric_core.vision.contour_tracker import ContourTracker
from pushfric_core.simulated.camera import SimulatedCamera
outline, camera = TABLE_1["rubber_rect4"].outline.vertices, Camera.looking_down(640, 480, (0.0, 0.0), 5e-4)
image = SimulatedCamera(camera, outline, 0.0, np.random.default_rng(0)).render(Pose(0.01, 0.02, 0.3))
print(ContourTracker(camera, outline, 0.0).track(image).pose)
"""

SERIAL = """
import os, pty
from pushfric_core.pushers.serial_line import open_port, write_all
controller, line = pty.openpty()
port = open_port(os.ttyname(line), 115200)
write_all(port, b"?")
print(os.read(controller, 1))
"""

FRAME = "from pushfric_core import load; print(load('pushes.csv', object='square.yaml').to_frame())"

CLUSTER = """
import sys
from distributed import LocalCluster
from pushfric_core.__main__ import main
if __name__ == "__main__":
    cluster = LocalCluster(1, threads_per_worker=1, dashboard_address=None)
    sys.argv = ["pushfric", *sys.argv[1:], "--dask", cluster.scheduler_address]
    main()
"""


class Use(NamedTuple):
    """What an extra is for: arguments of the command line, or of Python, and what is printed when it is installed."""

    arguments: tuple[object, ...]
    printed: str
    with_extra: tuple[object, ...] = ()  # if the call needs more than the package, such as a cluster

    def command(self, environment, installed):
        arguments = (installed and self.with_extra) or self.arguments
        program = "python" if arguments[0] in ("-c", "cluster.py") else "pushfric"
        return environment / "bin" / program, *arguments


USES: dict[str, Use] = {
    "bags": Use(("estimate", ROOT / "bags/rubber_rect4"), "of 14 pushes"),
    "vision": Use(("-c", TRACK), "Pose(x=0.0"),
    "serial": Use(("-c", SERIAL), "b'?'"),
    "plot": Use((*ESTIMATE, "--figure", "figure.png"), "of 6 pushes"),
    "pandas": Use(("-c", FRAME), "contact_x"),
    "osqp": Use((*ESTIMATE, "--solver", "osqp"), "of 6 pushes"),
    "dask": Use(
        (*ESTIMATE, "--out", "dask", "--dask", "tcp://127.0.0.1:1"),
        "usable: 1",
        ("cluster.py", *ESTIMATE, "--out", "dask"),
    ),
}


@pytest.fixture(scope="module")
def install(built) -> Callable[[str], pathlib.Path]:
    """Installs the wheel with an extra into an environment, which has nothing else."""
    if UV is None:
        pytest.skip("no uv, which makes the environment in seconds: pip install uv")
    (wheel,) = built.glob("pushfric_core-*.whl")
    environment = built / "environment"
    assert run(built, UV, "venv", "--python", sys.executable, environment).returncode == 0

    def installed(extra):
        what = f"{wheel}[{extra}]" if extra else wheel
        pins = ("--constraint", ROOT / "requirements-libraries.txt")
        done = run(built, UV, "pip", "install", "--python", environment / "bin/python", *pins, what)
        if "Failed to fetch" in done.stderr:
            pytest.skip(f"no index of packages answers: {done.stderr.splitlines()[-1]}")
        assert done.returncode == 0, done.stderr
        return environment

    return installed


@pytest.fixture
def folder(tmp_path):
    """A folder with a CSV, the object that was pushed, and a cluster."""
    problem = four_feet()
    save_observations(tmp_path / "pushes.csv", problem.observations[:6])
    (tmp_path / "square.yaml").write_text(f"name: square\noutline: {problem.outline.vertices.tolist()}\n")
    (tmp_path / "cluster.py").write_text(CLUSTER)
    return tmp_path


def test_every_extra_is_used():
    assert {name for name in extras("pushfric_core")[0] if name != "test"} == {*USES}


@pytest.mark.timeout(600)
def test_each_extra_brings_what_it_is_for(install, folder):
    environment = install("")
    listed = run(folder, environment / "bin/pushfric", "--help").stdout
    assert "such as demo, come with the package pushfric_ros" in " ".join(listed.split())
    done = run(folder, environment / "bin/pushfric", *ESTIMATE)
    assert "of 6 pushes" in done.stdout, done.stderr
    for extra, use in USES.items():
        missing = run(folder, *use.command(environment, installed=False))
        *_, line = missing.stderr.splitlines()
        assert missing.returncode in (1, 2)
        assert re.search(rf"pip install 'pushfric_core\[{extra}\]'$", line), line
        install(extra)
        found = run(folder, *use.command(environment, installed=True))
        assert use.printed in found.stdout + found.stderr
    assert (folder / "figure.png").stat().st_size > 10_000
