from dataclasses import dataclass, replace

import numpy as np
import pytest
from problems import PROBLEMS, rows_of
from scipy.optimize import nnls

from pushfric_core import Constraint, ConstraintRows, Loss, Observation, Status, UninformativePush, functional_rows
from pushfric_core.estimation.estimator import Estimator, EstimatorConfig
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.geometry.planar import Twist, rotation
from pushfric_core.geometry.support import friction_directions
from pushfric_core.program.constraints import Cone, Moment


@pytest.mark.parametrize("make", PROBLEMS)
def test_noiseless_data_give_back_the_truth(make):
    problem = make()
    estimate = Estimator(problem.truth.points).add(problem.observations)
    assert estimate.status is Status.OPTIMAL
    assert np.allclose(estimate.center_of_friction, problem.truth.center_of_friction, atol=1e-4)
    assert np.allclose(estimate.w, problem.truth.weights, atol=0.02)


def test_contact_friction_reaches_the_true_coefficient():
    problem = PROBLEMS[0]()  # made with mu_c = 0.5, slipping pushes among them
    estimate = Estimator(problem.truth.points).add(problem.observations)
    assert estimate.mu_c_max == pytest.approx(0.5, abs=0.01)
    assert estimate.mu_c_p90 <= estimate.mu_c_max


def test_data_that_contradict_the_nonnegative_force_are_infeasible():
    estimator = Estimator(np.array(((-0.03, 0.0), (0.03, 0.0))))
    pulled = Observation((0.0, -0.05), (0.0, -1.0), Twist(0.0, -0.02, 0.0))
    pushed = Observation((0.0, -0.05), (0.0, -1.0), Twist(0.0, 0.02, 0.0), push_id=1)
    assert estimator.add(pushed).conflicts == ()
    estimate = estimator.add(pulled)
    assert estimate.status is Status.INFEASIBLE
    assert estimate.conflicts == (pulled,)
    assert estimate.contradiction == "no w lets the pusher push (f.n >= 0) in all of the pushes with push_id 0"
    assert estimator.add(pushed).status is Status.INFEASIBLE
    free = Estimator(np.array(((-0.03, 0.0), (0.03, 0.0))), EstimatorConfig(nonnegative_force=False))
    assert free.add(pulled).status is Status.OPTIMAL


def test_a_motion_about_a_support_is_refused_and_leaves_no_trace():
    problem = PROBLEMS[1]()
    estimator = Estimator(problem.truth.points, EstimatorConfig(cor_radius=0.0))
    before = estimator.add(problem.observations[:5])
    x, y = problem.truth.points[1]
    turn = Observation((0.05, 0.0), (0.0, -1.0), Twist(y, -x, 1.0))
    for take in (estimator.check, estimator.add):
        with pytest.raises(UninformativePush):
            take(turn)
    Estimator(problem.truth.points).check(turn)  # where supports may be free, that one is
    after = estimator.estimate()
    assert (after.data_points, after.solution.objective) == (before.data_points, before.solution.objective)
    assert list(after.w) == list(before.w)
    assert estimator.observations == tuple(problem.observations[:5])


def test_a_penalty_above_the_multiplier_gives_the_hard_optimum():
    problem = PROBLEMS[1]()
    grid = problem.outline.grid(6, 6)
    pulled = Observation((0.028, 0.0), (0.0, -1.0), Twist(0.0286, 0.0425, -1.175), push_id=99)  # w must make this one a push

    def estimated(**options):
        return Estimator(grid, EstimatorConfig(screening=False, **options)).add([*problem.observations, pulled])

    hard = estimated()
    assert hard.status is Status.OPTIMAL
    free = estimated(nonnegative_force=False)
    assert free.solution.objective < hard.solution.objective - 1e-4
    assert estimated(pull_penalty=10.0).solution.objective == pytest.approx(hard.solution.objective, rel=1e-9)
    assert free.solution.objective < estimated(pull_penalty=1e-3).solution.objective < hard.solution.objective


def test_a_center_of_friction_outside_the_supports_is_infeasible():
    problem = PROBLEMS[0]()
    estimate = Estimator(problem.truth.points, center_of_friction=(0.2, 0.0)).add(problem.observations[0])
    assert estimate.status is Status.INFEASIBLE
    assert estimate.contradiction == "no w over the support points has the centre of friction that is asked for"
    with pytest.raises(ValueError, match="center_of_friction must be two finite numbers"):
        Estimator(problem.truth.points, center_of_friction=(0.2,))


def with_force(observation, problem, total, noise=0.0, rng=None):
    """The observation with the force that a sensor would measure [N]."""
    force = -total * problem.truth.weights @ friction_directions(problem.truth.points, observation.twist)
    return replace(observation, force=tuple(force + (rng.normal(0, noise, 2) if rng is not None else 0.0)))


