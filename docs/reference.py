"""Writes what docs/interfaces.md says of every node, as the nodes tell, the keys of a cell's file, and a verdict's codes."""

import dataclasses
import pathlib
import re
import sys
import textwrap
from collections.abc import Iterable

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))  # started as `python docs/reference.py`, from any folder

from docs.described_nodes import Description, as_yaml, describe
from docs.markdown import replaced, table
from pushfric_core import settings
from pushfric_core.bags.constants import FOLDER
from pushfric_core.cell.cell_file import ROOT, SECTIONS, driver_kinds
from pushfric_core.plugins import PUSHERS, plugin
from pushfric_core.vision.sighting import UNMEASURED
from pushfric_ros.arms.arm import ArmConfig
from pushfric_ros.graph.graph import NAMESPACE
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE

COMMAND = "python docs/reference.py"

BEGIN, END = f"<!-- The tables below are written by `{COMMAND}`. -->\n", "<!-- End of these tables. -->\n"

HEAD = f"""\
# Interfaces of every node

Written by `{COMMAND}`; do not edit.
[graph.md](graph.md) explains the nodes and topics.

Names are relative to the cell's namespace, `{NAMESPACE}` by default. All parameters but `use_sim_time` are read-only, set at
start; `ros2 param describe` has their types and ranges. [cell.md](cell.md#all-keys) describes the keys of a cell's
file. Every node publishes `/diagnostics`. The lists leave out what every ROS 2 node has, the actuator's lifecycle services, and
the topics of a bag, which the player publishes and the recorder subscribes to. `/tf` and `/tf_static` need tf2_msgs.
[src/pushfric_msgs](../src/pushfric_msgs) has the fields of all its types.

QoS: *latched* is reliable and transient local ([graph.md](graph.md)). A number is the depth, unless
it is {RELIABLE.depth} (reliable) or {LATCHED.depth} (latched). [The last table](#types) has the types.

`object_pose` is the pose of the frame `object` in `table` ([frames](conventions.md#frames)). The variance of z, roll and pitch
is {UNMEASURED:g}: they are not measured.
"""

EVERYWHERE = ("/diagnostics", "publishes")
"""Name and role of an endpoint of every node."""

CODES = (f"<!-- The table below is written by `{COMMAND}` from Reason.msg. -->\n", "<!-- End of the codes. -->\n")

COLUMNS = ("key", "default", "what")


def cell_tables() -> str:
    """A table for each section, without the rows of earlier sections, which it only names."""
    parts, earlier = [], dict[str, list[tuple[str, ...]]]()
    for name, rows in (cell_sections() | arms()).items():
        old = {row for section in earlier.values() for row in section}
        shown = [row for row in rows if row not in old]
        parts.append((f"### `{name}`\n\n" if name else "") + _repeated(rows, earlier) + table(COLUMNS, shown))
        earlier[name] = rows
    return "\n".join(parts)


def _repeated(rows: list[tuple[str, ...]], earlier: dict[str, list[tuple[str, ...]]]) -> str:
    """The section that these rows contain, or the keys that stand in another section, too."""
    if contained := [name for name, section in earlier.items() if {*section} <= {*rows}]:
        return f"The keys of `{contained[-1]}`, and\n\n"
    first = {row: name for name, section in reversed(earlier.items()) for row in section}
    keys = {name: [row[0] for row in rows if first.get(row) == name] for name in earlier}
    return "".join(f"{', '.join(names)} of `{name}`, and\n\n" for name, names in keys.items() if names)


def cell_sections() -> dict[str, list[tuple[str, ...]]]:
    """The rows of the tables; the keys outside of any section first, with an empty name."""
    return {"": _rows(ROOT)} | {name: _rows([*configs, *driver_kinds(name, {})]) for name, configs in SECTIONS.items()}


def arms() -> dict[str, list[tuple[str, ...]]]:
    """The rows of `pusher` that belong to the drivers of arms: those of any, then those of each."""
    drivers = {f"pusher: {{driver: {name}}}": _rows([plugin(PUSHERS, name)]) for name in ("twist", "trajectory")}
    return {"pusher: an arm": _rows([ArmConfig])} | drivers


def cell_page(document: str) -> str:
    """docs/cell.md with its tables replaced."""
    return replaced(document, BEGIN, END, f"\n{cell_tables()}\n")


