"""What the packages need is written once, declared to ROS, pinned, and checked: see pushfric_core.commands.dependencies."""

import ast
import importlib.metadata
import pathlib
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import pytest
import yaml
from missing import extras, options, pushfric_without
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from pushfric_core.commands import dependencies
from pushfric_core.vision.camera import Camera, save_camera

ROOT = pathlib.Path(__file__).resolve().parents[1]
PACKAGES = ("pushfric_core", "pushfric_msgs", "pushfric_ros")
PYTHON_PACKAGES = ("pushfric_core", "pushfric_ros")
KEYS = yaml.safe_load((ROOT / "test/rosdep_keys.yaml").read_text())
OF_KEYS = {
    "mcap": "mcap-ros2-support",
    "opencv-python-headless": "python3-opencv",
    "pillow": "python3-pil",
    "pyserial": "python3-serial",
    "pyyaml": "python3-yaml",
    "rosbags": "python3-rosbags-pip",
    "zstandard": "mcap-ros2-support",
}
"""The rosdep key of a Python package, if it is not python3-NAME."""

WITHOUT_KEY = {"osqp"}


def package(name):
    return ElementTree.parse(ROOT / "src" / name / "package.xml").getroot()


def keys(name, *kinds):
    return [element.text for kind in kinds for element in package(name).iter(kind)]


def declared(script, name):
    """Names of the Python packages that one of ours declares."""
    found, of_cells = extras(name)
    own = [
        *options(name)["options"]["install_requires"].split("\n")[1:],
        *(text for extra in of_cells for text in found[extra]),
    ]
    assert set(own) <= set(script.requirements())
    return {canonicalize_name(Requirement(text).name) for text in own}


def optional(name):
    """Names of the optional modules: a cell works without them, but does less."""
    found, of_cells = extras(name)
    return {Requirement(text).name for extra in found if extra not in (*of_cells, "test") for text in found[extra]}


def imported(name):
    """Names of the top-level modules that a package imports, anywhere in its files."""
    found = set()
    for path in (ROOT / "src" / name).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and not node.level and node.module:
                names = [node.module]
            found |= {module.partition(".")[0] for module in names}
    return found - set(sys.stdlib_module_names) - {name, "setuptools", "Cython"}


@pytest.mark.parametrize("name", PYTHON_PACKAGES)
def test_what_is_imported_is_declared_and_nothing_else(script, name):
    modules = {canonicalize_name(package): module for package, module in dependencies.MODULES.items()}
    of_python = {modules.get(package, package).replace("-", "_") for package in declared(script, name)}
    of_ros = {*keys(name, "exec_depend", "depend")} & {*KEYS["ros"], *PACKAGES}
    assert imported(name) == of_python | of_ros | {modules.get(one, one) for one in optional(name)}


ALONE = """
import sys
for name in sys.argv[1:]:
    sys.modules[name] = None  # as if it were not installed
from pushfric_core import Estimator, Observation, Twist
estimator = Estimator([(-0.05, 0.0), (0.05, 0.0)])
for push in range(6):  # the tip goes 3 mm deep into the outline: the verdict asks whether that is chance
    depth = 0.003 + 1e-4 * (push % 3)
    push = Observation((0.01 * push - 0.02, -0.03), (0.0, -1.0), Twist(0.0, 0.02, 0.1 * push + 0.05), push_id=push, depth=depth)
    estimate = estimator.add(push)
estimate.verdict
"""


def test_the_readme_names_what_the_estimator_alone_needs(script):
    (named,) = re.findall("Python 3.11 or newer with (.*), without ROS", (ROOT / "README.md").read_text())
    needed = set(re.split(", | and ", named))
    others = {dependencies.MODULES.get(text, text) for text in script_names(script) - needed}

    def works_without(*names):
        return not subprocess.run([sys.executable, "-c", ALONE, *names], capture_output=True, check=False).returncode

    assert needed <= script_names(script)
    assert works_without(*others)
    assert [name for name in sorted(needed) if works_without(name)] == []


def script_names(script):
    """Names of the Python packages that a cell needs, as pip knows them."""
    return {Requirement(text).name for text in script.requirements()}


@pytest.mark.parametrize("name", PYTHON_PACKAGES)
def test_ros_is_told_the_same_python_packages_as_pip(script, name):
    wanted = {OF_KEYS.get(package, f"python3-{package}") for package in declared(script, name) - WITHOUT_KEY}
    told = {key for key in keys(name, "exec_depend", "depend") if key in KEYS["system"] or key in KEYS["pip"]}
    assert told == wanted


@pytest.mark.parametrize("name", PACKAGES)
def test_every_key_is_one_that_rosdistro_knows(name):
    known = {*KEYS["system"], *KEYS["pip"], *KEYS["ros"], *PACKAGES}
    kinds = ("depend", "exec_depend", "build_depend", "buildtool_depend", "test_depend")
    assert set(keys(name, *kinds)) <= known


