"""The page of a run that is over: its story, told from the record of the run, and all of it in one file."""

import base64
import csv
import dataclasses
import io
import itertools
import math
import os
import pathlib
import re
import time
import urllib.parse
from collections import deque
from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

import pushfric_core
from pushfric_core.bags.run_record import KEYFRAMES, PLAN, TYPES
from pushfric_core.bags.samples import stamp_from_msg
from pushfric_core.errors import PushfricError
from pushfric_core.estimation.estimate import friction_model
from pushfric_core.estimation.estimate_report import BoundsReport, EstimateReport
from pushfric_core.estimation.estimator import last, taken
from pushfric_core.estimation.push_plan import number_of
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.model_file import as_yaml
from pushfric_core.files.object_file import ObjectModel
from pushfric_core.geometry.planar import Array
from pushfric_core.geometry.table_1 import TableObject
from pushfric_core.mechanics.prediction import FrictionModel, foretold
from pushfric_core.offline.estimation import Estimation
from pushfric_core.page.figure import run_figure, with_belief
from pushfric_core.page.story import RUN_PAGE, Broadcast, Change, Story, as_object, with_histogram
from pushfric_core.trajectories.ledger import DoubtCode
from pushfric_core.trajectories.observation import Observation
from pushfric_core.wording import counted

TESTED = 0.25
"""Share of the pushes, the last ones, that are predicted from all others."""

EARLIEST = 1.1e18
"""Stamps before this time [ns] come from a simulated clock."""

FAULT = "pusher_fault"

RECORD = {PLAN: TYPES[PLAN], FAULT: "std_msgs/msg/String", KEYFRAMES: "sensor_msgs/msg/CompressedImage"}
"""Topics about a run besides its data, with their types."""

MODULES = ("drawings", "line", "play", "run", "view")
"""Modules of the page, each after those that it imports."""

FEWEST_LEARNT = 4
"""With fewer pushes to learn from, nothing is predicted."""

JPEG_QUALITY = 60
"""Quality of the pictures in the file: they are to be looked at; those in the bag are to be measured in."""


def beginning(model: ObjectModel, first: Observation) -> tuple[Story, Change]:
    """A story of recorded observations, and the change with which it begins."""
    when = time.strftime(" %Y-%m-%d", time.gmtime(first.stamp * 1e-9)) if first.stamp > EARLIEST else ""
    story = Story(model, f"recorded{when}")
    return story, story.begin() | {"recorded": True}


def told_again(
    estimation: Estimation, file: pathlib.Path | None = None, figure: Figure | None = None
) -> Iterator[tuple[Change, bytes]]:
    """The story of a recorded run: its changes, each with its picture, if it tells of one; last, what only the end can tell.

    Args:
        estimation: with the estimates after each observation.
        file: where the page will lie; its link to the recorded data counts from there. None: nowhere.
        figure: `figure_of` the run, if it is there already.
    """
    source = estimation.recorded.path
    story, begun = beginning(estimation.model, estimation.data[0])
    yield begun | {"estimate": with_histogram(estimation.figures(), BoundsReport.of(estimation.result))}, b""
    believed = set(with_belief(estimation.course))
    belief: FrictionModel | None = None  # after the last push, or one of those before
    ahead = deque(enumerate(zip(estimation.data, estimation.course, strict=True)))
    for name, msg in itertools.chain(estimation.recorded.messages(RECORD), [("", None)]):
        stamp = -1 if msg is None or name == FAULT else stamp_from_msg(msg.header.stamp)
        while ahead and (msg is None or ahead[0][1][0].stamp <= stamp):
            number, (observation, estimate) = ahead.popleft()
            belief = estimate.belief if number in believed else belief
            change = story.on_observation(observation)
            bounds = BoundsReport.of(estimate, with_slips=False)
            change |= story.on_estimate(EstimateReport.of(estimate, estimation.model.name, belief, bounds=bounds))
            del change["estimate"]  # the last is told already
            yield change, b""
        if name == KEYFRAMES:
            yield story.on_picture(stamp, len(msg.data)), bytes(msg.data)
        elif name == FAULT:
            yield story.on_fault(msg.data), b""
        elif msg is not None:
            try:
                yield story.on_plan(msg), b""
            except ValueError as error:
                estimation.ledger.doubt(DoubtCode.NOT_UNDERSTOOD, f"a message of {name} is left out: {error}")
    yield story.on_settings(estimation.settings.to_text()), b""
    svg = io.StringIO()
    (figure_of(estimation) if figure is None else figure).savefig(svg, format="svg")
    files = {"model.yaml": model_of(estimation), "observations.csv": _table_of(estimation), "figure.svg": svg.getvalue()}
    yield (
        {
            "doubts": [doubt.text for doubt in estimation.ledger.doubts],
            "files": {name: text for name, text in files.items() if text},
            "data": urllib.parse.quote(os.path.relpath(source.resolve(), file.resolve().parent)) if file else "",
            "tables": {
                "predictions": _predictions(estimation),
                "account": {
                    "heads": ["", *estimation.ledger.sums()],
                    "rows": [*estimation.ledger.rows(), *([f"✗ {line}"] for line in estimation.ledger.lines)],
                },
                "settings": _settings(estimation.settings),
            },
            "made": f"Made by pushfric {pushfric_core.__version__} from {source.name}. Lengths are in mm, in the object frame;"
            " the unit of force is the support friction of the translating object.",
        },
        b"",
    )