def test_measured_forces_give_absolute_magnitudes(rng):
    problem = PROBLEMS[2]()
    config = EstimatorConfig(terms=("moment", "force"))
    estimate = Estimator(problem.truth.points, config).add([with_force(o, problem, 3.5) for o in problem.observations])
    assert estimate.status is Status.OPTIMAL
    assert estimate.total_friction == pytest.approx(3.5, rel=1e-3)
    assert estimate.center_of_friction == pytest.approx(problem.truth.center_of_friction, abs=1e-4)
    noisy = [with_force(o, problem, 3.5, 0.1, rng) for o in problem.observations]
    assert Estimator(problem.truth.points, config).add(noisy).total_friction == pytest.approx(3.5, rel=0.05)


def test_a_measured_direction_within_its_cone_costs_nothing(rng):
    problem = PROBLEMS[2]()
    turned = []
    for o in problem.observations:
        sensed = with_force(o, problem, rng.uniform(1, 5))  # another sensor gain each time: the magnitude is not used
        turned.append(replace(sensed, force=tuple(rotation(rng.uniform(-0.1, 0.1)) @ sensed.force)))
    exact, wide = (
        Estimator(problem.truth.points, EstimatorConfig(terms=("force_angle",), force_half_angle=angle)).add(turned)
        for angle in (0.0, 0.101)
    )
    assert wide.solution.objective == pytest.approx(0.0, abs=1e-9)
    assert exact.solution.objective > 0.01


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (
            {"terms": ("moment", "moments", "x")},
            "terms must be of moment, frictionless, cone, force, force_angle, got the unknown 'moments', 'x'",
        ),
        ({"terms": ("moment", "cone")}, "the term cone needs a mu_bound, the known upper bound on mu_c, got none"),
        ({"half_width": "0.1"}, "half_width must be a finite number, got '0.1'"),
        ({"screening": "no"}, "screening must be auto or true or false, got 'no'"),
        ({"mu_bound": -1.0}, r"mu_bound must lie in \[0.0, inf\], got -1.0"),
        ({"terms": ("force",), "loss": "l2"}, "the term force needs the loss l1 and the solver simplex, got l2 and simplex"),
    ],
)
def test_bad_configurations_are_refused(change, text):
    with pytest.raises(ValueError, match=text):
        EstimatorConfig(**change)


def test_of_equally_good_weights_the_most_even_are_taken():
    problem = PROBLEMS[2]()
    push = problem.observations[0]
    points = problem.truth.points
    even = Estimator(points).add(push)
    vertex = Estimator(points, EstimatorConfig(tie_break=False)).add(push)
    assert even.status is vertex.status is Status.OPTIMAL
    assert even.solution.objective == pytest.approx(vertex.solution.objective, abs=1e-12)
    spread = [np.linalg.norm(estimate.w - 1 / len(points)) for estimate in (even, vertex)]
    assert spread[0] < 0.5 * spread[1]
    paper = {"cor_radius": 0.0}  # with all data and no support free there is only one optimum
    unique = [estimate_of(points, problem.observations, tie_break=tie_break, **paper).w for tie_break in (True, False)]
    assert unique[0] == pytest.approx(unique[1], abs=1e-6)


def estimate_of(points, observations, **settings):
    return Estimator(points, EstimatorConfig(**settings)).add(observations)


def test_the_approximate_solver_is_honest_about_its_gap():
    problem = PROBLEMS[2]()
    noisy = [
        replace(
            o, contact_point=tuple(np.array(o.contact_point) + 0.002 * np.array((-o.contact_normal[1], o.contact_normal[0])))
        )
        for o in problem.observations[:30]
    ]
    exact, approximate = (estimate_of(problem.truth.points, noisy, solver=solver) for solver in ("simplex", "osqp"))
    assert exact.status is Status.OPTIMAL
    true_gap = approximate.solution.objective - exact.solution.objective
    assert -1e-12 <= true_gap <= approximate.solution.gap + 1e-12
    assert approximate.center_of_friction == pytest.approx(exact.center_of_friction, abs=0.01)


