"""Whether the Python packages that pushfric needs are installed, and new enough.

The requirements are written once, as install_requires in src/*/setup.cfg. pip reads them there, and so does the script
`pushfric` before anything is built; later they are in the metadata of the installed packages. Run as a script with
requirements as arguments, this prints a line on those that are not met, which is empty if all are, and then the folders in
which it has looked. It imports nothing of pushfric, because the packages may not be built yet.
"""

import importlib
import importlib.metadata
import sys
from collections.abc import Iterable
from typing import NamedTuple

PACKAGES = ("pushfric_core", "pushfric_ros")

MODULES = {
    "colcon-core": "colcon_core",
    "import-linter": "importlinter",
    "opencv-python-headless": "cv2",
    "pyserial": "serial",
    "pytest-timeout": "pytest_timeout",
    "PyYAML": "yaml",
}
"""Packages whose module has another name than the package."""


class Unmet(NamedTuple):
    """A requirement that is not met, and what is installed instead."""

    requirement: str
    found: str


def declared() -> list[str]:
    """The requirements of the installed packages of pushfric."""
    texts = {text for name in PACKAGES for text in importlib.metadata.requires(name) or ()}
    return sorted(text for text in texts if "extra ==" not in text)


def unmet(requirements: Iterable[str]) -> list[Unmet]:
    """The requirements whose package is not installed or too old, whether it is from pip or from the system."""
    try:
        from packaging.requirements import Requirement
    except ImportError:
        return [Unmet("packaging", "not installed")]
    lacking = []
    for text in requirements:
        wanted = Requirement(text)
        version = _version(wanted.name)
        if version is None:
            lacking.append(Unmet(text, "not installed"))
        elif version and not wanted.specifier.contains(version, prereleases=True):
            lacking.append(Unmet(text, version))
    return lacking


def _version(name: str) -> str | None:
    """The version of a package; empty if it is unknown, None if the package is not installed."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        pass  # a package of the system may have no metadata, or another name
    try:
        module = importlib.import_module(MODULES.get(name, name))
    except ImportError:
        return None
    return str(getattr(module, "__version__", ""))


def complaint(requirements: Iterable[str]) -> str | None:
    """A line that names what is missing or too old, and the command that installs it; None if nothing is."""
    if not (lacking := unmet(requirements)):
        return None
    found = ", ".join(f"{requirement} ({found})" for requirement, found in lacking)
    return f"missing or too old: {found}; install with: {advice(lacking)}"


def explain() -> None:
    """End the process with one line and exit code 2 if a package is missing or too old; called when something has failed.

    An old package lacks what is asked of it: ImportError, AttributeError or TypeError. If none is too old, the mistake is ours.
    """
    if (line := complaint(declared())) is not None:
        print(f"error: {line}", file=sys.stderr, flush=True)
        sys.exit(2)


def advice(lacking: Iterable[Unmet]) -> str:
    """The command that installs these requirements."""
    return " ".join(["python3 -m pip install", *(f"'{requirement}'" for requirement, _ in lacking)])


if __name__ == "__main__":
    print(complaint(sys.argv[1:]) or "", *sys.path, sep="\n")
