"""The public names, for type checkers and for `__init__.py`, which reads here where each of them is."""

# isort: off
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
