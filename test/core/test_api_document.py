"""docs/api.md is what the docstrings of the public names say. `python3 test/core/test_api_document.py` writes it again."""

import functools
import inspect
import pathlib
import textwrap

import pushfric_core

DOCUMENT = pathlib.Path(__file__).resolve().parents[2] / "docs/api.md"

HEAD = """\
# The public names of pushfric_core

Made from the docstrings by `python3 test/core/test_api_document.py`; the tests compare. Every name is imported as in
`from pushfric_core import Estimator`; `help(Estimator)` has shapes, units, frames, errors and an example. The notebooks
[from a bag to a prediction](bag_to_prediction.md) and [from your own data to a verdict](data_to_verdict.md) begin like this:

```python
from pushfric_core import friction_model, load, predict

pushes = load("bags/rubber_rect4")  # the observations; pushes.object is what was pushed; pushes.to_frame() is a table
estimate = pushes.new_estimator().add(pushes)
print(estimate)  # three lines; estimate.verdict.use: whether it may be used; estimate.to_dict() has all numbers
estimate.plot()  # the object with w, the confidence ellipse and the pushes; estimate.to_frame() is w as a table
model = friction_model(estimate)
motion = predict(model, [(0.0, -0.032)], [(0.0, -1.0)], [(0.0, 0.02)])  # contact [m], outward normal, tip's velocity [m/s]
```

Bags need the extra `bags`, pictures `plot`, tables `pandas` ([install.md](install.md#without-ros-at-all))."""

DATA = {"TABLE_1": "The six objects of Table 1 by name: outline, support, mu_c, grid and noise of each."}
"""Names that are neither classes nor functions have no docstring."""


def document():
    modules: dict[str, list[str]] = {}
    for name in pushfric_core.__all__:
        modules.setdefault(pushfric_core._HOMES[name].removeprefix("pushfric_core."), []).append(name)
    parts = [HEAD]
    for module, names in sorted(modules.items()):
        source = f"../src/pushfric_core/pushfric_core/{module.replace('.', '/')}.py"
        parts += [f"\n## [{module}]({source})"]
        for name in names:
            parts += ["", *entry(name, getattr(pushfric_core, name))]
    return "\n".join(parts) + "\n"


def entry(name, public):
    members = [f"`.{member}`" for member in own_members(public)] if inspect.isclass(public) else []
    about = f" {', '.join(members)}." if members else ""
    return [wrapped(f"`{name}{parameters(public)}`: {summary(name, public)}{about}")]


def own_members(public):
    """The methods and properties of a class, each with its parameters; all have a docstring."""
    for member, value in vars(public).items():
        attribute = isinstance(value, property | functools.cached_property)
        if not member.startswith("_") and (attribute or inspect.isfunction(value) or isinstance(value, classmethod)):
            assert inspect.getdoc(getattr(public, member)), f"{member} has no docstring"
            yield member if attribute else f"{member}{parameters(getattr(public, member))}"


def wrapped(paragraph):
    return textwrap.fill(paragraph, 120, break_long_words=False, break_on_hyphens=False)


def parameters(public):
    if not inspect.isroutine(public):
        return ""
    return f"({', '.join(name for name in inspect.signature(public).parameters if name != 'self')})"


def summary(name, public):
    text = DATA[name] if name in DATA else inspect.getdoc(public)
    assert text, f"{name} has no docstring"
    return " ".join(text.split("\n\n")[0].split())


def test_the_document_says_what_the_docstrings_say():
    assert DOCUMENT.read_text(encoding="utf-8") == document()


if __name__ == "__main__":
    DOCUMENT.write_text(document(), encoding="utf-8")
