"""The topic from which planner nodes predict: the friction model of the estimate."""

import math
import time

from pushfric_core.estimation.estimate import Estimate
from pushfric_core.estimation.online_estimation import OnlineEstimation
from pushfric_core.estimation.verdict import Verdict
from pushfric_core.files.object_file import ObjectModel
from pushfric_core.mechanics.prediction import friction_model
from pushfric_msgs.msg import FrictionModel
from pushfric_ros.messages.conversions import MODEL_TOPIC, friction_model_to_msg
from pushfric_ros.node_kit.diagnostics import Diagnostics
from pushfric_ros.node_kit.qos import LATCHED

MODEL_SHARE = 0.1
"""While observations come, making models takes at most this share of the wall time: it takes longer than an estimate, and must
not delay the next ones, however slow the machine is."""


class ModelPublication:
    """Publishes the model of the present estimate; it is latched, so that a late planner gets the last one.

    Args:
        topics: of the node.
    """

    def __init__(self, topics: Diagnostics) -> None:
        self._out = topics.advertise(FrictionModel, MODEL_TOPIC, LATCHED)
        self._due = -math.inf  # the next one, while observations come; by the steady clock [s]

    def begin(self, model: ObjectModel, online: OnlineEstimation) -> None:
        """Publish the models of this object from now on; nothing is published yet."""
        self._object, self._online = model, online
        self._published: Estimate | None = None

    def keep_up(self, verdict: Verdict) -> None:
        """Publish the model while observations come, if a planner listens and not too much time goes into models."""
        if self._out.get_subscription_count() and time.monotonic() >= self._due:
            self.publish(verdict)

    def publish(self, verdict: Verdict) -> None:
        """Publish the model of the estimate on which this is the verdict, unless that has been done."""
        estimate = self._online.estimate
        if estimate is not None and estimate is self._published:
            return
        begin = time.monotonic()
        model = friction_model(estimate) if estimate is not None and self._online.usable else None
        self._out.publish(friction_model_to_msg(self._object.name, self._object.outline, estimate, model, verdict))
        self._published = estimate
        self._due = time.monotonic() + (time.monotonic() - begin) / MODEL_SHARE
