"""Programs and the command line where some modules are missing, and the extras that bring them."""

import configparser
import pathlib
import re
import subprocess
import sys
from collections.abc import Iterable

ROOT = pathlib.Path(__file__).resolve().parents[1]

WITHOUT = """
import sys

class Missing:
    def find_spec(self, name, *_):
        if name.partition(".")[0] in MODULES:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Missing())
"""

MAIN = """
from pushfric_core.__main__ import main
main()
"""


def python_without(
    modules: Iterable[str], program: str, folder: pathlib.Path, *arguments: object
) -> subprocess.CompletedProcess[str]:
    """Run a program in a folder as if these modules were not installed."""
    command = [sys.executable, "-c", WITHOUT.replace("MODULES", repr(tuple(modules))) + program, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=240, cwd=folder, check=False)


def pushfric_without(modules: Iterable[str], *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run the command line, in the project's folder, as if these modules were not installed."""
    return python_without(modules, MAIN, ROOT, *arguments)


def options(package: str) -> configparser.ConfigParser:
    """What the setup.cfg of a package says."""
    parser = configparser.ConfigParser()
    parser.read(ROOT / "src" / package / "setup.cfg")
    return parser


def extras(package: str) -> tuple[dict[str, list[str]], list[str]]:
    """The requirements of each extra without other extras, and the extras that a robot cell needs."""
    found = {extra: text.split() for extra, text in options(package)["options.extras_require"].items()}
    found.pop("all", None)
    (bundle,) = found.pop("cell", [""])
    own = {extra: [one for one in texts if not one.startswith(package)] for extra, texts in found.items()}
    return own, re.findall(r"[\w-]+", bundle.partition("[")[2])
