"""What the estimates are worth on public pushes: p_CF and mu_c of every set, and whole strokes that were not fitted.

A set is fitted to half of its strokes, and to some choices of FEW of these; the strokes of the other half are rolled out. The
others that predict have the mu_c of the fit: uniform pressure, and its ellipsoid. What a set has of models that their authors
fitted to force and motion is compared on the same strokes.
"""

import itertools
import math
import pathlib
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from bench.display import Figures, plain_tables
from bench.paper.pushes import estimated
from bench.public import zhou2015
from bench.public.mitpush import POLY4
from bench.public.strokes import STROKES, Stroke, observed, read_strokes
from docs.markdown import table
from pushfric_core import Estimate, InvalidInput, Observation, PushingLine, Support, believe
from pushfric_core.bags.recorded import Recorded
from pushfric_core.estimation.picture import draw_support_friction
from pushfric_core.files.disk import write_whole
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.figure_file import save_figure
from pushfric_core.files.object_file import OBJECT_FILE, ObjectModel, load_object
from pushfric_core.geometry import planar
from pushfric_core.geometry.contact import tangent
from pushfric_core.geometry.outline import Outline, Touch
from pushfric_core.geometry.planar import Array, Pose, Twist, rotation, transform
from pushfric_core.mechanics.limit_surface import NamedEllipsoid, named_ellipsoid
from pushfric_core.mechanics.prediction import ELLIPSE, ELLIPSOID, FrictionModel
from pushfric_core.mechanics.simulation import TOUCHING
from pushfric_core.mechanics.strokes import STEP, Strokes, predict_strokes

FEW, DRAWS = 10, 6
"""Number of strokes, and of random choices of so many."""

ROLLED = 70
"""At most this many strokes of a set are rolled out."""

BACK = 0.1
"""The line of the tip begins this far behind the place where the stroke begins [m]: clear of the object."""

LARGEST_START_GAP = 0.005
"""A stroke whose tip is farther from the outline when it begins, or as deep in it, is no push [m]: its poses are mistaken."""

ESTIMATED = 8
"""So many columns of the table, the first ones, are about the estimate."""

STRETCH = 0.01
"""The belief takes strokes in steps of about this much of the tip's way [m]: the quasi-static motion hardly changes within."""

FINE = 30
"""Points in a row of the uniform pressure."""

CONTENDERS = {
    "half": "pushfric",
    "few": f"pushfric, {FEW} strokes",
    "uniform": "uniform",
    "ellipsoid": "its ellipsoid",
    "zhou_ellipsoid": "Zhou's ellipsoid",
    "zhou_quartic": "Zhou's quartic",
}
"""Who predicts, and what a table calls them."""

MU_C = {"mu_c": "value", "mu_c_low": "low", "mu_c_high": "high"}
"""Figures about mu_c, and the fields of `MuC`."""


class PublicSet(NamedTuple):
    """The pushes of one object on one surface."""

    folder: str
    name: str
    model: ObjectModel
    strokes: Sequence[Stroke]
    data: Sequence[Observation]  # of the strokes that are observations
    steps: Sequence[Sequence[Observation]]  # of each stroke, whether or not it is an observation
    groups: Sequence[int]  # each stroke's push, or the run to which it belongs: fitted or rolled out together
    quartic: Sequence[Pose | None]  # where a published quartic predicts each stroke to end

    @property
    def label(self) -> Array:
        """p_CF (2,) [m] if the pressure is even: the centroid of the outline."""
        return np.array(self.model.outline.polygon.centroid.coords[0])


def measure(sets: Sequence[PublicSet], plot: pathlib.Path, progress: Callable[[str], None]) -> Figures:
    """All figures of each set, in m and rad; None: not told, or not stored.

    Args:
        sets: from `sets_in`.
        plot: file for the figure; the table goes next to it, as Markdown, and a gallery of the estimates.
        progress: called with the name of each set.
    Returns:
        {"sets": [{"folder", "set", "strokes", "data_points", "p_cf_error", "program_error", "radius", "held", "mu_c",
        "mu_c_low", "mu_c_high", "few": [{"p_cf_error", "radius", "held"}], "rolled", "within": {"half", "few"}, "errors":
        {contender: {"position", "angle", "combined"}}}], "surfaces": [{"object", "sets", "apart", "agree"}]}; "radius" is
        that of the 90 % ellipse, "few" has FEW strokes each, "within" is the share of the strokes rolled out that end in
        the 90 % region claimed for them, and "surfaces" compares p_CF of one object in two sets.
    Raises:
        InvalidInput: a figure or the table cannot be written.
    """
    rows, estimates = [], []
    for number, one in enumerate(sets):
        progress(f"public pushes: {one.name}")
        found = {row: line_of(stroke, one.model.outline) for row, stroke in enumerate(one.strokes)}
        lines = {row: line for row, line in found.items() if line is not None}  # the strokes that begin at the outline
        estimates.append((estimated(one.data, one.model.support_points)[1], believed(one, list(lines))))
        rows.append(_measured(one, *estimates[-1], lines, np.random.default_rng(number)))
    draw_errors(rows, plot)
    gallery(sets, estimates, plot.with_stem(f"{plot.stem}_gallery"))
    write_whole(plot.with_suffix(".md"), table(*_cells(rows)))
    return {"sets": rows, "surfaces": list(_surfaces(sets, [belief for _, belief in estimates]))}


