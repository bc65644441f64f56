"""The entry script builds the workspace for each ROS 2 environment that is sourced, and takes none of them away."""

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
    for name in ("pushfric", "set_up.py", dependencies):
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


def test_a_workspace_is_built_for_each_environment_and_again_only_for_what_changed(workspace, tmp_path):
    (workspace / "install").mkdir()
    (workspace / "install/mine").write_text("mine")  # as colcon makes it by hand
    said = re.sub(r"(?m)^pushfric: +\d+ s  .*\n", "", set_up(workspace))  # without how far a step is
    _, build, steps = shown("docs/tutorial.md", "./pushfric setup").partition("pushfric: building")
    assert has_the_form(said, build + steps), said
    first = (workspace / "install").resolve()
    assert (first / "local_setup.bash").is_file()
    assert next((workspace / ".colcon").glob("*/install-before/mine")).read_text() == "mine"
    for name in LEFT_BEHIND:
        (workspace / "src/tiny" / name).parent.mkdir(parents=True, exist_ok=True)
        (workspace / "src/tiny" / name).write_text("left")
    assert set_up(workspace) == ""  # what builds and editors leave behind builds nothing again
    (workspace / "src/tiny/setup.cfg").write_text((workspace / "src/tiny/setup.cfg").read_text() + "# changed\n")
    assert "building" in set_up(workspace)
    said = set_up(workspace, tmp_path / "theirs")
    second = (workspace / "install").resolve()
    assert "a different ROS 2 environment is sourced" in said
    assert second != first
    assert (second / "local_setup.bash").is_file()
    assert (first / "local_setup.bash").is_file()  # whatever runs from there runs on
    assert "building" not in set_up(workspace)  # the first environment again: its build is still there
    assert (workspace / "install").resolve() == first
    set_up(workspace)  # what is built last is newer than the first look at it
    (workspace / "set_up.py").write_text("raise SystemExit('set up again')")  # any other call notices that
    assert "set up again" in subprocess.run([workspace / "pushfric", "estimate"], capture_output=True, text=True).stderr


