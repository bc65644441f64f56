import gzip

import numpy as np
import pytest

from bench.public import zhou2015
from pushfric_core import FrictionModel, Support, friction_model
from pushfric_core.bags.recorded import Recorded
from pushfric_core.errors import InvalidInput
from pushfric_core.estimation.estimator import Estimator, EstimatorConfig
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.object_file import OBJECT_FILE, load_object
from pushfric_core.mechanics.prediction import predict

LOGS = {"30_90_30_30_30_90__exp_08_11_50_mixed.txt": 5.2, "patch__exp_08_18_1435_50.txt": 3.5}
"""Reference: distance of p_CF from (50, 50) mm with plain moment rows on a 55-point grid [mm]."""


def test_real_pushes_give_their_centre_of_friction(real_pushes, tmp_path):
    written = {w.path.name: w.path for w in zhou2015.import_pushes(real_pushes / "push_points.csv", tmp_path / "csv")}
    for log, reference in LOGS.items():
        zhou2015.import_pushes(real_pushes / "logs" / f"{log}.gz", tmp_path / log)
        bag = written[log.removesuffix(".txt")]
        model = load_object(str(bag / OBJECT_FILE))
        from_log, data = (
            Recorded(one).read(model, EstimatorSettings(), pytest.fail).observations for one in (tmp_path / log, bag)
        )
        assert sorted(one.push_id for one in from_log) == [one.push_id for one in data]
        errors = [
            1e3 * np.hypot(*(Estimator(model.support_points, config).add(data).center_of_friction - 0.05))
            for config in (EstimatorConfig(cor_radius=0.0), EstimatorConfig())
        ]
        assert len(model.support_points) == 55
        assert len(data) == 50
        assert errors[0] == pytest.approx(reference, abs=0.1)
        assert errors[1] < 5  # with supports free near the centre of rotation


def support_points(log, support):
    """The support points of a log's object (n, 2) [m]; None if its name does not tell the true ones."""
    if support == "grid_55":
        return zhou2015.object_on(log).support_points
    digits = [int(part) for part in log.split("__")[0].split("_") if part.isdigit()]
    return np.reshape(digits, (2, 3)).T * 1e-3 if len(digits) == 6 else None


