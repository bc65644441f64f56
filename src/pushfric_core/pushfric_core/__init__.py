"""Friction parameters of pushed objects (Lynch 1993): pure maths, no ROS, no files, no clocks.

The names below are the public interface. Each is loaded when it is first used. So importing the package costs next to nothing,
and everything but the solvers works without numba and osqp, the packages that they need.
"""

import importlib
from typing import TYPE_CHECKING

# isort: off
if TYPE_CHECKING:
    from pushfric_core.constraint_rows import ConstraintRows as ConstraintRows
    from pushfric_core.constraints import Constraint as Constraint, functional_rows as functional_rows
    from pushfric_core.contact import PushingLine as PushingLine
    from pushfric_core.errors import (
        PushfricError as PushfricError,
        SolverFailed as SolverFailed,
        SolverUnavailable as SolverUnavailable,
        UninformativePush as UninformativePush,
    )
    from pushfric_core.estimate import Estimate as Estimate
    from pushfric_core.estimator import Estimator as Estimator, EstimatorConfig as EstimatorConfig
    from pushfric_core.limit_surface import Ellipsoid as Ellipsoid, LimitSurface as LimitSurface
    from pushfric_core.observation import Observation as Observation
    from pushfric_core.outline import Outline as Outline, Touch as Touch
    from pushfric_core.planar import Pose as Pose, Twist as Twist, Wrench as Wrench
    from pushfric_core.prediction import (
        FrictionModel as FrictionModel,
        Predictions as Predictions,
        Stability as Stability,
        motion_cone as motion_cone,
        predict as predict,
        stability as stability,
    )
    from pushfric_core.push_choice import next_pushes as next_pushes
    from pushfric_core.recognition import Hypothesis as Hypothesis, Ranking as Ranking, Recognizer as Recognizer
    from pushfric_core.region import HalfPlanes as HalfPlanes, Region as Region
    from pushfric_core.simulation import PushedObject as PushedObject, pushed_motion as pushed_motion
    from pushfric_core.solvers.program import Loss as Loss, Optimum as Optimum, Solver as Solver, Status as Status
    from pushfric_core.strokes import Strokes as Strokes, predict_strokes as predict_strokes
    from pushfric_core.support import Support as Support, SupportForces as SupportForces
    from pushfric_core.surface_models import (
        NamedEllipsoid as NamedEllipsoid,
        Quartic as Quartic,
        convex_quartic as convex_quartic,
        named_ellipsoid as named_ellipsoid,
    )
    from pushfric_core.table_1 import TABLE_1 as TABLE_1
    from pushfric_core.trajectory import Trajectory as Trajectory, TrajectoryConfig as TrajectoryConfig

# isort: on

__version__: str
"""That of the installed package: package.xml has it."""

_MODULES = {  # the same as above: a test compares them
    "constraint_rows": ["ConstraintRows"],
    "constraints": ["Constraint", "functional_rows"],
    "contact": ["PushingLine"],
    "errors": ["PushfricError", "SolverFailed", "SolverUnavailable", "UninformativePush"],
    "estimate": ["Estimate"],
    "estimator": ["Estimator", "EstimatorConfig"],
    "limit_surface": ["Ellipsoid", "LimitSurface"],
    "observation": ["Observation"],
    "outline": ["Outline", "Touch"],
    "planar": ["Pose", "Twist", "Wrench"],
    "prediction": ["FrictionModel", "Predictions", "Stability", "motion_cone", "predict", "stability"],
    "push_choice": ["next_pushes"],
    "recognition": ["Hypothesis", "Ranking", "Recognizer"],
    "region": ["HalfPlanes", "Region"],
    "simulation": ["PushedObject", "pushed_motion"],
    "solvers.program": ["Loss", "Optimum", "Solver", "Status"],
    "strokes": ["Strokes", "predict_strokes"],
    "support": ["Support", "SupportForces"],
    "surface_models": ["NamedEllipsoid", "Quartic", "convex_quartic", "named_ellipsoid"],
    "table_1": ["TABLE_1"],
    "trajectory": ["Trajectory", "TrajectoryConfig"],
}
_HOMES = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

__all__ = sorted(_HOMES)  # noqa: PLE0605 - computed, so that no name is written a third time


def __getattr__(name: str) -> object:
    if name == "__version__":
        from importlib.metadata import version

        return version(__name__)
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = globals()[name] = getattr(importlib.import_module(_HOMES[name]), name)
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES, "__version__"})
