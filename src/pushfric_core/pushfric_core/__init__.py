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

import ast
import importlib
import pathlib

_STUB = ast.parse(pathlib.Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
_HOMES = {alias.asname: line.module for line in _STUB.body if isinstance(line, ast.ImportFrom) for alias in line.names}
"""The module of each public name: __init__.pyi says it, to type checkers, too."""

__all__ = sorted(_HOMES)  # noqa: PLE0605 - computed, so that no name is written a second time


def __getattr__(name: str) -> object:
    """A public name; or `__version__`, that of the installed package: package.xml has it."""
    if name == "__version__":
        from importlib.metadata import version

        return version(__name__)
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = globals()[name] = getattr(importlib.import_module(_HOMES[name]), name)
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES, "__version__"})
