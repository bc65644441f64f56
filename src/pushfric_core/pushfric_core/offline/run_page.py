"""A run as one self-contained HTML page, to be looked through and handed on."""

import base64
import csv
import dataclasses
import html
import io
import math
import os
import pathlib
import re
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

import pushfric_core
from pushfric_core.bags.recorded import Recorded
from pushfric_core.bags.run_record import PLAN, TYPES
from pushfric_core.bags.samples import stamp_from_msg
from pushfric_core.errors import PushfricError
from pushfric_core.estimation.batch import last, taken
from pushfric_core.estimation.estimate import friction_model
from pushfric_core.estimation.estimate_report import BoundsReport, EstimateReport
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.model_file import as_yaml
from pushfric_core.files.object_file import ObjectModel
from pushfric_core.geometry.table_1 import TableObject
from pushfric_core.mechanics.prediction import FrictionModel, foretold
from pushfric_core.offline.estimation import Estimation
from pushfric_core.report.figures import summary_figure, with_belief
from pushfric_core.report.ledger import rows as ledger_rows
from pushfric_core.report.page import Cell, Section, Table, number, page
from pushfric_core.report.report import to_json
from pushfric_core.report.story import RUN_PAGE, Change, Story, with_histogram
from pushfric_core.trajectories.ledger import Doubt
from pushfric_core.trajectories.observation import Observation
from pushfric_core.vision.keyframes import KEYFRAMES
from pushfric_core.wording import counted

TESTED = 0.25
"""Share of the pushes, the last ones, that are predicted from all others."""

EARLIEST = 1.1e18
"""Stamps before this time [ns] come from a simulated clock."""

FAULT = "pusher_fault"

TOLD = {PLAN: TYPES[PLAN], FAULT: "std_msgs/msg/String", KEYFRAMES: "sensor_msgs/msg/CompressedImage"}
"""Topics about a run besides its data, with their types."""

MODULES = ("drawings", "line", "play", "run", "view")
"""Modules of the page, each after those that it imports."""

FEWEST_LEARNT = 4
"""With fewer pushes to learn from, nothing is predicted."""


Show = Callable[[Change, bytes], None]


def run_page(
    estimation: Estimation,
    file: pathlib.Path | None = None,
    namespace: str | None = None,
    show: Show = lambda change, jpeg: None,
) -> str:
    """The page of an estimate: that of a live run with all of it inside, and what only its end can show.

    Args:
        estimation: with the estimates after each observation.
        file: where the page will lie; its link to the recorded data counts from there. None: nowhere.
        namespace: of the cell; None: a bag has only one.
        show: called with each change of the story, and the picture that it tells of, if any, as soon as it is known.
    """
    told, pictures = _told(estimation, namespace, show)
    data = list(estimation.estimator.observations)
    drawing = _drawing(estimation)
    for key, jpeg in pictures.items():
        told[key]["src"] = _inline("image/jpeg", jpeg)
    downloads = {
        "model.yaml": ("application/yaml", model_of(estimation)),
        "observations.csv": ("text/csv", _table_of(estimation)),
        "figure.svg": ("image/svg+xml", drawing),
    }
    sections = page(
        "pushfric_core.report",
        "run.html.j2",
        downloads=[(name, _inline(kind, text.encode())) for name, (kind, text) in downloads.items() if text],
        bag=os.path.relpath(estimation.source.resolve(), file.resolve().parent) if file else "",
        sections=[
            _predictions(estimation, data),
            Section("account", "What became of every message", "", _ledger(estimation)),
            _settings(estimation.settings),
        ],
        version=pushfric_core.__version__,
        source=estimation.source.name,
    )
    return _whole(told, sections, estimation.ledger.doubts)


def model_of(estimation: Estimation) -> str:
    """The model to keep, as YAML under what is in doubt; empty if the data contradict themselves."""
    doubts = "".join(f"# in doubt: {doubt.text}\n" for doubt in estimation.ledger.doubts)
    return doubts + as_yaml(estimation.to_model()) if estimation.result.contradiction is None else ""