def tables(figures: Figures) -> Iterator[Table]:
    """What was estimated, and how strokes were foretold, by set and folder; and the objects of two sets."""
    heads, rows = _cells(figures["sets"])
    for title, shown in (
        ("what was estimated [mm]", heads[:ESTIMATED]),
        ("strokes that were not fitted: position [mm], angle [degrees], both combined [mm]", (heads[0], *heads[ESTIMATED:])),
    ):
        lines = (dict(zip(heads, row, strict=True)) for row in rows)
        yield from plain_tables(f"Public pushes: {title}", [{head: line[head] for head in shown} for line in lines])
    if figures["surfaces"]:
        yield from plain_tables("Public pushes: one object in two sets", figures["surfaces"])


def _surfaces(sets: Sequence[PublicSet], beliefs: Sequence[FrictionModel]) -> Iterator[Figures]:
    """Whether the regions of two sets of one object, on two surfaces, allow that its p_CF is the same."""
    for (one, first), (other, second) in itertools.combinations(zip(sets, beliefs, strict=True), 2):
        if (one.folder, one.model.name) == (other.folder, other.model.name):
            apart = first.center_of_friction - second.center_of_friction
            agree = bool(apart @ np.linalg.solve(first.covariance + second.covariance, apart) <= ELLIPSE)
            yield {"object": one.model.name, "sets": [one.name, other.name], "apart": float(np.hypot(*apart)), "agree": agree}


def sets_in(folder: pathlib.Path) -> list[PublicSet]:
    """The sets of a folder: CSV files as `import mitpush` and `import cpush` write them, bags as `import zhou2015` writes
    them, or push_points.csv.

    Raises:
        InvalidInput: there is none, or one cannot be read.
    """
    found = [_of_strokes(path) for path in sorted(folder.glob(f"*{STROKES}"))]
    for bag in sorted(path.parent for path in folder.glob(f"*/{OBJECT_FILE}")):
        model = load_object(str(bag / OBJECT_FILE))
        data = Recorded(bag).read(model, EstimatorSettings(), lambda line: None).observations
        found.append(_of_observations(folder.name, bag.name, model, data))
    if (table := folder / "push_points.csv").is_file():
        for log, data in zhou2015.read_push_points(table).items():
            found.append(_of_observations(folder.name, pathlib.Path(log).stem, zhou2015.object_on(log), data))
    if not found:
        raise InvalidInput(f"{folder}: no *{STROKES}, no bags and no push_points.csv; expected what `import` writes")
    return found


def _of_strokes(path: pathlib.Path) -> PublicSet:
    name = path.name.removesuffix(STROKES)
    model = load_object(str(path.with_name(f"{name.rpartition('_')[2]}.yaml")))
    strokes = read_strokes(path)
    data = list(observed(strokes, model.outline))
    other = path.with_name(f"{name}{POLY4}")
    quartic = {(one.before, one.tip_before): one.predicted for one in (read_strokes(other) if other.is_file() else ())}
    runs = [row if one.run is None else one.run for row, one in enumerate(strokes)]
    steps = [list(_steps(one, model.outline, run)) for one, run in zip(strokes, runs, strict=True)]
    ends = [quartic.get((one.before, one.tip_before)) for one in strokes]
    return PublicSet(path.parent.name, name, model, strokes, data, steps, runs, ends)


