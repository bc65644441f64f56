"""The planner node: the estimator's last friction model -> answers to planners, a slice of a question at a time.

Each push is computed by itself, so the slices make no difference to the numbers.
"""

import math
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np
from rclpy.node import Node

from pushfric_core.cell.node_settings import PlannerConfig
from pushfric_core.geometry.outline import Outline
from pushfric_core.mechanics.prediction import FrictionModel, motion_cone, predict, stability
from pushfric_core.mechanics.quasi_static import BLOCK
from pushfric_core.mechanics.strokes import STEP, stroke_steps
from pushfric_core.trajectories.observation import check_half_width, check_planned_contacts
from pushfric_msgs.msg import Basis, LimitSurface
from pushfric_msgs.msg import FrictionModel as FrictionModelMsg
from pushfric_msgs.srv import GetLimitSurface, MotionCone, PredictPush, PredictStroke, StablePushes
from pushfric_ros.messages.conversions import (
    MODE_TO_MSG,
    MODEL_TOPIC,
    add,
    arrays_from_msg,
    friction_model_from_msg,
    limit_surface_to_msg,
    strokes_from_msg,
)
from pushfric_ros.node_kit.diagnostics import Diagnostics, Health, Level, without_publisher
from pushfric_ros.node_kit.parameters import declare
from pushfric_ros.node_kit.planner_client import QUESTIONS
from pushfric_ros.node_kit.process import PATIENT, run_node
from pushfric_ros.node_kit.qos import LATCHED
from pushfric_ros.node_kit.turns import Answer, Refuse, Turns


@dataclass(frozen=True)
class Known:
    """A model and what it rests on; at first nothing."""

    basis: Basis = field(default_factory=Basis)
    model: FrictionModel | None = None
    outline: Outline | None = None
    total_friction: float = math.nan  # [N]
    why_not: str = "no model has come yet on friction_model: is the estimator running?"
    wrong: bool = False  # it is not known because the message makes no sense

    @cached_property
    def limit_surface(self) -> LimitSurface:
        """The limit surface of the model, which there is; computed when it is first asked for."""
        assert self.model is not None
        return limit_surface_to_msg(self.basis, self.total_friction, self.model)

    @classmethod
    def of(cls, msg: FrictionModelMsg) -> "Known":
        """The model in a message."""
        basis = msg.basis
        if not basis.has_model:
            reasons = "; ".join(reason.text for reason in basis.reasons)
            return cls(basis, why_not=reasons or "there is no estimate yet; push the object first")
        try:
            model, outline = friction_model_from_msg(msg)
        except ValueError as error:
            basis.has_model = False
            return cls(basis, why_not=f"the message on friction_model is wrong: {error}", wrong=True)
        return cls(basis, model, outline, msg.total_friction)


NUMBERS = 2 * BLOCK
"""Support points times samples times pushes in a slice: some 10 ms of work."""

LEAST_STEP, LARGEST_STEP = 1e-4, 0.1
"""Limits of the step of a stroke [m]: more steps take too long, and fewer miss the corners of an object."""


