"""Whether the Python packages that pushfric needs are installed, and new enough.

The requirements are written once, as install_requires and extras in src/*/setup.cfg. pip reads them there, and so does the
script `pushfric` before anything is built; later they are in the metadata of the installed packages. Run as a script with
requirements as arguments, this prints a line on those that are not met, which is empty if all are, and then the folders in
which it has looked. It imports nothing of pushfric, because the packages may not be built yet.
"""

import contextlib
import importlib
import importlib.metadata
import re
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
    "pillow": "PIL",
}
"""Packages whose module has another name than the package."""


class Unmet(NamedTuple):
    """A requirement that is not met, and what is installed instead."""

    requirement: str
    found: str


EXTRA = re.compile(r";.*\bextra == ['\"]([\w-]+)['\"]")
BUNDLE = re.compile(r"pushfric[-_]core\[([\w,-]+)\]")


def declared() -> list[str]:
    """The requirements of the installed packages of pushfric; a robot cell needs the extra `cell` of pushfric_core, too."""
    installed = _installed()
    every = _every(installed)
    bundles = (BUNDLE.match(text) for text in every if len(installed) > 1 and _extra(text) == "cell")
    wanted = {None, *(extra for bundle in bundles if bundle for extra in bundle[1].split(","))}
    return sorted({text.partition(";")[0].strip() for text in every if _extra(text) in wanted and not BUNDLE.match(text)})


def _every(packages: Iterable[str]) -> list[str]:
    """The requirements of packages with those of their extras."""
    return sorted({text for name in packages for text in importlib.metadata.requires(name) or ()})


def _installed() -> list[str]:
    found = []
    for name in PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            importlib.metadata.version(name)
            found.append(name)
    return found


def _extra(requirement: str) -> str | None:
    found = EXTRA.search(requirement)
    return None if found is None else found[1]


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
        module = importlib.import_module(_module(name))
    except ImportError:
        return None
    return str(getattr(module, "__version__", ""))


def complaint(requirements: Iterable[str]) -> str | None:
    """A line that names what is missing or too old, and the command that installs it; None if nothing is."""
    lacking = unmet(requirements)
    if not lacking:
        return None
    found = ", ".join(f"{requirement} ({found})" for requirement, found in lacking)
    return f"missing or too old: {found}; install with: {advice(lacking)}"


def explain(error: Exception) -> None:
    """End the process with one line and exit code 2 if a package is missing or too old; called when something has failed.

    An old package lacks what is asked of it: ImportError, AttributeError or TypeError. If none is too old, the mistake is ours.
    """
    missing = (error.name or "").partition(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    if lacking := [text for text in _every(_installed()) if _module(text) == missing]:
        from pushfric_core.errors import installing  # not above: the set-up runs this file by itself

        extra = _extra(lacking[0])
        what = lacking[0].partition(";")[0].strip()
        command = installing(extra) if extra else f"pip install '{what}'"
        line: str | None = f"missing: {what}; install with: python3 -m {command}"
    else:
        line = complaint(declared())
    if line is not None:
        print(f"error: {line}", file=sys.stderr, flush=True)
        sys.exit(2)


def _module(requirement: str) -> str:
    """The module of a required package."""
    name = re.split(r"[^\w.-]", requirement, maxsplit=1)[0]
    return MODULES.get(name, name)


def advice(lacking: Iterable[Unmet]) -> str:
    """The command that installs these requirements."""
    return " ".join(["python3 -m pip install", *(f"'{requirement}'" for requirement, _ in lacking)])


if __name__ == "__main__":
    print(complaint(sys.argv[1:]) or "", *sys.path, sep="\n")
