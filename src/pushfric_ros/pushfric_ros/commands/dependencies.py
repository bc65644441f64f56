"""Whether the Python packages that ours need are there, and new enough.

What they are is written once, as install_requires in src/*/setup.cfg: pip reads it there, the script `pushfric` too, before
anything is built; later it is in the metadata of the installed packages. Run as a script, with requirements as arguments, this
prints those that are not met. It imports nothing of pushfric, as the packages may not be built yet.
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
"""Packages whose module has another name."""


class Unmet(NamedTuple):
    """A requirement, and what is there instead."""

    requirement: str
    found: str


def declared() -> list[str]:
    """What the installed packages of pushfric require."""
    texts = {text for name in PACKAGES for text in importlib.metadata.requires(name) or ()}
    return sorted(text for text in texts if "extra ==" not in text)


def unmet(requirements: Iterable[str]) -> list[Unmet]:
    """Those that are not installed, or too old, whether they come from pip or from the system."""
    try:
        from packaging.requirements import Requirement
    except ImportError:
        return [Unmet("packaging", "not installed")]
    amiss = []
    for text in requirements:
        wanted = Requirement(text)
        version = _version(wanted.name)
        if version is None:
            amiss.append(Unmet(text, "not installed"))
        elif version and not wanted.specifier.contains(version, prereleases=True):
            amiss.append(Unmet(text, version))
    return amiss


def _version(name: str) -> str | None:
    """The version of a package; empty where it does not tell, None where it is not there."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        pass  # a system's package may have no metadata, or another name
    try:
        module = importlib.import_module(MODULES.get(name, name))
    except ImportError:
        return None
    return str(getattr(module, "__version__", ""))


def complaint(requirements: Iterable[str]) -> str | None:
    """One line that names what is missing or too old, and the command that installs it; None where all is there."""
    if not (amiss := unmet(requirements)):
        return None
    found = ", ".join(f"{requirement} ({found})" for requirement, found in amiss)
    return f"missing or too old: {found}; install with: {advice(amiss)}"


def advice(amiss: Iterable[Unmet]) -> str:
    """The command that installs what is not met."""
    return " ".join(["python3 -m pip install", *(f"'{requirement}'" for requirement, _ in amiss)])


if __name__ == "__main__":
    if line := complaint(sys.argv[1:]):
        print(line)