def test_the_script_knows_all_that_a_build_copies(script):
    """A new kind of file in a package must be in the list, or be one that needs no build: a module, its data, a text."""
    listed = subprocess.run(["git", "ls-files", "src"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("this is not a clone: git cannot list its files")
    for path in map(pathlib.PurePath, listed.stdout.splitlines()):
        _, package, *rest = path.parts
        copied = any(pathlib.PurePath(*rest).match(kind.format(package=package)) for kind in script.BUILT_FROM)
        assert copied or rest[0] in (package, "CHANGELOG.rst", "LICENSE"), path


def called_before_the_set_up(workspace: pathlib.Path, word: str) -> "subprocess.CompletedProcess[str]":
    """A call in a workspace with our packages, where nothing is sourced and nothing was built."""
    for package in ("pushfric_core/pushfric_core", "pushfric_ros/pushfric_ros"):
        shutil.copytree(ROOT / "src" / package, workspace / "src" / package, dirs_exist_ok=True)
    nothing = {name: value for name, value in os.environ.items() if name not in ("AMENT_PREFIX_PATH", "PYTHONPATH")}
    return subprocess.run([workspace / "pushfric", word], env=nothing, capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize(("word", "meant"), [("estimte", "estimate"), ("--hlep", "--help"), ("setpu", "setup")])
def test_a_misspelt_command_is_refused_before_the_set_up(workspace, word, meant):
    done = called_before_the_set_up(workspace, word)
    kind = "option" if word.startswith("-") else "command"
    said = f"pushfric: no such {kind} {word!r}; did you mean {meant}? see ./pushfric --help\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", said)
    assert not (workspace / ".venv").exists()
    assert not (workspace / ".colcon").exists()


def test_ctrl_c_ends_a_step_of_the_set_up_with_all_that_it_started(script, tmp_path):
    """`kill -INT` reaches this process alone; the terminal would have reached its group."""
    program = f"""
import os, pathlib, signal, sys
sys.path.insert(0, {str(ROOT)!r})
import set_up as script
signal.pthread_sigmask(signal.SIG_BLOCK, script.HELD)
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


@pytest.mark.parametrize("module", ["solvers.pivoting", "mechanics.least_dissipation", "belief.inner_loops", "program.sliding"])
def test_the_set_up_compiles_the_inner_loops(module):
    assert importlib.util.find_spec(f"pushfric_core.{module}").origin.endswith(".so")


def test_a_busy_domain_is_refused_before_the_set_up(workspace):
    with lock("/cell"):
        done = called_before_the_set_up(workspace, "demo")
    assert (done.returncode, done.stdout) == (2, "")
    assert re.fullmatch(r"pushfric: a cell named /cell is already running on ROS domain \d+, .*\n", done.stderr)
    assert not (workspace / ".venv").exists()


@pytest.fixture
def checkout(script, tmp_path, monkeypatch):
    """The set-up of a checkout in which an environment takes a moment, and this process's Python is another than its own."""
    for name in ("requirements.lock", *(f"{extra}/requirements.txt" for extra in script.EXTRAS)):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("-r ../bench/requirements.txt\n" if name.startswith("test") else "one==1\n")
    for name, value in {"ROOT": tmp_path, "BUILT": tmp_path / ".colcon", "VENV": tmp_path / ".venv", "steps": []}.items():
        monkeypatch.setattr(script, name, value, raising=False)

    def create(command, *_):
        python = command[-1] / "bin/python3"
        python.parent.mkdir(parents=True)
        python.write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
        python.chmod(0o755)
        script.steps.append(command[0])

    monkeypatch.setattr(script, "run", create)
    monkeypatch.setattr(script, "start_again", lambda *_: monkeypatch.setattr(sys, "executable", script.VENV / "bin/python3"))
    monkeypatch.setattr(script, "install", lambda _, file: script.steps.append(str(file.relative_to(tmp_path))))
    monkeypatch.setattr(script, "slim", lambda _: None)
    monkeypatch.setattr(script, "make_underlay", lambda _: None)
    return script


def made(checkout, command="estimate") -> list[str]:
    """What a call makes: the Python that creates an environment, and the requirements that are installed."""
    before, checkout.steps[:] = sys.executable, []
    checkout.make_venv(command)
    sys.executable = before
    return checkout.steps[:]


def test_an_environment_is_made_by_the_first_python_and_then_keeps_its_own(checkout, monkeypatch):
    """Another one on the PATH, as of conda, pyenv or sudo, had it made again under what was running in it."""
    assert made(checkout) == [sys.executable, "requirements.lock"]
    first, own = checkout.VENV.resolve(), checkout.VENV / "bin/python3"
    with monkeypatch.context() as another:
        another.setattr(sys, "version_info", (3, 14, 0))
        assert made(checkout) == []
    assert made(checkout, "bench") == ["bench/requirements.txt"]  # beside what is there
    assert checkout.VENV.resolve() == first
    (checkout.ROOT / "requirements.lock").write_text("two==2")
    assert made(checkout) == [own, "requirements.lock", "bench/requirements.txt"]
    assert (first / "bin/python3").exists()
    assert checkout.VENV.resolve() != first


def test_what_was_installed_and_is_wanted_otherwise_is_installed_elsewhere(checkout):
    made(checkout, "test")
    first = checkout.VENV.resolve()
    (checkout.ROOT / "bench/requirements.txt").write_text("one==2")  # which the tests' requirements include
    assert made(checkout)[1:] == ["requirements.lock", "test/requirements.txt"]
    assert checkout.VENV.resolve() != first


def test_an_environment_whose_python_does_not_start_is_made_again(checkout):
    made(checkout)
    checkout.steps[:] = []
    (checkout.VENV / "bin/python3").unlink()  # the system's, to which it led, has gone
    assert made(checkout) == [sys.executable, "requirements.lock"]
    (checkout.VENV / "bin/python3").write_text("#!/bin/sh\nexit 1\n")  # it is of another version now, and finds no packages
    assert made(checkout) == [sys.executable, "requirements.lock"]


def test_an_environment_of_another_user_is_not_made_again(checkout, monkeypatch):
    """As one that root made with a Python in root's own folder."""
    made(checkout)
    monkeypatch.setattr(os, "access", lambda folder, way: (folder, way) != (checkout.BUILT, os.W_OK))
    assert made(checkout) == []
    (checkout.VENV / "bin/python3").write_text("#!/bin/sh\nexit 1\n")
    with pytest.raises(checkout.SetupError, match="is another user's, and its Python does not start for you; clone the"):
        made(checkout)


def test_an_old_python_of_a_sourced_ros_is_named(script, tmp_path, monkeypatch):
    """It knows no -P."""
    (tmp_path / "python3").write_text("#!/bin/sh\necho 'Unknown option: -P' >&2; exit 2\n")
    (tmp_path / "python3").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    with pytest.raises(script.SetupError, match=r"the sourced ROS 2's python3: .*: Unknown option: -P"):
        script.check_libraries("estimate", "/opt/ros/jazzy")


def test_an_environment_that_could_not_be_made_takes_no_ones_place(checkout, monkeypatch):
    made(checkout)
    first = checkout.VENV.resolve()
    (checkout.ROOT / "requirements.lock").write_text("two==2")
    monkeypatch.setattr(checkout, "slim", lambda _: (checkout.ROOT / "offline").stat())
    with pytest.raises(FileNotFoundError, match="offline"):
        made(checkout)
    assert checkout.VENV.resolve() == first
    checkout.remove_unused()
    assert [folder.name for folder in checkout.BUILT.iterdir()] == [first.parent.name]


def test_an_environment_that_was_replaced_stays_while_a_command_runs_from_it(checkout):
    made(checkout)
    first = checkout.VENV.resolve().parent
    hold = f"import sys; sys.path.insert(0, {str(ROOT)!r}); import set_up, pathlib; set_up.hold(pathlib.Path({str(first)!r}))"
    become = "import os; print(flush=True); os.execvp('cat', ['cat'])"
    with subprocess.Popen([sys.executable, "-c", f"{hold}; {become}"], stdin=-1, stdout=-1) as command:
        command.stdout.readline()
        (checkout.ROOT / "requirements.lock").write_text("two==2")
        made(checkout)
        checkout.remove_unused()
        assert first.exists()
        command.stdin.close()
    checkout.remove_unused()
    assert not first.exists()
    assert checkout.VENV.exists()


def test_a_second_set_up_waits_and_says_so(checkout):
    another = f"import sys; sys.path.insert(0, {str(ROOT)!r}); import set_up, pathlib; set_up.ROOT = {str(checkout.ROOT)!r}"
    another += "\nwith set_up.one_at_a_time(): print('mine')"
    with checkout.one_at_a_time():
        second = subprocess.Popen([sys.executable, "-c", another], stdout=-1, stderr=-1, text=True)
        assert "another call sets up" in second.stderr.readline()
        assert second.poll() is None
    assert second.communicate() == ("mine\n", "")


def test_the_cache_of_uv_stays_as_it_is(script, tmp_path, monkeypatch):
    """Files of an environment may be links into it; a second clone then built against headers of the first, long gone."""
    cached, installed = tmp_path / "cached.cmake", tmp_path / "share/msgs/cmake/msgsExport.cmake"
    theirs = "/opt/python/cp311/lib/python3.11/site-packages/numpy/core/include", "/opt/_internal/cp311/include/python3.11"
    before = f'DIRECTORIES "{";".join(theirs)}"'
    cached.write_text(before)
    installed.parent.mkdir(parents=True)
    installed.hardlink_to(cached)
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/python").write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    (tmp_path / "bin/python").chmod(0o755)
    script.make_underlay(tmp_path)
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
    monkeypatch.setattr(script, "STRIPPED", 1000)
    script.slim(tmp_path)
    assert [path.name for path in (packages / "one").iterdir()] == [module.name]
    links = {path.name: str(path.readlink()) for path in (tmp_path / "lib").iterdir() if path.is_symlink()}
    assert links == {"libone.so": "libone.so.1.2", "libone.so.1": "libone.so.1.2"}
    assert (packages / "first.libs/libthree-0a1b.so.3").readlink() == pathlib.Path("../second.libs/libthree-0a1b.so.3")
    assert cached.read_bytes() == before
    assert module.stat().st_size < cached.stat().st_size