def _whole(story: Change, sections: str, doubts: Sequence[Doubt]) -> str:
    """The page in one file, with its style, its modules, doubts on top, a story and more sections."""

    def read(name: str) -> str:
        return (RUN_PAGE / name).read_text(encoding="utf-8")

    # in one module nothing is imported, and a story must not end its own element
    modules = re.sub(r"^(?:import .*\n|export )", "", "".join(read(f"{name}.js") for name in MODULES), flags=re.MULTILINE)
    inside = {
        'class="waiting live"': 'class="waiting over"',
        '<link rel="stylesheet" href="style.css">': f"<style>\n{read('style.css')}</style>",
        'href="icon.svg"': f'href="{_inline("image/svg+xml", read("icon.svg").encode())}"',
        '  <script type="module" src="view.js"></script>\n': "",
        "  <main>": "".join(f'<p class="doubt">✗ {html.escape(doubt.text)}</p>\n' for doubt in doubts) + "  <main>",
        "  </main>": f"{sections}  </main>",
        "</body>": '<script type="application/json" id="story">'
        + to_json(story).replace("<", "\\u003c")
        + f'</script>\n<script type="module">\n{modules}</script>\n</body>',
    }
    whole = read("index.html")
    for part, replacement in inside.items():
        assert part in whole, part
        whole = whole.replace(part, replacement)
    return whole


def beginning(model: ObjectModel, data: Sequence[Observation]) -> tuple[Story, Change]:
    """A story of recorded observations, and the change with which it begins."""
    first = next((one.stamp for one in data if one.stamp), 0)
    when = time.strftime(" %Y-%m-%d", time.gmtime(first * 1e-9)) if first > EARLIEST else ""
    story = Story(model, f"recorded{when}")
    return story, story.begin() | {"recorded": True}


def _told(estimation: Estimation, namespace: str | None, show: Show) -> tuple[Change, dict[str, bytes]]:
    """The whole story of a run, and its pictures by their keys."""
    story, begun = beginning(estimation.model, estimation.data)
    told, pictures = Change(), dict[str, bytes]()
    data = zip(estimation.data, estimation.course, strict=True)
    following = next(data, None)
    believed = {id(estimation.course[k]) for k in with_belief(estimation.course)}
    belief: FrictionModel | None = None  # after the last push, or one of those before

    def tell(change: Change, jpeg: bytes = b"") -> None:
        show(change, jpeg)
        for key, value in change.items():
            if value is None and key != "estimate":
                del told[key]
                pictures.pop(key, None)
            else:
                told[key] = value
                if jpeg and key.startswith("picture/"):
                    pictures[key] = jpeg

    def go_on(stamp: float) -> None:
        nonlocal following, belief
        while following is not None and following[0].stamp <= stamp:
            observation, estimate = following
            tell(story.on_observation(observation))
            following = next(data, None)
            if id(estimate) in believed:
                belief = estimate.belief
            tell(story.on_estimate(EstimateReport.of(estimate, estimation.model.name, belief)) | final)

    final = {"estimate": with_histogram(estimation.figures(), BoundsReport.of(estimation.result))}
    tell(begun | final)
    for name, msg in _recorded(estimation.source, namespace):
        if name == FAULT:
            tell(story.on_fault(msg.data))
            continue
        stamp = stamp_from_msg(msg.header.stamp)
        go_on(stamp)
        if name == KEYFRAMES:
            tell(story.on_picture(stamp, len(msg.data)), bytes(msg.data))
        else:
            tell(story.on_plan(msg))
    go_on(math.inf)
    tell(story.on_settings(estimation.settings.to_text()))
    return told, pictures


