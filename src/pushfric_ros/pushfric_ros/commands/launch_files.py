"""The launch descriptions of this package's launch files."""

import dataclasses
import pathlib
from collections.abc import Mapping, Sequence

from pushfric_core.bags.recorded import Recorded
from pushfric_core.bags.run_record import KEYFRAMES
from pushfric_core.cell.cell_file import load_cell
from pushfric_core.cell.node_settings import PlannerConfig, ViewConfig
from pushfric_core.commands.application import AUTO_VIEW
from pushfric_core.commands.cell_options import view_at
from pushfric_core.commands.console import warn
from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_core.offline.inputs import object_of
from pushfric_ros.commands.demo import SPEED, demo_cell
from pushfric_ros.commands.recorded_run import failures, result_of, write_result
from pushfric_ros.graph import graph
from pushfric_ros.graph.graph import Launchable, NodeSpec


def _cell(values: Mapping[str, str], _: pathlib.Path) -> tuple[str, Sequence[NodeSpec]]:
    file = load_cell(pathlib.Path(values["cell"]))
    specs = graph.cell(file, values["bag"], int(values["start"]))
    return file.namespace, _with_parts(specs, file.object, values, file.view, file.planner)


def _found(values: Mapping[str, str], namespace: str) -> Sequence[str]:
    bag = pathlib.Path(values["bag"])
    found = failures(bag, namespace, result := result_of(bag))
    try:
        write_result(bag, result, found)
    except PushfricError as error:
        found.append(f"no result: {error}")
    return found


def _demo(values: Mapping[str, str], folder: pathlib.Path) -> tuple[str, Sequence[NodeSpec]]:
    cell = dataclasses.replace(demo_cell(values["object"], folder), namespace=values["namespace"])
    specs = graph.simulated_cell(cell, values["bag"], int(values["seed"]), float(values["speed"]))
    specs = specs if values["view"] else graph.unattended(specs)
    return cell.namespace, _with_parts(specs, cell.object, values, cell.view, cell.planner)


def _replay(values: Mapping[str, str], _: pathlib.Path) -> tuple[str, Sequence[NodeSpec]]:
    bag = pathlib.Path(values["bag"])
    recorded = Recorded(bag, values["namespace"] or None)
    settings = recorded.settings
    source = recorded.source(settings.with_forces)
    object_name = object_of(bag, values["object"], warn)[1]
    shown = recorded.holding(f"{source.namespace}/{KEYFRAMES}") if values["view"] else []
    specs = graph.replay(str(bag), object_name, source, float(values["rate"]), settings, shown=shown)
    return source.namespace, _with_parts(specs, object_name, values, ViewConfig(), PlannerConfig())


def _with_parts(
    specs: Sequence[NodeSpec], object_name: str, values: Mapping[str, str], shown: ViewConfig, asked: PlannerConfig
) -> Sequence[NodeSpec]:
    """The same nodes, with a view and a planner if they are asked for."""
    if values["planner"] not in ("true", "false"):
        raise InvalidInput(f"planner must be true or false, got {values['planner']!r}")
    view, planner = view_at(values["view"], shown), asked if values["planner"] == "true" else None
    return graph.with_parts(specs, object_name, view, planner)


PARTS = {
    "view": ("", f"where a browser sees the run: a port, HOST:PORT, or {AUTO_VIEW}; empty: nowhere"),
    "planner": ("false", "true: also start a node that answers planners"),
}


CELL = Launchable(
    {
        "cell": (None, "path of the cell's YAML file"),
        "bag": (None, "folder of the bag to record"),
        "start": ("1", "push of the plan to begin with"),
        **PARTS,
    },
    _cell,
    _found,
)
"""The real cell: carry out its push plan, estimate, record."""

DEMO = Launchable(
    {
        "bag": (None, "folder of the bag to record"),
        "object": ("rubber_rect4", "an object of Table 1"),
        "seed": ("0", "of the camera's noise and the operator's hand"),
        "speed": (str(SPEED), "multiple of real time"),
        "namespace": (graph.NAMESPACE, "of the cell"),
        **PARTS,
    },
    _demo,
    _found,
)
"""The whole graph on a simulated cell."""

REPLAY = Launchable(
    {
        "bag": (None, "path of the bag"),
        "object": ("", "name of an object of Table 1, or path of an object YAML; empty: the bag's own object.yaml"),
        "rate": ("1.0", "multiple of the recorded speed"),
        "namespace": ("", "of the cell, for a bag of several"),
        **PARTS,
    },
    _replay,
)
"""A bag played into a live estimator."""
