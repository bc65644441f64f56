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


def test_the_workflow_runs_ci_with_each_distribution(script):
    jobs = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())["jobs"]
    pythons = [tuple(map(int, text.split("."))) for text in jobs["wheels"]["strategy"]["matrix"]["python"]]
    assert (pythons[0], pythons[-1]) == script.PYTHONS
    assert jobs["wheels"]["strategy"]["matrix"]["distro"] == list(script.DISTROS)
    assert jobs["ros"]["strategy"]["matrix"]["distro"] == ["jazzy", "kilted"]
    for job in jobs.values():
        commands = "\n".join(step.get("run", "") for step in job["steps"])
        assert re.search(r"^(\.ci/run)$", commands, re.MULTILINE)
    assert (ROOT / ".ci/run").stat().st_mode & 0o111


def test_the_workflow_installs_what_the_docs_say():
    """pip's line for a sourced ROS 2 stands in docs/install.md, too."""
    (line,) = re.findall(r"python3 -m pip install (osqp .*)", (ROOT / "docs/install.md").read_text())
    assert line in (ROOT / ".github/workflows/ci.yml").read_text()


def test_the_citation_is_of_this_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == pushfric_core.__version__
    assert f"version = {{{pushfric_core.__version__}}}" in (ROOT / "README.md").read_text()


def instructions(file: pathlib.Path) -> list[tuple[str, str]]:
    """The instructions of a container file with their arguments, continued lines joined."""
    lines = "\n".join(line for line in file.read_text().splitlines() if not line.startswith("#")).replace("\\\n", " ")
    return [tuple(line.split(maxsplit=1)) for line in lines.splitlines() if line.strip()]


KNOWN = {"ARG", "FROM", "ENV", "RUN", "COPY", "USER", "WORKDIR", "ENTRYPOINT", "CMD"}


@pytest.mark.parametrize("name", ["wheels", "ros"])
def test_the_container_files_run_what_the_docs_say(name):
    made = instructions(ROOT / f"containers/{name}.Dockerfile")
    assert {what for what, _ in made} <= KNOWN
    runs = [argument for what, argument in made if what == "RUN"]
    for run in runs:  # each is one line of a shell
        subprocess.run(["sh", "-n", "-c", run], check=True, timeout=60)
    for what, argument in made:
        if what in ("ENTRYPOINT", "CMD"):
            assert all(isinstance(word, str) for word in yaml.safe_load(argument))
    page = " ".join((ROOT / "docs/install.md").read_text().split())
    wanted = {"wheels": ["./pushfric setup"], "ros": ["rosdep install --from-paths src --ignore-src -y", "colcon build"]}[name]
    if name == "ros":
        wanted += re.findall(r"python3 -m pip install osqp .*?'typer[^']*'", page)
        assert len(wanted) == 3
    for command in wanted:
        assert command in page
        assert any(command in run for run in runs)


def test_the_container_without_ros_has_every_system_package(script):
    (run,) = [one for what, one in instructions(ROOT / "containers/wheels.Dockerfile") if what == "RUN" and "apt-get" in one]
    assert set(script.SYSTEM_PACKAGES.values()) <= set(run.split())
