"""The files that a forge and citation tools read: they match their schemas, and run what this repository has."""

import pathlib
import re
import subprocess
import sys

import pytest
import yaml

import pushfric_core

ROOT = pathlib.Path(__file__).resolve().parents[1]
SCHEMAS = {
    ".github/workflows/ci.yml": "vendor.github-workflows",
    ".github/ISSUE_TEMPLATE/fault.yml": "vendor.github-issue-forms",
    ".github/ISSUE_TEMPLATE/wish.yml": "vendor.github-issue-forms",
    ".github/ISSUE_TEMPLATE/config.yml": "vendor.github-issue-config",
    "CITATION.cff": "vendor.citation-file-format",
}


@pytest.mark.parametrize(("name", "schema"), SCHEMAS.items())
def test_each_file_matches_its_schema(name, schema):
    check = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", schema, ROOT / name]
    run = subprocess.run(check, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stdout + run.stderr


def test_every_file_is_checked():
    assert {str(path.relative_to(ROOT)) for path in (ROOT / ".github").rglob("*.yml")} == {*SCHEMAS} - {"CITATION.cff"}


def test_the_workflow_runs_ci_with_each_distribution():
    jobs = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())["jobs"]
    assert jobs["wheels"]["container"] == "ubuntu:24.04"
    assert jobs["ros"]["strategy"]["matrix"]["distro"] == ["jazzy", "kilted"]
    for job in jobs.values():
        commands = "\n".join(step.get("run", "") for step in job["steps"])
        assert re.search(r"^(\.ci/run)$", commands, re.MULTILINE)
    assert (ROOT / ".ci/run").stat().st_mode & 0o111


def test_the_workflow_installs_what_the_readme_says():
    """pip's line for a sourced ROS 2 stands in the README, too."""
    (line,) = re.findall(r"python3 -m pip install (osqp .*)", (ROOT / "README.md").read_text())
    assert line in (ROOT / ".github/workflows/ci.yml").read_text()


def test_the_citation_is_of_this_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == pushfric_core.__version__
    assert f"version = {{{pushfric_core.__version__}}}" in (ROOT / "README.md").read_text()
