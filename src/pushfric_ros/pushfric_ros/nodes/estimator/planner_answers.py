"""What the estimator node answers planners: where a push leads, which pushes hold the object, and its limit surface."""

import math
import time

from rclpy.node import Node

from pushfric_core.errors import PushfricError
from pushfric_core.estimation.estimate import Estimate
from pushfric_core.estimation.online_estimation import OnlineEstimation
from pushfric_core.files.object_file import ObjectModel
from pushfric_core.geometry.planar import Array
from pushfric_core.mechanics.prediction import FrictionModel, friction_model, predict, stability
from pushfric_core.trajectories.observation import check_half_width, check_planned_contact
from pushfric_msgs.msg import LimitSurface
from pushfric_msgs.srv import PredictPush, StablePushes
from pushfric_ros.messages.conversions import (
    limit_surface_to_msg,
    predictions_to_msg,
    pushes_from_msg,
    stability_to_msg,
    turns_from_msg,
)
from pushfric_ros.node_kit.diagnostics import Diagnostics
from pushfric_ros.node_kit.qos import LATCHED

ASKS_AGAIN = 2.0
"""A planner that has asked within this time [s] of wall time will ask again."""

MODEL_SHARE = 0.1
"""While data points come, making the model that answers planners takes at most this share of the wall time: it takes longer
than an estimate, and must not delay the next ones, however slow the machine is."""


class PlannerAnswers:
    """The services for planners, and the model that answers them: made from an estimate when it is needed.

    Args:
        node: offers the services.
        topics: of the node.
    """

    def __init__(self, node: Node, topics: Diagnostics) -> None:
        self._asked = self._usable_until = -math.inf  # when a planner asked last; until when its model serves; steady clock [s]
        self._limit_surface_out = topics.advertise(LimitSurface, "limit_surface", LATCHED)
        node.create_service(PredictPush, "~/predict_push", self._on_predict_push)
        node.create_service(StablePushes, "~/stable_pushes", self._on_stable_pushes)

    def begin(self, model: ObjectModel, online: OnlineEstimation) -> None:
        """Answer from the estimation of this object from now on."""
        self._object, self._online = model, online
        self.forget()

    def forget(self) -> None:
        """Make the model again before the next answer: the pushes that it rests on have changed."""
        self._model: tuple[Estimate, FrictionModel] | None = None

    def prepare(self) -> None:
        """Make the model if a planner is about to ask: after an estimate is out, and before the question."""
        if self._online.usable and time.monotonic() < self._asked + ASKS_AGAIN and self._outdated():
            self._make_model()

    def publish_limit_surface(self) -> None:
        """Publish the limit surface of the present estimate; this takes longer than a data point may wait."""
        try:
            msg = limit_surface_to_msg(*self._make_model(), self._object.name)
        except (ValueError, PushfricError):  # there is no estimate any longer, or it has no limit surface
            msg = LimitSurface(object=self._object.name)
        self._limit_surface_out.publish(msg)

    def _on_predict_push(self, request: PredictPush.Request, response: PredictPush.Response) -> PredictPush.Response:
        try:
            pushes = pushes_from_msg(request)
            estimate, model = self._asked_for(*pushes[:2])
            response.data_points = estimate.data_points
            return predictions_to_msg(predict(model, *pushes), response)
        except (ValueError, PushfricError) as error:
            response.message = str(error)
            return response

    def _on_stable_pushes(self, request: StablePushes.Request, response: StablePushes.Response) -> StablePushes.Response:
        try:
            turns = turns_from_msg(request)
            for half_width in turns[2].tolist():
                check_half_width(self._object.outline, half_width)
            estimate, model = self._asked_for(*turns[:2])
            response.data_points = estimate.data_points
            return stability_to_msg(stability(model, *turns), response)
        except (ValueError, PushfricError) as error:
            response.message = str(error)
            return response

    def _asked_for(self, points: Array, normals: Array) -> tuple[Estimate, FrictionModel]:
        """What answers a planner that asks about contacts (k, 2) [m] with these normals (k, 2), and what that rests on.

        Raises:
            ValueError: there is no estimate to predict from, or a contact is not one.
        """
        self._asked = time.monotonic()
        self._check_contacts(points, normals)
        return self._make_model() if self._model is None or self._outdated() else self._model

    def _check_contacts(self, points: Array, normals: Array) -> None:
        """Refuse contacts that are not on the object, or whose normals are wrong. Raises ValueError."""
        for number, (point, normal) in enumerate(zip(points.tolist(), normals.tolist(), strict=True)):
            try:
                check_planned_contact(self._object.outline, point, normal)
            except ValueError as error:
                raise ValueError(f"contact {number}: {error}") from error

    def _make_model(self) -> tuple[Estimate, FrictionModel]:
        """The last estimate, and the model that predicts from it.

        Raises:
            ValueError: there is no estimate to predict from.
        """
        estimate = self._online.estimate
        if estimate is None:
            raise ValueError("there is no estimate yet; push the object first")
        if estimate.contradiction is not None:
            raise ValueError(estimate.contradiction)
        if self._model is None or self._model[0] is not estimate:
            begin = time.monotonic()
            self._model = estimate, friction_model(estimate)
            self._usable_until = time.monotonic() + (time.monotonic() - begin) / MODEL_SHARE
        return self._model

    def _outdated(self) -> bool:
        """Whether the model is not to be used any longer: there is no estimate, or one that has come since, some time ago."""
        if self._model is None or not self._online.usable:
            return True
        return self._model[0] is not self._online.estimate and time.monotonic() >= self._usable_until