class Answers:
    """The answers of a known model; each raises ValueError for a request that is wrong or too large.

    Args:
        known: the model.
        config: how large a request may be.
    """

    def __init__(self, known: Known, config: PlannerConfig) -> None:
        self._known, self._config = known, config

    def predict_push(self, request: PredictPush.Request) -> Generator[None, None, PredictPush.Response]:
        model, outline = self._asked(request.mean_only)
        response = PredictPush.Response(success=True, basis=self._known.basis)

        def take(*pushes: np.ndarray) -> None:
            found = predict(model, *pushes)
            add(response, twists=found.twists, modes=[MODE_TO_MSG[mode] for mode in found.modes], spreads=found.spread)
            add(response, forces=found.forces, covariances=found.covariance)
            if request.with_samples:
                add(response, sample_twists=found.samples.twists)

        yield from _in_slices(self._pushes(request), model, outline, take)
        if request.with_samples:
            response.weights = model.share
        return response

    def predict_stroke(self, request: PredictStroke.Request) -> Generator[None, None, PredictStroke.Response]:
        model, outline = self._asked(request.mean_only)
        self._check_number("starts", len(request.starts) // 3, "most_strokes")
        starts, lines, positions = strokes_from_msg(request)
        if request.step != 0 and not LEAST_STEP <= request.step <= LARGEST_STEP:
            raise ValueError(f"step must be 0, or {LEAST_STEP:g} to {LARGEST_STEP:g} m, got {request.step:g}")
        response = PredictStroke.Response(success=True, basis=self._known.basis)
        for rows in _slices(len(starts), model):
            found = yield from stroke_steps(model, outline, starts[rows], lines[rows], positions[rows], request.step or STEP)
            add(response, ends=found.means, covariances=found.covariance)
            if request.with_samples:
                add(response, sample_ends=found.poses)
        if request.with_samples:
            response.weights = model.share
        return response

    def motion_cone(self, request: MotionCone.Request) -> Generator[None, None, MotionCone.Response]:
        model, outline = self._asked()
        response = MotionCone.Response(success=True, basis=self._known.basis)
        pushes = self._pushes(request)
        yield from _in_slices(pushes, model, outline, lambda *at: add(response, **motion_cone(model, *at)._asdict()))
        return response

    def stable_pushes(self, request: StablePushes.Request) -> Generator[None, None, StablePushes.Response]:
        model, outline = self._asked()
        turns = self._pushes(request)
        for half_width in np.unique(turns[2]).tolist():
            check_half_width(outline, half_width)
        response = StablePushes.Response(success=True, basis=self._known.basis)
        yield from _in_slices(turns, model, outline, lambda *some: add(response, **stability(model, *some)._asdict()))
        return response

    def limit_surface(self, _: GetLimitSurface.Request) -> Generator[None, None, GetLimitSurface.Response]:
        self._asked()
        return GetLimitSurface.Response(success=True, basis=self._known.basis, limit_surface=self._known.limit_surface)
        yield  # so that this is a generator, too

    def _asked(self, mean_only: bool = False) -> tuple[FrictionModel, Outline]:
        """The model that answers, and the object's outline. Raises ValueError if there is none."""
        model, outline = self._known.model, self._known.outline
        if model is None or outline is None:
            raise ValueError(self._known.why_not)
        return (model.mean if mean_only else model), outline

    def _pushes(self, request: Any) -> list[np.ndarray]:
        """The points of a request's pushes, their normals, and what else it has of them."""
        self._check_number("contact_points", len(request.contact_points) // 2, "most_pushes")
        return arrays_from_msg(request)

    def _check_number(self, name: str, number: int, setting: str) -> None:
        most = getattr(self._config, setting)
        if number > most:
            raise ValueError(f"{name} must be at most {most} in one request (the planner's {setting}), got {number}")


def _in_slices(
    arrays: list[np.ndarray], model: FrictionModel, outline: Outline, take: Callable[..., None]
) -> Generator[None, None, None]:
    """Have pushes taken, a slice at a time, with a pause after each: their points, their normals, and what else they have."""
    for rows in _slices(len(arrays[0]), model):
        if rows.start:
            yield
        points, normals, *rest = (array[rows] for array in arrays)
        check_planned_contacts(outline, points, normals, rows.start)
        take(points, normals, *rest)


def _slices(count: int, model: FrictionModel) -> Iterator[slice]:
    """The slices of a number of pushes."""
    step = max(1, NUMBERS // model.with_mean[0].size)
    return (slice(start, start + step) for start in range(0, count, step))


class PlannerNode(Node):
    """Answers planners from the last friction model: where pushes lead, which hold the object, and its limit surface."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("planner", **kwargs)
        self._config = declare(self, PlannerConfig)
        self._known = Known()
        self._diagnostics = topics = Diagnostics(self, self._health)
        topics.subscribe(FrictionModelMsg, MODEL_TOPIC, self._on_model, LATCHED)
        self._turns = Turns(self, self._config.longest)
        for name, kind in QUESTIONS.items():
            self._turns.serve(kind, f"~/{name}", partial(self._begin, name, kind))

    def _begin(self, name: str, kind: Any, request: Any) -> tuple[Answer, Refuse]:
        """Begin the work for a request of a service, by what is known then, whatever comes later; and how to refuse it."""
        known = self._known
        answer = getattr(Answers(known, self._config), name)(request)
        return answer, lambda reason: kind.Response(message=reason, basis=known.basis)

    def _on_model(self, msg: FrictionModelMsg) -> None:
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
