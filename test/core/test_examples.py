"""The examples in the docstrings of the public names run, and give what they say."""

import doctest

import pytest

import pushfric_core

DATA = {"TABLE_1"}
"""Names without a docstring of their own; the package's example shows them."""

FINDER = doctest.DocTestFinder(recurse=False, exclude_empty=False)


@pytest.mark.parametrize("name", ["pushfric_core", *sorted(set(pushfric_core.__all__) - DATA)])
def test_the_example_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    public = pushfric_core if name == "pushfric_core" else getattr(pushfric_core, name)
    (found,) = FINDER.find(public, name, globs={})
    assert found.examples, f"{name} has no example"
    said: list[str] = []
    failed = doctest.DocTestRunner().run(found, out=said.append).failed
    assert not failed, "".join(said)


def test_the_example_of_the_package_shows_what_has_no_docstring():
    assert all(name in pushfric_core.__doc__ for name in DATA)
