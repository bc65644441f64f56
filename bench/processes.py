"""Processes that a benchmark starts, and what they use."""

import pathlib
from dataclasses import replace

from pushfric_core import PushfricError
from pushfric_core.cell.node_settings import PlanConfig
from pushfric_ros.commands.demo import demo_cell
from pushfric_ros.graph import graph
from pushfric_ros.graph.graph import NodeSpec
from pushfric_ros.graph.supervisor import Supervisor

OBJECT = "rubber_rect4"


def cell_of(folder: str, plan: str = "", speed: float = 1.0) -> list[NodeSpec]:
    """The nodes of the demo's cell, whose files and bag go to a folder."""
    cell = replace(demo_cell(OBJECT, pathlib.Path(folder)), plan=PlanConfig(plan=plan))
    return graph.simulated_cell(cell, f"{folder}/bag", seed=0, speed=speed)


class Run(Supervisor):
    """Runs nodes, and keeps what they print."""

    def __init__(self, specs: list[NodeSpec]) -> None:
        self._said: list[str] = []
        super().__init__(specs, graph.NAMESPACE, lambda name, line: self._said.append(f"{name}: {line}"))

    def finished(self) -> bool:
        """Whether the plan is finished.

        Raises:
            PushfricError: a node has failed.
        """
        ended = self.poll()
        if ended is not None and ended.code:
            raise PushfricError("\n".join([*self._said[-5:], ended.reason]))
        return ended is not None