def report(estimation: Estimation, file: pathlib.Path, figure: Figure | None = None) -> str:
    """The page of a recorded run in one file; arguments as of `told_again`."""
    told = Broadcast()
    for change, jpeg in told_again(estimation, file, figure):
        told.take(change, jpeg)
    return in_one_file(told)


def in_one_file(told: Broadcast) -> str:
    """The page with its style, its modules, its story and the pictures."""

    def read(name: str) -> str:
        return (RUN_PAGE / name).read_text(encoding="utf-8")

    pictures = {f"src/{key}": f'"{_inline("image/jpeg", _small(jpeg))}"' for key, jpeg in told.pictures.items()}
    # in one module nothing is imported, and a story must not end its own element
    modules = re.sub(r"^(?:import .*\n|export )", "", "".join(read(f"{name}.js") for name in MODULES), flags=re.MULTILINE)
    story = as_object(told.values | pictures).replace("<", "\\u003c")
    inside = {
        'class="waiting live"': 'class="waiting over"',
        '<link rel="stylesheet" href="style.css">': f"<style>\n{read('style.css')}</style>",
        'href="icon.svg"': f'href="{_inline("image/svg+xml", read("icon.svg").encode())}"',
        '  <script type="module" src="view.js"></script>\n': "",
        "</body>": f'<script type="application/json" id="story">{story}</script>\n'
        f'<script type="module">\n{modules}</script>\n</body>',
    }
    whole = read("index.html")
    for part, replacement in inside.items():
        assert part in whole, part
        whole = whole.replace(part, replacement)
    return whole


def _small(jpeg: bytes) -> bytes:
    """The same picture in fewer bytes; as it is, if it is none."""
    smaller = io.BytesIO()
    try:
        Image.open(io.BytesIO(jpeg)).save(smaller, "JPEG", quality=JPEG_QUALITY)
    except (OSError, ValueError, Image.DecompressionBombError):
        return jpeg
    return min(smaller.getvalue(), jpeg, key=len)


def _inline(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def _predictions(estimation: Estimation) -> Change:
    """The motion of the last pushes, predicted from those before them."""
    pushes: dict[int, list[Observation]] = {}
    for one in estimation.estimator.observations:
        pushes.setdefault(one.push_id, []).append(one)
    tested = dict(list(pushes.items())[len(pushes) - math.ceil(TESTED * len(pushes)) :])
    learnt = [one for one in estimation.estimator.observations if one.push_id not in tested]
    if len(pushes) - len(tested) < FEWEST_LEARNT:
        return {"text": f"Not tested: fewer than {FEWEST_LEARNT} pushes would be left to learn from."}
    estimator = dataclasses.replace(estimation.settings, kept=tuple(pushes)).new_estimator(estimation.estimator.support_points)
    try:
        model = friction_model(last(list(taken(estimator.add, learnt, lambda _: None))))
        found = {push: foretold(model, those) for push, those in tested.items()}
    except PushfricError as error:
        return {"text": f"Not tested: {error}"}
    text = (
        f"The last {counted(len(tested), 'push', 'pushes')}, predicted from the {len(pushes) - len(tested)} before: the angle"
        " between the predicted motion and the measured one, velocity and turn together, and the angle that 90 of 100 were"
        " claimed to stay below."
    )
    if model.limit is not None:
        text += f" {model.limit[0].upper()}{model.limit[1:]}."
    rows = [
        [
            number_of(push, estimation.planned),
            len(one.angles),
            _degrees(one.angles),
            _degrees(one.spreads),
            int(np.sum(one.angles <= one.spreads)),
        ]
        for push, one in found.items()
    ]
    return {"text": text, "heads": ["push", "observations", "median [°]", "claimed [°]", "within"], "rows": rows}


def _degrees(angles: Array) -> str:
    """Their median."""
    return f"{math.degrees(float(np.median(angles))):.1f}"


def _settings(settings: EstimatorSettings) -> Change:
    usual, given = EstimatorSettings().parameters(), settings.parameters()
    rows = [[name, ", ".join(map(str, one)) if isinstance(one, list) else str(one)] for name, one in sorted(given.items())]
    differ = [name for name, one in given.items() if usual.get(name) != one]
    text = "Those that differ from the defaults are in bold." if differ else "All are the defaults."
    return {"text": text, "heads": ["setting", "value"], "rows": rows, "bold": differ}


def model_of(estimation: Estimation) -> str:
    """The model to keep, as YAML under what is in doubt; empty if the data contradict themselves."""
    doubts = "".join(f"# in doubt: {doubt.text}\n" for doubt in estimation.ledger.doubts)
    return doubts + as_yaml(estimation.to_model()) if estimation.result.contradiction is None else ""


def _table_of(estimation: Estimation) -> str:
    rows = estimation.estimator.observations.to_rows()
    text = io.StringIO()
    writer = csv.DictWriter(text, rows[0])
    writer.writeheader()
    writer.writerows({name: "" if math.isnan(value) else value for name, value in row.items()} for row in rows)
    return text.getvalue()


def figure_of(estimation: Estimation, known: TableObject | None = None) -> Figure:
    """The figure of a run under what is in doubt, with the truth if the object is known."""
    data, doubts = estimation.estimator.observations, [one.text for one in estimation.ledger.doubts]
    slipping, planned = estimation.settings.slipping, estimation.planned
    return run_figure(estimation.model.outline, estimation.course, data, known, slipping, doubts, planned)