def _recorded(source: pathlib.Path, namespace: str | None) -> Iterator[tuple[str, Any]]:
    """The messages about a run besides the data: names of topics without the cell's, and messages that can be read."""
    if source.suffix == ".csv":
        return
    from pushfric_core.bags.bag import Bag  # not above: a CSV needs none of its libraries

    bag = Bag(source)
    cell = Recorded(source, namespace, bag).source(with_forces=False).namespace
    there = {(topic.name, topic.type_name) for topic in bag.summary.topics}
    names = {f"{cell}/{name}": name for name, kind in TOLD.items() if (f"{cell}/{name}", kind) in there}
    for message in bag.messages(names):
        try:
            yield names[message.topic], bag.deserialize(message)
        except (ValueError, AttributeError):
            continue  # the ledger says so


def _inline(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def _predictions(estimation: Estimation, data: Sequence[Observation]) -> Section:
    """The motion of the last pushes, predicted from those before them."""
    title = "Predictions tested on the last pushes"
    pushes = list(dict.fromkeys(one.push_id for one in data))
    tested = pushes[len(pushes) - math.ceil(TESTED * len(pushes)) :]
    learnt = [one for one in data if one.push_id not in tested]
    if len(pushes) - len(tested) < FEWEST_LEARNT:
        return Section("predictions", title, f"Not tested: fewer than {FEWEST_LEARNT} pushes would be left to learn from.")
    estimator = dataclasses.replace(estimation.settings, kept=tuple(pushes)).new_estimator(estimation.estimator.support_points)
    try:
        before = last(list(taken(estimator.add, learnt, lambda _: None)))
        model = friction_model(before)
        found = {push: foretold(model, [one for one in data if one.push_id == push]) for push in tested}
    except PushfricError as error:
        return Section("predictions", title, f"Not tested: {error}")
    rows = [
        [
            Cell(str(push + 1)),
            Cell(str(len(one.angles))),
            *(Cell(number(math.degrees(float(value)), 1)) for value in (np.median(one.angles), np.median(one.spreads))),
            Cell(str(int(np.sum(one.angles <= one.spreads)))),
        ]
        for push, one in found.items()
    ]
    text = (
        f"The last {counted(len(tested), 'push', 'pushes')}, predicted from the {len(pushes) - len(tested)} before: the angle"
        " between the measured motion and the predicted one, as (velocity of p_CF, turn), and what 90 of 100 were claimed to"
        " stay below."
    )
    if model.limit is not None:
        text += f" {model.limit[0].upper()}{model.limit[1:]}."
    heads = ("push", "observations", "median [°]", "claimed [°]", "within")
    return Section("predictions", title, text, Table(heads, rows))


def _ledger(estimation: Estimation) -> Table:
    rows = [list(map(Cell, row)) for row in ledger_rows(estimation.ledger)]
    rows += [[Cell(f"✗ {line}")] for line in estimation.ledger.lines]
    return Table(("", *estimation.ledger.sums()), rows)


def _settings(settings: EstimatorSettings) -> Section:
    usual = EstimatorSettings().parameters()
    rows = []
    for name, value in sorted(settings.parameters().items()):
        text = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
        rows.append([Cell(name), Cell(text, tone="" if usual.get(name) == value else "better")])
    differ = any(value.tone for _, value in rows)
    text = "Those that differ from the defaults are in bold." if differ else "All are the defaults."
    return Section("settings", "Settings", text, Table(("setting", "value"), rows))


def _table_of(estimation: Estimation) -> str:
    rows = estimation.estimator.observations.to_rows()
    text = io.StringIO()
    writer = csv.DictWriter(text, rows[0])
    writer.writeheader()
    writer.writerows({name: "" if math.isnan(value) else value for name, value in row.items()} for row in rows)
    return text.getvalue()


def _drawing(estimation: Estimation) -> str:
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "figure.svg"
        draw(estimation, path)
        return path.read_text()


def draw(estimation: Estimation, path: pathlib.Path, known: TableObject | None = None) -> None:
    """The figure of a run under what is in doubt, with the truth if the object is known; raises as `summary_figure`."""
    data, doubts = estimation.estimator.observations, [one.text for one in estimation.ledger.doubts]
    summary_figure(path, estimation.model.outline, estimation.course, data, known, estimation.settings.slipping, doubts)
