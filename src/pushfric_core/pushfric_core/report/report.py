"""JSON of an estimate, of a ranking and of a known object."""

import json
import math
from typing import Any

import numpy as np

from pushfric_core.estimation.recognition import Ranking
from pushfric_core.geometry.table_1 import TABLE_1


def recognition_report(ranking: Ranking) -> dict[str, Any]:
    """A ranking as the command line's JSON names it, best hypothesis first; `best` is None if none is feasible."""
    names = ("name", "fit_error", "ratio", "feasible")
    return {
        "best": ranking.best,
        "hypotheses": [{name: getattr(hypothesis, name) for name in names} for hypothesis in ranking.hypotheses],
    }


def truth(name: str) -> dict[str, Any]:
    """The true values of a simulated object of Table 1, under the same names; SI units, object frame."""
    known = TABLE_1[name]
    return {
        "center_of_friction": known.support.center_of_friction.tolist(),
        "support_points": known.support.points.tolist(),
        "w": known.support.weights.tolist(),
        "mu_c": known.mu_c,
    }


def to_json(figures: Any) -> str:
    """JSON on one line; infinite numbers and NaN become the strings "inf", "-inf" and "nan"."""
    return json.dumps(_finite(figures), allow_nan=False)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_finite(item) for item in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else str(float(value))
    return value.item() if isinstance(value, np.generic) else value