def estimation_page(document: str) -> str:
    """docs/estimation.md with its table of codes replaced."""
    lines = re.findall(
        r"^uint8 ([A-Z_]+) = \d+ *(?:# (.*))?$", (FOLDER / "Reason.msg").read_text(encoding="utf-8"), re.MULTILINE
    )
    rows = [(f"`{code.lower()}`", meaning) for code, meaning in lines]
    return replaced(document, *CODES, f"\n{table(('code', 'meaning'), rows)}\n")


def _rows(configs: Iterable[type]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for config in configs:
        for field in dataclasses.fields(config):
            default = "*required*" if settings.is_required(field) else f"`{as_yaml(settings.plain_value(field.default))}`"
            rows.append((f"`{settings.key_of(field)}`", default, field.metadata["description"]))
    return rows


def interfaces(described: Iterable[Description]) -> str:
    """The text of docs/interfaces.md."""
    described = [*described]
    return "\n".join((HEAD, *map(section, described), types(described)))


def types(described: Iterable[Description]) -> str:
    """The type of each topic, service and action that is not named as its type."""
    named: dict[str, set[str]] = {}
    for one in described:
        for name, kind in ((endpoint.name, endpoint.type) for endpoint in one.endpoints):
            package, *_, own = kind.split("/")
            as_named = package == "pushfric_msgs" and own.lower() == name.rpartition("/")[2].replace("_", "")
            if package != "lifecycle_msgs" and not as_named:
                named.setdefault(kind.replace("/msg/", "/").replace("/srv/", "/"), set()).add(f"`{name}`")
    rows = [(kind, ", ".join(sorted(names))) for kind, names in sorted(named.items())]
    others = "Any other is named as its type in pushfric_msgs: `plan_progress` is a PlanProgress.\n"
    return f"## Types\n\n{table(('type', 'names'), rows)}\n{others}"


def section(described: Description) -> str:
    """The part of the document about one node."""
    groups: dict[tuple[str, str], list[str]] = {}
    for (role, name, kind, qos), when in described.endpoints.items():
        if (name, role) != EVERYWHERE and not kind.startswith("lifecycle_msgs/"):
            groups.setdefault((role, "; ".join(filter(None, (quality(qos), when)))), []).append(f"`{name}`")
    roles: dict[str, list[str]] = {}
    for (role, quality_and_when), names in groups.items():
        roles.setdefault(role, []).append(f"{', '.join(names)} ({quality_and_when})")
    settings = [
        (f"`{one.name}`", "*required*" if one.required else f"`{as_yaml(one.default)}`", one.description)
        for one in described.settings
    ]
    keys = {row for rows in cell_sections().values() for row in rows}
    of_cell = [row[0] for row in settings if row in keys]
    own = [row for row in settings if row[0] not in of_cell]
    parts = [f"## {described.node}\n\n{wrapped(described.summary)}\n"]
    if roles:
        parts.append("".join(f"{wrapped(f'- {role} ' + '; '.join(ends), '  ')}\n" for role, ends in roles.items()))
    if of_cell:
        parts.append(f"{wrapped('Keys of a cell: ' + ', '.join(by_section(of_cell)))}.\n")
    if own:
        parts.append(table(("parameter", "default", "what"), own))
    return "\n".join(parts)


def by_section(keys: list[str]) -> list[str]:
    """Keys of a cell's file; where a whole section is among them, its name stands for it."""
    whole = {name: {row[0] for row in rows} for name, rows in cell_sections().items() if name}
    whole = {name: section for name, section in whole.items() if section <= {*keys}}
    return [f"all of `{name}`" for name in whole] + [
        key for key in keys if not any(key in section for section in whole.values())
    ]


def quality(qos: str) -> str:
    """A quality of service in few words: see HEAD."""
    usual = {f"reliable, depth {RELIABLE.depth}": "reliable", f"reliable, transient local, depth {LATCHED.depth}": "latched"}
    return usual.get(qos, qos.replace("reliable, transient local", "latched").replace("depth ", ""))


def wrapped(paragraph: str, indent: str = "") -> str:
    """A paragraph in lines of at most 120 columns, all but the first of them indented."""
    return textwrap.fill(paragraph, 120, break_long_words=False, break_on_hyphens=False, subsequent_indent=indent)


PAGES = {"cell.md": cell_page, "estimation.md": estimation_page}
"""The pages with tables that are written here."""


if __name__ == "__main__":
    docs = pathlib.Path(__file__).parent
    (docs / "interfaces.md").write_text(interfaces(describe()), encoding="utf-8")
    for name, page in PAGES.items():
        (docs / name).write_text(page((docs / name).read_text(encoding="utf-8")), encoding="utf-8")