def _steps(stroke: Stroke, outline: Outline, push_id: int) -> Iterator[Observation]:
    """A stroke in steps of about STRETCH: what the belief takes of it, with the object on the screw between the poses seen."""
    motion = planar.log(planar.compose(planar.inverse(stroke.before), stroke.after))
    way = np.subtract(stroke.tip_after, stroke.tip_before)
    count = max(1, math.ceil(float(np.linalg.norm(way)) / STRETCH))
    for step in range(count if any(motion) else 0):
        share = (step + 0.5) / count
        pose = planar.compose(stroke.before, planar.exp(motion, share))
        touch = outline.nearest(transform(planar.inverse(pose), np.add(stroke.tip_before, share * way)))
        tip = rotation(-pose.theta) @ way / count
        turned = Twist(*(value / count for value in motion))
        yield Observation(touch.point, touch.normal, turned, push_id, duration=1.0, stamp=step + 1, tip_velocity=tip)


def _of_observations(folder: str, name: str, model: ObjectModel, data: Sequence[Observation]) -> PublicSet:
    """Short strokes of a thin tip: halfway, the tip is at the contact of the observation."""
    known = [one for one in data if one.tip_velocity is not None]
    strokes = []
    for one in known:
        begin, end = (np.add(one.contact_point, np.multiply(half, one.tip_velocity)).tolist() for half in (-0.5, 0.5))
        before, after = planar.exp(one.twist, -0.5), planar.exp(one.twist, 0.5)
        strokes.append(Stroke(before, after, tuple(begin), tuple(end), tip_radius=0.0))
    groups = [one.push_id for one in known]
    return PublicSet(folder, name, model, strokes, known, [[one] for one in known], groups, [None] * len(known))


class Line(NamedTuple):
    """A stroke as `predict_strokes` takes it."""

    pose: Pose
    line: PushingLine
    begin: float  # stroke position where the tip is, or touches [m]
    end: float


def line_of(stroke: Stroke, outline: Outline) -> Line | None:
    """None if the stroke does not begin at the outline, or passes by."""
    shift = _to_outline(stroke, outline)
    if np.hypot(*shift) > LARGEST_START_GAP:
        return None
    way = np.subtract(stroke.tip_after, stroke.tip_before)
    length = float(np.linalg.norm(way))
    origin, direction = stroke.tip_before + shift - BACK * way / length, way / length
    line = PushingLine((float(origin[0]), float(origin[1])), (float(direction[0]), float(direction[1])), stroke.tip_radius)
    touch = line.touch(outline, stroke.before)
    if touch is None or touch.distance >= BACK + length:
        return None
    return Line(stroke.before, line, min(touch.distance, BACK), BACK + length)


def _to_outline(stroke: Stroke, outline: Outline) -> Array:
    """From the tip to where it touches when the stroke begins (2,) [m]: what lies between is an error of the poses.

    The thin tip of a stroke that was made from an observation touches halfway, and is left where it is.
    """
    if not stroke.tip_radius:
        return np.zeros(2)
    touch = outline.nearest(transform(planar.inverse(stroke.before), stroke.tip_before))
    return rotation(stroke.before.theta) @ touch.normal * (stroke.tip_radius - touch.distance)


def believed(one: PublicSet, rows: Sequence[int]) -> FrictionModel:
    """The belief after some strokes of a set."""
    found = believe(one.model.support_points, [step for row in rows for step in one.steps[row]])
    assert found is not None, f"{one.name}: no stroke moves the object"
    return found


