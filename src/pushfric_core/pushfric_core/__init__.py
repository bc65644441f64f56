"""Friction parameters of pushed objects (Lynch 1993), without ROS.

What to call, by task:

- read: `load` a bag, a CSV of observations, a saved model or an object;
- learn: `Estimator.add` observations, `Estimator.estimate`; or `believe` for w and mu_c with their errors alone; `Trajectory`
  makes observations of poses and pusher states;
- use: `friction_model` of an estimate, then `predict`, `predict_strokes`, `motion_cone`, `stability`, `export`;
- choose: `next_pushes` for p_CF, `slip_pushes` for mu_c; `Recognizer` tells known objects apart;
- simulate: `PushedObject`, `pushed_motion`; with `LimitSurface`, `named_ellipsoid`.

The names below are the public interface. Each is loaded when it is first used, so importing the package costs next to nothing.
What needs an extra (bags, pictures, tables) imports its packages when it is called; if one is missing, the error names it and
the command that installs it.

Example:
    >>> from pushfric_core import TABLE_1, FrictionModel, predict
    >>> known = TABLE_1["rubber_rect4"]
    >>> push = predict(FrictionModel.of(known.support, known.mu_c), [(0.0, -0.032)], [(0.0, -1.0)], [(0.0, 0.02)])
    >>> push.modes[0].value
    'sticking'
"""

import importlib
from typing import TYPE_CHECKING

# isort: off
if TYPE_CHECKING:
    from pushfric_core.program.constraints import (
        Constraint as Constraint,
        ConstraintRows as ConstraintRows,
        functional_rows as functional_rows,
    )
    from pushfric_core.geometry.contact import PushingLine as PushingLine
    from pushfric_core.errors import (
        InvalidInput as InvalidInput,
        MissingPackage as MissingPackage,
        PushfricError as PushfricError,
        SolverFailed as SolverFailed,
        SolverUnavailable as SolverUnavailable,
        UninformativePush as UninformativePush,
    )
    from pushfric_core.belief.believe import believe as believe
    from pushfric_core.estimation.estimate import Estimate as Estimate, friction_model as friction_model
    from pushfric_core.estimation.estimator import Estimator as Estimator, EstimatorConfig as EstimatorConfig
    from pushfric_core.mechanics.limit_surface import (
        LimitSurface as LimitSurface,
        NamedEllipsoid as NamedEllipsoid,
        named_ellipsoid as named_ellipsoid,
    )
    from pushfric_core.trajectories.observation import Observation as Observation
    from pushfric_core.trajectories.observations import Observations as Observations
    from pushfric_core.offline.inputs import Recording as Recording, load as load
    from pushfric_core.formats.export import export as export
    from pushfric_core.geometry.outline import Outline as Outline, Touch as Touch
    from pushfric_core.geometry.planar import Pose as Pose, Twist as Twist, Wrench as Wrench
    from pushfric_core.mechanics.prediction import (
        FrictionModel as FrictionModel,
        Predictions as Predictions,
        Stability as Stability,
        motion_cone as motion_cone,
        predict as predict,
        stability as stability,
    )
    from pushfric_core.estimation.push_choice import next_pushes as next_pushes
    from pushfric_core.estimation.push_choice import slip_pushes as slip_pushes
    from pushfric_core.estimation.recognition import Hypothesis as Hypothesis, Ranking as Ranking, Recognizer as Recognizer
    from pushfric_core.estimation.region import HalfPlanes as HalfPlanes, Region as Region
    from pushfric_core.mechanics.simulation import PushedObject as PushedObject, pushed_motion as pushed_motion
    from pushfric_core.solvers.program import Loss as Loss, Optimum as Optimum, Solver as Solver, Status as Status
    from pushfric_core.mechanics.strokes import Strokes as Strokes, predict_strokes as predict_strokes
    from pushfric_core.geometry.support import Support as Support, SupportForces as SupportForces
    from pushfric_core.geometry.table_1 import TABLE_1 as TABLE_1
    from pushfric_core.trajectories.samples import (
        PoseSample as PoseSample,
        PusherSample as PusherSample,
        TrajectoryConfig as TrajectoryConfig,
    )
    from pushfric_core.trajectories.trajectory import Trajectory as Trajectory

# isort: on

__version__: str
"""That of the installed package: package.xml has it."""

_MODULES = {  # the same as above: a test compares them
    "program.constraints": ["Constraint", "ConstraintRows", "functional_rows"],
    "geometry.contact": ["PushingLine"],
    "errors": ["InvalidInput", "MissingPackage", "PushfricError", "SolverFailed", "SolverUnavailable", "UninformativePush"],
    "belief.believe": ["believe"],
    "estimation.estimate": ["Estimate", "friction_model"],
    "estimation.estimator": ["Estimator", "EstimatorConfig"],
    "mechanics.limit_surface": ["LimitSurface", "NamedEllipsoid", "named_ellipsoid"],
    "trajectories.observation": ["Observation"],
    "trajectories.observations": ["Observations"],
    "offline.inputs": ["Recording", "load"],
    "formats.export": ["export"],
    "geometry.outline": ["Outline", "Touch"],
    "geometry.planar": ["Pose", "Twist", "Wrench"],
    "mechanics.prediction": [
        "FrictionModel",
        "Predictions",
        "Stability",
        "motion_cone",
        "predict",
        "stability",
    ],
    "estimation.push_choice": ["next_pushes", "slip_pushes"],
    "estimation.recognition": ["Hypothesis", "Ranking", "Recognizer"],
    "estimation.region": ["HalfPlanes", "Region"],
    "mechanics.simulation": ["PushedObject", "pushed_motion"],
    "solvers.program": ["Loss", "Optimum", "Solver", "Status"],
    "mechanics.strokes": ["Strokes", "predict_strokes"],
    "geometry.support": ["Support", "SupportForces"],
    "geometry.table_1": ["TABLE_1"],
    "trajectories.samples": ["PoseSample", "PusherSample", "TrajectoryConfig"],
    "trajectories.trajectory": ["Trajectory"],
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
