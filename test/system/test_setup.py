"""The entry script builds the workspace for each ROS 2 environment that is sourced, and takes none of them away."""

import importlib.machinery
import importlib.util
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import time

import pytest
from documents import has_the_form, shown

from pushfric_ros.node_kit.lock import lock

ROOT = pathlib.Path(__file__).resolve().parents[2]
PACKAGE = """
<package format="3">
  <name>tiny</name><version>0.0.1</version><description>Tiny.</description>
  <maintainer email="a@b.cd">A</maintainer><license>Apache-2.0</license>
  <export><build_type>ament_python</build_type></export>
</package>"""
SETUP = """from setuptools import setup
setup(name="tiny", version="0.0.1", py_modules=["tiny"], data_files=[("share/tiny", ["package.xml"])])"""


@pytest.fixture
def workspace(tmp_path):
    """The entry script over a workspace of one tiny package."""
    source = tmp_path / "ws/src/tiny"
    source.mkdir(parents=True)
    dependencies = "src/pushfric_core/pushfric_core/commands/dependencies.py"  # what the script asks before it builds
    (tmp_path / "ws" / dependencies).parent.mkdir(parents=True)
    for name in ("pushfric", dependencies):
        shutil.copy2(ROOT / name, tmp_path / "ws" / name)
    (tmp_path / "ws/colcon.meta").write_text("{}")
    (source / "package.xml").write_text(PACKAGE.strip())
    (source / "setup.py").write_text(SETUP)
    (source / "setup.cfg").write_text("[develop]\nscript_dir=$base/lib/tiny\n[install]\ninstall_scripts=$base/lib/tiny\n")
    (source / "tiny.py").write_text("VALUE = 1\n")
    return tmp_path / "ws"


def set_up(workspace: pathlib.Path, *overlays: pathlib.Path) -> str:
    """What the script says when it is called in the tests' environment with more overlays sourced on top."""
    prefixes = os.pathsep.join([*map(str, overlays), os.environ["AMENT_PREFIX_PATH"]])
    done = subprocess.run(
        [workspace / "pushfric", "setup"],
        env=os.environ | {"AMENT_PREFIX_PATH": prefixes},
        capture_output=True,
        text=True,
        timeout=200,
    )
    assert done.returncode == 0, done.stderr
    return done.stderr


def test_each_environment_has_a_build_of_its_own(workspace, tmp_path):
    said = re.sub(r"(?m)^pushfric: +\d+ s  .*\n", "", set_up(workspace))  # without how far a step is
    _, build, steps = shown("docs/tutorial.md", "./pushfric setup").partition("pushfric: building")
    assert has_the_form(said, build + steps), said
    first = (workspace / "install").resolve()
    assert (first / "local_setup.bash").is_file()
    said = set_up(workspace, tmp_path / "theirs")
    second = (workspace / "install").resolve()
    assert "a different ROS 2 environment is sourced" in said
    assert second != first
    assert (second / "local_setup.bash").is_file()
    assert (first / "local_setup.bash").is_file()  # whatever runs from there runs on
    assert "building" not in set_up(workspace)  # the first environment again: its build is still there
    assert (workspace / "install").resolve() == first


LEFT_BEHIND = (
    "build/lib/tiny.py",
    "dist/tiny-0.0.1.tar.gz",
    "tiny.egg-info/PKG-INFO",
    ".mypy_cache/3.11/tiny.data.json",
    ".pytest_cache/v/cache/lastfailed",
    "tiny-0.0.1-py3-none-any.whl",
    ".package.xml.swp",
    "package.xml~",
    "setup.cfg.orig",
    "launch/tiny.launch.py.bak",
    "__pycache__/setup.cpython-311.pyc",
)


def test_what_builds_and_editors_leave_behind_builds_nothing_again(workspace):
    assert "building" in set_up(workspace)
    for name in LEFT_BEHIND:
        (workspace / "src/tiny" / name).parent.mkdir(parents=True, exist_ok=True)
        (workspace / "src/tiny" / name).write_text("left")
    assert set_up(workspace) == ""
    (workspace / "src/tiny/setup.cfg").write_text((workspace / "src/tiny/setup.cfg").read_text() + "# changed\n")
    assert "building" in set_up(workspace)