def _measured(
    one: PublicSet, whole: Estimate, belief: FrictionModel, lines: dict[int, Line], rng: np.random.Generator
) -> Figures:
    outline = one.model.outline
    groups = rng.permutation(sorted({one.groups[row] for row in lines}))
    fitted = set(groups[: len(groups) // 2].tolist())
    half = [row for row in lines if one.groups[row] in fitted]
    rows = rng.permutation([row for row in lines if one.groups[row] not in fitted])[:ROLLED].tolist()
    by_half = believed(one, half)
    by_few = [believed(one, rng.permutation(half)[:FEW].tolist()) for _ in range(DRAWS)]
    figures: Figures = {
        "folder": one.folder,
        "set": one.name,
        "strokes": len(one.strokes),
        "data_points": len(one.data),
        "program_error": float(np.hypot(*(whole.center_of_friction - one.label))),
        **_center(belief, one.label),
        **{key: getattr(belief.known_mu_c, name, None) for key, name in MU_C.items()},
        "few": [_center(model, one.label) for model in by_few],
        "rolled": len(rows),
    }
    truth = np.array([one.strokes[row].after for row in rows])
    chosen = [lines[row] for row in rows]
    even = outline.grid(FINE, FINE, 0.0)
    uniform = FrictionModel.of(Support(even, np.full(len(even), 1 / len(even))), by_half.median_mu_c)
    own = {"half": [_rolled(by_half, outline, chosen)], "few": [_rolled(model, outline, chosen) for model in by_few]}
    figures["within"] = {name: float(np.mean([_within(one, truth, by_half.length) for one in own[name]])) for name in own}
    ends = {
        **{name: [one.means for one in own[name]] for name in own},
        "uniform": [_rolled(uniform, outline, chosen).means],
        "ellipsoid": [_rolled_ellipsoid(uniform, outline, chosen)],
        "zhou_ellipsoid": _stored([one.strokes[row].predicted for row in rows]),
        "zhou_quartic": _stored([one.quartic[row] for row in rows]),
    }
    figures["errors"] = {name: mean_errors(found, truth, by_half.length) if found else None for name, found in ends.items()}
    return figures


def _center(model: FrictionModel, label: Array) -> Figures:
    """How far p_CF is off, and whether the 90 % ellipse holds the label."""
    error, square = center_off(model, label)
    return {"p_cf_error": error, "radius": model.confidence, "held": square <= ELLIPSE}


def center_off(model: FrictionModel, label: Array) -> tuple[float, float]:
    """How far p_CF is off [m], and the square of that in units of its covariance; at ELLIPSE ends the 90 % region."""
    off = model.center_of_friction - label
    return float(np.hypot(*off)), float(off @ np.linalg.solve(model.covariance, off))


def _stored(poses: Sequence[Pose | None]) -> list[Array]:
    return [] if not poses or any(pose is None for pose in poses) else [np.array(poses)]


def _rolled(model: FrictionModel, outline: Outline, chosen: Sequence[Line]) -> Strokes:
    poses, lines, _, ends = zip(*chosen, strict=True)
    return predict_strokes(model, outline, poses, lines, ends)


def _within(strokes: Strokes, truth: Array, arm: float) -> float:
    """The share of k strokes that end, at poses (k, 3), in the 90 % region claimed for them; an angle has an arm [m]."""
    off = _apart(strokes.means, truth) * (1.0, 1.0, arm)
    covariances = strokes.covariance * np.outer((1.0, 1.0, arm), (1.0, 1.0, arm)) + planar.LEAST_DIVISOR * np.eye(3)
    squares = np.sum(off * np.linalg.solve(covariances, off[..., None])[..., 0], axis=1)
    return float(np.mean(squares <= ELLIPSOID))


def _apart(poses: Array, others: Array) -> Array:
    """Differences (k, 3) of poses [m, m, rad]."""
    apart = poses - others
    apart[:, 2] = (apart[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return apart


def _rolled_ellipsoid(uniform: FrictionModel, outline: Outline, chosen: Sequence[Line]) -> Array:
    """The ends (k, 3) with the ellipsoid of a friction, by the midpoint rule as `predict_strokes`."""
    ellipsoid = named_ellipsoid(uniform.support)

    def motion(pose: Pose, line: PushingLine, touch: Touch) -> Twist:
        direction = rotation(-pose.theta) @ line.direction
        return Twist(*ellipsoid_motion(ellipsoid, uniform.median_mu_c, touch.point, touch.normal, direction).tolist())

    ends = []
    for pose, line, _, end in chosen:
        while (touch := line.touch(outline, pose)) is not None and end - touch.distance > TOUCHING:
            depth = min(end - touch.distance, STEP)
            halfway = planar.compose(pose, planar.exp(motion(pose, line, touch), depth / 2))
            then = line.touch(outline, halfway)
            turned = motion(pose, line, touch) if then is None else motion(halfway, line, then)
            pose = planar.compose(pose, planar.exp(turned, depth))
        ends.append(pose)
    return np.array(ends)


def ellipsoid_motion(ellipsoid: NamedEllipsoid, mu_c: float, point: Array, normal: Array, velocity: Array) -> Array:
    """The motion (3,) of an object with this limit surface, in closed form (Lynch, Maekawa and Tanie 1992)."""
    jacobian = np.column_stack((np.eye(2), planar.left_of(point)))
    force = np.linalg.solve(jacobian @ ellipsoid.form @ jacobian.T, velocity)
    along = tangent(normal)
    if slides := abs(force @ along) > -mu_c * (force @ normal):
        force = -normal + np.sign(force @ along) * mu_c * along
    twist = np.asarray(ellipsoid.form @ jacobian.T @ force)
    return twist * (velocity @ normal) / (jacobian @ twist @ normal) if slides else twist


def mean_errors(found: Sequence[Array], truth: Array, arm: float) -> Figures:
    """Means over strokes, of each of some predictions (k, 3) [m, rad]; an angle counts with an arm [m]."""
    apart = np.concatenate([_apart(one, truth) for one in found])
    places, turns = np.hypot(apart[:, 0], apart[:, 1]), np.abs(apart[:, 2])
    means = (float(np.mean(values)) for values in (places, turns, places + arm * turns))
    return dict(zip(("position", "angle", "combined"), means, strict=True))


def _cells(rows: Sequence[Figures]) -> tuple[list[str], list[list[str]]]:
    """The heads of the table, and its lines; the last ones are of all sets of a folder."""
    few = (f"{FEW} strokes: off", f"{FEW} strokes: held")
    heads = ["set", "strokes", "program off", "p_CF off", "held", "mu_c", *few, "within", *CONTENDERS.values()]
    lines = [[row["set"], f"{row['data_points']} of {row['strokes']}", *_summary([row], _mu_c(row))] for row in rows]
    for folder in dict.fromkeys(row["folder"] for row in rows):
        some = [row for row in rows if row["folder"] == folder]
        lines.append([f"all {len(some)} of {folder}", "", *_summary(some, "")])
    return heads, lines


def _summary(rows: Sequence[Figures], mu_c: str) -> Iterator[str]:
    """Of some sets: medians of how far p_CF is off [mm], by the program and the belief, and in how many its ellipse holds the
    label; the same learnt from FEW; how many of 100 strokes end in the region claimed, learnt from half and from FEW; and the
    mean errors of each contender [mm], [degrees], [mm]; "-" unless it predicts all of these sets.
    """
    yield f"{1e3 * float(np.median([row['program_error'] for row in rows])):.1f}"
    for told in (rows, [one for row in rows for one in row["few"]]):
        yield f"{1e3 * float(np.median([one['p_cf_error'] for one in told])):.1f}"
        held = sum(one["held"] for one in told)
        yield f"{held} of {len(told)}" if len(told) > 1 else "yes" if held else "no"
        if told is rows:
            yield mu_c
    yield ", ".join(f"{100 * float(np.mean([row['within'][name] for row in rows])):.0f}" for name in ("half", "few"))
    for name in CONTENDERS:
        found = [row["errors"][name] for row in rows]
        if None in found:
            yield "-"
            continue
        place, turn, both = (float(np.mean([one[key] for one in found])) for key in ("position", "angle", "combined"))
        yield f"{1e3 * place:.2f}, {math.degrees(turn):.2f}, {1e3 * both:.2f}"


def _mu_c(row: Figures) -> str:
    low, high = row["mu_c_low"], row["mu_c_high"]
    if low is None:
        return "-"
    return f">= {low:.2f}" if row["mu_c"] is None else f"{row['mu_c']:.2f} ({low:.2f} to {high:.2f})"


def draw_errors(rows: Sequence[Figures], path: pathlib.Path) -> None:
    """The combined error of each set by contender, as a figure.

    Raises:
        InvalidInput: it cannot be written.
    """
    figure = Figure(figsize=(9, 1.5 + 0.3 * len(rows)), layout="constrained")
    axes = figure.subplots()
    places = np.arange(len(rows))[::-1]
    for (name, label), marker in zip(CONTENDERS.items(), "oods^v", strict=True):
        known = [
            (row["errors"][name]["combined"], place) for row, place in zip(rows, places, strict=True) if row["errors"][name]
        ]
        if known:
            x, y = np.transpose(known)
            axes.plot(1e3 * x, y, marker, label=label, fillstyle="full" if name == "half" else "none")
    axes.set_yticks(places, [row["set"] for row in rows])
    axes.set(xlabel="mean error of strokes that were not fitted, position and angle [mm]", xlim=(0, None))
    axes.grid(alpha=0.3)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    save_figure(figure, path, dpi=100)


def gallery(sets: Sequence[PublicSet], estimates: Sequence[tuple[Estimate, FrictionModel]], path: pathlib.Path) -> None:
    """What was estimated of each set, as a figure: w, p_CF with its 90 % ellipse, and the centroid of the outline.

    Raises:
        InvalidInput: it cannot be written.
    """
    columns = 4
    lines = math.ceil(len(sets) / columns)
    figure = Figure(figsize=(9, 2.3 * lines), layout="constrained")
    places = figure.subplots(lines, columns, squeeze=False).ravel()
    for axes, one, (estimate, belief) in zip(places, sets, estimates, strict=False):
        draw_support_friction(axes, estimate, belief, one.model.outline)
        axes.plot(*(1e3 * one.label), "+", color="black", ms=11)
        axes.margins(0.12)
        axes.set_title(one.name.replace("__", "\n"), fontsize=8)
    for axes in places:
        axes.axis("off")
    save_figure(figure, path, dpi=100)
