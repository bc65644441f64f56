"""The command `licences`."""

import importlib.metadata
from importlib.metadata import Distribution
from json import dumps

from packaging.requirements import Requirement
from rich.console import Console
from rich.table import Table

from pushfric_core.commands.application import Application
from pushfric_core.commands.dependencies import PACKAGES
from pushfric_core.commands.json_option import STDOUT, JsonOption, write_json

app = Application()


@app.command()
def licences(json: JsonOption = None) -> None:
    """An extra that is not installed is left out."""
    found = installed()
    rows = {name: {"version": one.version, "licence": licence(one)} for name, one in sorted(found.items())}
    write_json(dumps(rows), json)
    if json == STDOUT:
        return
    table = Table("package", "version", "licence", box=None, pad_edge=False)
    for name, row in rows.items():
        table.add_row(name, row["version"], row["licence"])
    Console(highlight=False).print(table)


def installed() -> dict[str, Distribution]:
    """pushfric and every installed Python package that it needs, directly or through others."""
    found: dict[str, Distribution] = {}
    open_ends = [(name, frozenset[str]()) for name in PACKAGES]
    seen = set(open_ends)
    while open_ends:
        name, extras = open_ends.pop()
        try:
            one = importlib.metadata.distribution(name)
        except importlib.metadata.PackageNotFoundError:
            continue
        found[one.metadata["Name"]] = one
        if name in PACKAGES:
            extras = frozenset(one.metadata.get_all("Provides-Extra") or ()) - {"test"}
        for requirement in map(Requirement, one.requires or ()):
            wanted = any(requirement.marker is None or requirement.marker.evaluate({"extra": extra}) for extra in ("", *extras))
            needed = (requirement.name, frozenset(requirement.extras))
            if wanted and needed not in seen:
                seen.add(needed)
                open_ends.append(needed)
    return found


def licence(package: Distribution) -> str:
    """A package's licence as its metadata states it: an SPDX expression, or the names of older forms."""
    metadata = package.metadata
    stated = metadata.get_all("License-Expression") or [
        line.rpartition(" :: ")[2] for line in metadata.get_all("Classifier") or () if line.startswith("License ::")
    ]
    older = [text.strip().partition("\n")[0] for text in metadata.get_all("License") or ()]
    return ", ".join(stated or older) or "not stated"
