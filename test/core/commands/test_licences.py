"""The command `licences`."""

import json

import pytest
from missing import pushfric_without

from pushfric_core.commands.licences import installed, licence


def test_every_package_states_its_licence():
    done = pushfric_without([], "licences", "--json")
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)
    assert rows["pushfric_core"]["licence"] == "Apache-2.0"
    assert {"numpy", "scipy", "shapely", "mcap", "markdown-it-py"} <= rows.keys()  # the last is needed by rich alone
    assert "pytest" not in rows  # tests need it, not pushfric
    assert all(row["licence"] for row in rows.values())


@pytest.mark.parametrize(("package", "stated"), [("numpy", "BSD"), ("rich", "MIT License"), ("pushfric_core", "Apache-2.0")])
def test_licences_are_read_from_new_and_old_metadata(package, stated):
    assert stated in licence(installed()[package])
