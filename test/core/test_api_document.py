"""docs/api.md names every public name, which has a docstring. `python3 test/core/test_api_document.py` writes it again."""

import functools
import inspect
import pathlib

import pytest

import pushfric_core

DOCUMENT = pathlib.Path(__file__).resolve().parents[2] / "docs/api.md"

HEAD = """\
# The public names of pushfric_core

Made by `python3 test/core/test_api_document.py`. Every name is imported as in `from pushfric_core import Estimator`;
`help(Estimator)`, or the page *Python* of the site that `./pushfric docs` builds, has what it does, its members, shapes, units,
frames, errors and an example. It begins like this:

```python
from pushfric_core import friction_model, load, predict

pushes = load("bags/rubber_rect4")  # the observations; pushes.object is what was pushed; pushes.to_frame() is a table
estimate = pushes.new_estimator().add(pushes)
print(estimate)  # three lines; estimate.verdict.use: whether it may be used; estimate.to_dict() has all numbers
estimate.plot()  # the object with w, the confidence ellipse and the pushes; estimate.to_frame() is w as a table
model = friction_model(estimate)
motion = predict(model, [(0.0, -0.032)], [(0.0, -1.0)], [(0.0, 0.02)])  # contact [m], outward normal, tip's velocity [m/s]
```

Bags need the extra `bags`, pictures `plot`, tables `pandas` ([install.md](install.md#without-ros-at-all)).

"""

UNDOCUMENTED = {"TABLE_1"}
"""Names that are neither classes nor functions have no docstring."""


def document():
    modules: dict[str, list[str]] = {}
    for name in pushfric_core.__all__:
        modules.setdefault(pushfric_core._HOMES[name].removeprefix("pushfric_core."), []).append(name)
    rows = [
        f"| [{module}](../src/pushfric_core/pushfric_core/{module.replace('.', '/')}.py) | {', '.join(map(entry, names))} |\n"
        for module, names in sorted(modules.items())
    ]
    return "".join((HEAD, "| module | names |\n|---|---|\n", *rows))


def entry(name):
    public = getattr(pushfric_core, name)
    assert name in UNDOCUMENTED or inspect.getdoc(public), f"{name} has no docstring"
    if not inspect.isroutine(public):
        return f"`{name}`"
    return f"`{name}({', '.join(inspect.signature(public).parameters)})`"


@pytest.mark.parametrize("name", sorted(pushfric_core.__all__))
def test_methods_and_properties_have_a_docstring(name):
    public = getattr(pushfric_core, name)
    for member, value in vars(public).items() if inspect.isclass(public) else ():
        told = isinstance(value, property | functools.cached_property | classmethod) or inspect.isfunction(value)
        assert member.startswith("_") or not told or inspect.getdoc(getattr(public, member)), f"{member} has no docstring"


def test_the_document_names_every_public_name():
    assert DOCUMENT.read_text(encoding="utf-8") == document()


if __name__ == "__main__":
    DOCUMENT.write_text(document(), encoding="utf-8")