def test_the_loss_l2_is_the_least_squares_fit():
    problem = PROBLEMS[2]()
    rng = np.random.default_rng(4)
    noisy = [replace(o, twist=Twist(*(np.array(o.twist) * (1 + rng.normal(0, 0.05, 3))))) for o in problem.observations]
    estimate = estimate_of(problem.truth.points, noisy, loss="l2", cor_radius=0.0, nonnegative_force=False)
    assert estimate.status is Status.OPTIMAL
    a = np.concatenate([rows_of(Moment(), o, problem.truth.points).a for o in noisy])
    # nonnegative least squares with the sum as one heavy row: another algorithm, on the same rows
    w, _ = nnls(np.vstack((a, 1e3 * np.ones(a.shape[1]))), np.append(np.zeros(len(a)), 1e3))
    assert estimate.w == pytest.approx(w / w.sum(), abs=1e-4)
    assert estimate.solution.objective == pytest.approx(np.sum((a @ estimate.w) ** 2))


@pytest.mark.parametrize(
    "settings",
    [
        {"pull_penalty": 0.0},
        {"terms": ("cone",), "mu_bound": 1.0, "force_weight": 0.0},
        {"terms": ("frictionless",), "force_weight": 0.0},
        {"terms": ("force_angle",), "nonnegative_force": False, "loss": "l2"},
        {"terms": ("force_angle",), "nonnegative_force": False, "solver": "osqp"},
    ],
)
def test_data_points_without_rows_or_cost_are_taken_and_excluded(settings):
    problem = PROBLEMS[0]()
    estimator = Estimator(problem.outline.grid(4, 4), EstimatorConfig(**settings))
    assert estimator.add(problem.observations[:4]).data_points == 4
    assert estimator.exclude(2).data_points == 3


@dataclass(frozen=True)
class OnAxis(Constraint):
    """Own knowledge: by symmetry, p_CF lies on a line along y; a metre off it costs `weight`."""

    x: float
    weight: float

    def rows(self, observation, forces):
        cost = np.array([self.weight])
        return ConstraintRows(forces.points[None, :, 0] - self.x, cost, cost)


@dataclass(frozen=True)
class KnownFriction(Constraint):
    """Own knowledge: the contact slides, so the force lies on the left edge of the friction cone: f . t = mu f . n."""

    mu: float
    weight: float

    def rows(self, observation, forces):
        x, y = observation.contact_normal
        return functional_rows(np.array((-y - self.mu * x, x - self.mu * y)), forces, self.weight, self.weight)


@pytest.mark.parametrize("settings", [{}, {"loss": "l2"}, {"solver": "osqp"}])
def test_a_constraint_of_ones_own_joins_the_terms(settings):
    problem = PROBLEMS[1]()
    grid = problem.outline.grid(5, 5)
    alone = Estimator(grid, EstimatorConfig(**settings)).add(problem.observations[:8]).center_of_friction
    told = alone[0] + 0.003  # which is not true
    config = EstimatorConfig(terms=("moment", OnAxis(told, 1000.0)), **settings)
    assert Estimator(grid, config).add(problem.observations[:8]).center_of_friction[0] == pytest.approx(told, abs=1e-4)


def test_a_term_of_another_package_is_chosen_by_name_and_replayed(tmp_path, install):
    (tmp_path / "own_terms.py").write_text(
        "from pushfric_core.program.constraints import Cone\n\n\ndef slippery():\n    return Cone(0.01, 1.0)\n"
    )
    install("[pushfric.terms]\nslippery = own_terms:slippery\nnone = math:pi\ngone = nowhere:gone\n", tmp_path)
    problem = PROBLEMS[1]()
    settings = EstimatorSettings.from_parameters({"terms": ["moment", "slippery"]})
    assert EstimatorSettings.from_text(settings.to_text()) == settings
    by_name, by_object = (
        Estimator(problem.truth.points, config).add(problem.observations[:8])
        for config in (settings.estimator, EstimatorConfig(terms=("moment", Cone(0.01, 1.0))))
    )
    alone = Estimator(problem.truth.points).add(problem.observations[:8])
    assert by_name.w.tolist() == by_object.w.tolist() != alone.w.tolist()
    with pytest.raises(ValueError, match=r"terms must be of moment, .*, gone, none, slippery, got the unknown 'slippy'$"):
        EstimatorConfig(terms=("slippy",))
    with pytest.raises(ValueError, match=r"term 'none' must be a Constraint, got float$"):
        EstimatorConfig(terms=("none",))
    with pytest.raises(ValueError, match=r"term 'gone' cannot be loaded from nowhere:gone: No module named 'nowhere'$"):
        EstimatorConfig(terms=("gone",))


def test_terms_are_names_or_constraints():
    with pytest.raises(ValueError, match=r"terms must be of moment, .* got the unknown 3"):
        EstimatorConfig(terms=("moment", 3))
    config = EstimatorConfig(terms=("moment", KnownFriction(0.3, 1.0)), solver="simplex", loss=Loss.L1)
    assert config == EstimatorConfig(terms=["moment", KnownFriction(0.3, 1.0)])