def test_real_pushes_that_were_not_fitted_are_predicted(real_pushes):
    """Better than by even pressure with the same mu_c; angles of motions (v at the middle, 50 mm omega)."""
    even = np.array([(x, y) for x in np.arange(0.0025, 0.15, 0.005) for y in np.arange(0.0025, 0.15, 0.005) if x + y < 0.15])
    errors = {"learned": [], "even": []}
    for log, pushes in zhou2015.read_push_points(real_pushes / "push_points.csv").items():
        chosen = np.random.default_rng(len(errors["even"])).permutation(len(pushes))
        fitted, others = ([pushes[index] for index in half] for half in np.array_split(chosen, 2))
        model = friction_model(Estimator(zhou2015.object_on(log).support_points).add(fitted))
        flat = Support(even, np.full(len(even), 1 / len(even)))
        models = {"learned": model, "even": FrictionModel.of(flat, model.median_mu_c)}
        names = ("contact_point", "contact_normal", "tip_velocity", "twist")
        points, normals, velocities, truth = (np.array([getattr(one, name) for one in others]) for name in names)
        for name, one in models.items():
            a, b = (
                np.column_stack((t[:, :2] + t[:, 2:] * (-0.05, 0.05), 0.05 * t[:, 2]))
                for t in (predict(one, points, normals, velocities).twists, truth)
            )
            cosines = np.sum(a * b, axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
            errors[name].append(np.degrees(np.median(np.arccos(np.clip(cosines, -1, 1)))))
    assert np.median(errors["learned"]) < 8 < np.median(errors["even"])


@pytest.mark.parametrize("support", ["true", "grid_55"])
def test_the_defaults_find_the_centre_of_friction_of_real_objects(real_pushes, support):
    """By the published table; `test_a_log_agrees_with_the_published_push_points` has the logs."""
    logs = zhou2015.read_push_points(real_pushes / "push_points.csv")
    points = {log: support_points(log, support) for log in logs}

    def errors(config):
        return [
            1e3 * np.hypot(*(Estimator(points[log], config).add(data).center_of_friction - 0.05))
            for log, data in logs.items()
            if points[log] is not None
        ]

    found = errors(EstimatorConfig())
    assert np.median(found) < 3
    assert max(found) < 5.2
    if support == "true":
        assert np.median(errors(EstimatorConfig(terms=("moment", "force")))) < 2.5


def test_a_log_agrees_with_the_published_push_points(real_pushes):
    tables = zhou2015.read_push_points(real_pushes / "push_points.csv")
    for log, table in tables.items():
        found = zhou2015.read_log(real_pushes / "logs" / f"{log}.gz")
        assert [o.push_id for o in found] == [o.push_id for o in table]
        for mine, theirs in zip(found, table, strict=True):
            assert mine.contact_point == pytest.approx(theirs.contact_point, abs=1e-4)
            assert mine.contact_normal == pytest.approx(theirs.contact_normal, abs=1e-5)
            assert np.allclose(mine.twist[:2], theirs.twist[:2], atol=2e-6)
            assert mine.twist.omega == pytest.approx(theirs.twist.omega, abs=2e-4)
            assert np.hypot(*np.subtract(mine.force, theirs.force)) < 0.02 * np.hypot(*theirs.force)


def log_of_one_push():
    """A finger pushes the lower edge upward by 10 mm at x = 50 mm; the object translates."""
    lines = ["1", "500 100 0 1 0 0 0", "500 110 0 1 0 0 0", "5"]
    lines += [f"{t} {-f} {-f}" for t, f in ((0, 0), (1, 0), (2, 1), (2.4, 2), (3, 2))]
    lines += ["3"] + [f"{t} 550 {y} 20 1 0 0 0" for t, y in ((0, 80), (2, 100), (3, 110))]
    return "\n".join(lines) + "\n"


def test_a_synthetic_log_of_one_push_is_read(tmp_path):
    (tmp_path / "box__exp.txt").write_text(log_of_one_push())
    (push,) = zhou2015.read_log(tmp_path / "box__exp.txt")
    assert push.contact_point == pytest.approx((0.05, 0.0))
    assert push.contact_normal == pytest.approx((0, -1))
    assert push.twist == pytest.approx((0, 0.01, 0))
    assert push.stamp == 2_500_000_000
    # in the tool's frame, which is the table's here; without the reading of 1, while it builds up
    assert push.force == pytest.approx((2 * np.sqrt(2), 0), abs=1e-9)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("hello", "not a log of zhou2015"),
        (log_of_one_push()[:60], "ends in the middle of a push"),
        ("", "ends in the middle of a push"),
        (log_of_one_push().replace(" 550 ", " 450 "), "no push met an edge"),
        # no reading once the force has built up
        (log_of_one_push().replace("2.4 ", "2.1 ").replace("\n3 -2 -2", "\n2.2 -2 -2"), "no push met an edge"),
    ],
)
def test_broken_logs_are_refused(tmp_path, text, error):
    (tmp_path / "log.txt").write_text(text)
    with pytest.raises(InvalidInput, match=error):
        zhou2015.read_log(tmp_path / "log.txt")


def test_a_broken_archive_is_refused(tmp_path):
    (tmp_path / "log.txt.gz").write_bytes(gzip.compress(b"1")[:-4])
    with pytest.raises(InvalidInput, match="not a log of zhou2015"):
        zhou2015.read_log(tmp_path / "log.txt.gz")


def test_other_tables_are_refused(tmp_path):
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InvalidInput, match="missing column object, log, push"):
        zhou2015.import_pushes(tmp_path / "other.csv", tmp_path / "bag")
    with pytest.raises(InvalidInput, match=r"none\.csv: cannot be read: No such file"):
        zhou2015.import_pushes(tmp_path / "none.csv", tmp_path / "bag")
