"""A planner node's knowledge of an object: the last model that it received."""

import math
from dataclasses import dataclass, field
from functools import cached_property

from pushfric_core.geometry.outline import Outline
from pushfric_core.mechanics.prediction import FrictionModel
from pushfric_msgs.msg import Basis, LimitSurface
from pushfric_msgs.msg import FrictionModel as FrictionModelMsg
from pushfric_ros.messages.conversions import friction_model_from_msg, limit_surface_to_msg


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