@pytest.mark.parametrize("name", PACKAGES)
def test_a_package_has_what_a_release_needs(name):
    folder, root = ROOT / "src" / name, package(name)
    assert (folder / "LICENSE").read_text() == (ROOT / "LICENSE").read_text()
    assert root.find("license").get("file") == "LICENSE"
    assert root.find("url").text.startswith("https://")
    title = f"Changelog for package {name}"
    assert (folder / "CHANGELOG.rst").read_text().splitlines()[:3] == ["^" * len(title), title, "^" * len(title)]
    version = root.find("version").text
    assert version == package("pushfric_core").find("version").text
    assert (folder / "CHANGELOG.rst").read_text().splitlines()[4].startswith(f"{version} (")
    if name in PYTHON_PACKAGES:
        assert importlib.metadata.version(name) == version  # setup.py reads package.xml
        # by these `colcon test` knows that there are tests, and where
        needed = extras(name)[0]["test"]
        assert {f"python3-{package}" for package in needed} <= set(keys(name, "test_depend"))
        assert "pytest" in needed
        assert any((folder / options(name)["tool:pytest"]["testpaths"]).glob("**/test_*.py"))


def test_the_pins_satisfy_what_the_packages_declare(script):
    lines = (ROOT / "requirements-libraries.txt").read_text().splitlines()
    pins = {canonicalize_name(Requirement(line).name): Requirement(line) for line in lines if line and line[0] != "#"}
    for text in script.requirements():
        wanted = Requirement(text)
        (pin,) = pins[canonicalize_name(wanted.name)].specifier
        assert pin.operator == "=="
        assert wanted.specifier.contains(pin.version), f"{wanted} against {pin}"


@pytest.mark.parametrize("name", ["requirements", "requirements-kilted"])
def test_a_lock_file_has_the_pins_and_a_hash_for_everything(name):
    text = (ROOT / f"{name}.lock").read_text()
    locked = re.findall(r"^(\S+==\S+)[^\n]*?(?: \\\n    --hash=sha256:[0-9a-f]{64})+$", text, re.MULTILINE)
    assert len(locked) == sum(not line.startswith(" ") for line in text.splitlines())
    assert "coverage[toml]==" in text  # pip refuses what pytest-cov wants of it otherwise
    names = {(canonicalize_name(re.split(r"\[|==", text)[0]), text.partition("==")[2]) for text in locked}
    pinned = [line for file in (f"{name}.txt", "requirements-libraries.txt") for line in (ROOT / file).read_text().splitlines()]
    pins = [Requirement(line) for line in pinned if line and line[0] not in "#-"]
    wanted = {(canonicalize_name(pin.name), str(pin.specifier).removeprefix("==")) for pin in pins}
    assert len(wanted) > 30
    assert wanted <= names, "make the lock files again: see CONTRIBUTING.md"


def test_the_packages_as_installed_declare_what_the_script_reads(script):
    assert {str(Requirement(text)) for text in dependencies.declared()} == {
        str(Requirement(text)) for text in script.requirements()
    }
    assert dependencies.unmet(dependencies.declared()) == []


@pytest.fixture
def old(tmp_path, monkeypatch):
    """A folder of packages with old versions, one of them without metadata; it comes first on Python's path."""
    for name, version in (("pydantic", "1.10.14"), ("rich", "9.0")):
        info = tmp_path / f"{name}-{version}.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    (tmp_path / "pydantic.py").write_text("VERSION = __version__ = '1.10.14'\n")
    (tmp_path / "of_the_system.py").write_text("__version__ = '4.6.0'\n")
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_what_is_missing_or_too_old_is_told_in_one_line(old):
    asked = ["pydantic>=2.5", "rich>=9", "of_the_system>=4.7", "of_the_system>=4.6", "nowhere-to-be-found>=1"]
    assert dependencies.complaint(asked) == (
        "missing or too old: pydantic>=2.5 (1.10.14), of_the_system>=4.7 (4.6.0), nowhere-to-be-found>=1 (not installed); "
        "install with: python3 -m pip install 'pydantic>=2.5' 'of_the_system>=4.7' 'nowhere-to-be-found>=1'"
    )
    assert dependencies.complaint(["rich>=9"]) is None


USERS = {
    "cv2": ["calibrate", "board", "--out", "OUT"],
    "matplotlib": ["estimate", "bags/rubber_rect4", "--figure", "OUT.png"],
    "numpy": ["estimate", "bags/rubber_rect4"],
    "serial": ["rehearse", "docs/example_cell/cell.yaml"],
    "tornado": ["edit", "OUT.yaml", "--port", "0"],
    "typer": ["--version"],
}
"""A command that loads the module."""


PACKAGE_OF = {module: [package] for package, module in dependencies.MODULES.items()}


def test_a_figure_needs_no_camera(tmp_path):
    ended = pushfric_without(["cv2"], "estimate", "bags/rubber_rect4", "--figure", tmp_path / "figure.png")
    assert ended.returncode == 0, ended.stderr


@pytest.mark.parametrize("module", USERS)
def test_a_missing_module_is_one_line(module, tmp_path):
    save_camera(Camera.looking_down(640, 480, (0.0, 0.0), 0.001), tmp_path / "out.yaml")
    ended = pushfric_without([module], *(argument.replace("OUT", str(tmp_path / "out")) for argument in USERS[module]))
    *_, line = ended.stderr.splitlines()
    assert (ended.returncode, line.partition(":")[0]) in ((2, "error"), (1, "error"))
    assert "pip install" in line
    assert {name for name in (module, *PACKAGE_OF.get(module, ())) if name in line}
    assert "Traceback" not in ended.stderr
