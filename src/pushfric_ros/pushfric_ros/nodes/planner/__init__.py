"""The planner node: the estimator's last friction model -> answers to planners."""

from collections.abc import Callable
from typing import Any

from rclpy.node import Node

from pushfric_core.cell.node_settings import PlannerConfig
from pushfric_msgs.msg import FrictionModel
from pushfric_ros.messages.conversions import MODEL_TOPIC
from pushfric_ros.node_kit.diagnostics import Diagnostics, Health, Level, without_publisher
from pushfric_ros.node_kit.parameters import declare
from pushfric_ros.node_kit.planner_client import QUESTIONS
from pushfric_ros.node_kit.process import PATIENT, run_node
from pushfric_ros.node_kit.qos import LATCHED
from pushfric_ros.node_kit.turns import Answer, Refuse, Turns
from pushfric_ros.nodes.planner.answers import Answers, Known


class PlannerNode(Node):
    """Answers planners from the last friction model: where pushes lead, which hold the object, and its limit surface."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("planner", **kwargs)
        self._config = declare(self, PlannerConfig)
        self._known = Known()
        self._diagnostics = topics = Diagnostics(self, self._health)
        topics.subscribe(FrictionModel, MODEL_TOPIC, self._on_model, LATCHED)
        self._turns = Turns(self, self._config.longest)
        for name, kind in QUESTIONS.items():
            self._turns.serve(kind, f"~/{name}", self._begins(name, kind))

    def _begins(self, name: str, kind: Any) -> Callable[[Any], tuple[Answer, Refuse]]:
        """Functions that begin and refuse the work for a request of a service: by what is known then, whatever comes later."""

        def begin(request: Any) -> tuple[Answer, Refuse]:
            known = self._known
            answer = getattr(Answers(known, self._config), name)(request)
            return answer, lambda reason: kind.Response(message=reason, basis=known.basis)

        return begin

    def _on_model(self, msg: FrictionModel) -> None:
        self._known = Known.of(msg)

    def _health(self) -> Health:
        basis, turns = self._known.basis, self._turns
        values = {"object": basis.object, "observations": basis.data_points}
        values |= {name: getattr(turns, name) for name in ("answered", "refused", "dropped", "waiting")}
        if silent := without_publisher(self):
            return Health(Level.WARN, f"no publisher of {', '.join(silent)}", values)
        if self._known.wrong:
            return Health(Level.ERROR, self._known.why_not, values)
        return Health(Level.OK, "answering" if self._known.model is not None else self._known.why_not, values)


def main() -> None:
    run_node(PlannerNode, niceness=PATIENT)