def test_the_script_knows_all_that_a_build_copies(script):
    """A new kind of file in a package must be in the list, or be one that needs no build: a module, its data, a text."""
    listed = subprocess.run(["git", "ls-files", "src"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("this is not a clone: git cannot list its files")
    for path in map(pathlib.PurePath, listed.stdout.splitlines()):
        _, package, *rest = path.parts
        copied = any(pathlib.PurePath(*rest).match(kind.format(package=package)) for kind in script.BUILT_FROM)
        assert copied or rest[0] in (package, "CHANGELOG.rst", "LICENSE"), path


@pytest.mark.parametrize(("word", "meant"), [("estimte", "estimate"), ("--hlep", "--help"), ("setpu", "setup")])
def test_a_misspelt_command_is_refused_before_the_set_up(workspace, word, meant):
    for package in ("pushfric_core/pushfric_core", "pushfric_ros/pushfric_ros"):
        shutil.copytree(ROOT / "src" / package, workspace / "src" / package, dirs_exist_ok=True)
    nothing = {name: value for name, value in os.environ.items() if name not in ("AMENT_PREFIX_PATH", "PYTHONPATH")}
    done = subprocess.run([workspace / "pushfric", word], env=nothing, capture_output=True, text=True, timeout=60)
    kind = "option" if word.startswith("-") else "command"
    said = f"pushfric: no such {kind} {word!r}; did you mean {meant}? see ./pushfric --help\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", said)
    assert not (workspace / ".venv").exists()
    assert not (workspace / ".colcon").exists()


def test_ctrl_c_ends_a_step_of_the_set_up_with_all_that_it_started(script, tmp_path):
    """`kill -INT` reaches this process alone; the terminal would have reached its group."""
    program = f"""
import importlib.machinery, os, pathlib, sys
script = importlib.machinery.SourceFileLoader("script", {str(ROOT / "pushfric")!r}).load_module()
script.ROOT = pathlib.Path({str(tmp_path)!r})
try:
    script.run(["bash", "-c", "sleep 1000 & echo $! > child; wait"], "a step", dict(os.environ))
except KeyboardInterrupt:
    sys.exit(130)
"""
    (tmp_path / "log").mkdir()
    command = [sys.executable, "-W", "ignore", "-c", program]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as setting_up:
        while not (tmp_path / "child").exists() or not (tmp_path / "child").read_text():
            time.sleep(0.01)
        setting_up.send_signal(signal.SIGINT)
        said = setting_up.stderr.read()
    assert (setting_up.returncode, said) == (130, "pushfric: a step ...\n")
    child = pathlib.Path(f"/proc/{(tmp_path / 'child').read_text().strip()}/stat")
    while child.exists() and child.read_text().rpartition(")")[2].split()[0] != "Z":
        time.sleep(0.01)


def test_a_folder_that_colcon_made_by_hand_is_kept(workspace):
    (workspace / "install").mkdir()
    (workspace / "install/mine").write_text("mine")
    set_up(workspace)
    assert (workspace / "install").is_symlink()
    assert next((workspace / ".colcon").glob("*/install-before/mine")).read_text() == "mine"


@pytest.fixture
def script():
    """The script `pushfric` as a module."""
    loader = importlib.machinery.SourceFileLoader("pushfric_script", str(ROOT / "pushfric"))
    script = importlib.util.module_from_spec(importlib.util.spec_from_loader(loader.name, loader))
    loader.exec_module(script)
    return script


@pytest.mark.parametrize("module", ["solvers.pivoting", "mechanics.least_dissipation"])
def test_the_set_up_compiles_the_inner_loops(module):
    assert importlib.util.find_spec(f"pushfric_core.{module}").origin.endswith(".so")


def test_a_busy_domain_is_refused_before_the_set_up(workspace):
    for package in ("pushfric_core/pushfric_core", "pushfric_ros/pushfric_ros"):
        shutil.copytree(ROOT / "src" / package, workspace / "src" / package, dirs_exist_ok=True)
    nothing = {name: value for name, value in os.environ.items() if name not in ("AMENT_PREFIX_PATH", "PYTHONPATH")}
    with lock("/cell"):
        done = subprocess.run([workspace / "pushfric", "demo"], env=nothing, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout) == (2, "")
    assert re.fullmatch(r"pushfric: a cell named /cell is already running on ROS domain \d+, .*\n", done.stderr)
    assert not (workspace / ".venv").exists()


def test_an_environment_keeps_the_python_that_it_was_made_with(script, tmp_path, monkeypatch):
    """Another one on the PATH, as of conda, pyenv or sudo, had it made again under what was running in it."""
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/python").touch()
    wanted = [script.ROOT / script.DISTROS[script.DISTRO], script.ROOT / "pushfric"]
    (tmp_path / "made-from-root").write_text(script.digest(wanted, str(script.ROOT)))
    monkeypatch.setattr(script, "VENV", tmp_path)
    monkeypatch.setattr(sys, "version", "3.14.0 (another one)")
    monkeypatch.setattr(sys, "version_info", (3, 14, 0))
    monkeypatch.setattr(script, "run", lambda command, *_: pytest.fail(f"{command}"))
    script.make_venv("demo")


def test_the_cache_of_uv_stays_as_it_is(script, tmp_path, monkeypatch):
    """Files of an environment may be links into it; a second clone then built against headers of the first, long gone."""
    cached, installed = tmp_path / "cached.cmake", tmp_path / "share/msgs/cmake/msgsExport.cmake"
    theirs = "/opt/python/cp311/lib/python3.11/site-packages/numpy/core/include", "/opt/_internal/cp311/include/python3.11"
    before = f'DIRECTORIES "{";".join(theirs)}"'
    cached.write_text(before)
    installed.parent.mkdir(parents=True)
    installed.hardlink_to(cached)
    monkeypatch.setattr(script, "VENV", tmp_path)
    script.make_underlay(pathlib.Path(sys.executable))
    assert cached.read_text() == before
    _, numpy_headers, python_headers = re.findall(r'[^";]+', installed.read_text())
    assert (pathlib.Path(numpy_headers) / "numpy/ndarrayobject.h").is_file()
    assert (pathlib.Path(python_headers) / "Python.h").is_file()


def test_what_nobody_needs_is_taken_out_of_the_wheels(script, tmp_path, monkeypatch):
    packages, cached = tmp_path / "lib/python3.11/site-packages", tmp_path / "cached.so"
    (packages / "one/tests").mkdir(parents=True)
    (packages / "one/tests/test_all.py").write_text("")
    (packages / "one/one.c").write_text("int one(void) { return 1; }")
    subprocess.run(["g++", "-g", "-shared", "-fPIC", packages / "one/one.c", "-o", cached], check=True)
    before = cached.read_bytes()
    module = packages / "one/one.cpython-311-x86_64-linux-gnu.so"
    module.hardlink_to(cached)
    for name in ("libone.so", "libone.so.1", "libone.so.1.2", "libtwo.so", "libtwo.so.1"):
        (tmp_path / "lib" / name).write_text("other" if name == "libtwo.so.1" else "same")
    for name in ("first.libs", "second.libs"):
        (packages / name).mkdir()
        (packages / name / "libthree-0a1b.so.3").write_text("theirs")
    monkeypatch.setattr(script, "VENV", tmp_path)
    monkeypatch.setattr(script, "STRIPPED", 1000)
    script.slim()
    assert [path.name for path in (packages / "one").iterdir()] == [module.name]
    links = {path.name: str(path.readlink()) for path in (tmp_path / "lib").iterdir() if path.is_symlink()}
    assert links == {"libone.so": "libone.so.1.2", "libone.so.1": "libone.so.1.2"}
    assert (packages / "first.libs/libthree-0a1b.so.3").readlink() == pathlib.Path("../second.libs/libthree-0a1b.so.3")
    assert cached.read_bytes() == before
    assert module.stat().st_size < cached.stat().st_size
