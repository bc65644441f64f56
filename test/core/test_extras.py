"""What pushfric_core does without its extras, and what it says of a missing one."""

import pathlib

import pytest
from missing import extras, pushfric_without
from packaging.requirements import Requirement
from problems import four_feet

from pushfric_core.commands import dependencies
from pushfric_core.files.observation_file import REQUIRED

ROOT = pathlib.Path(__file__).resolve().parents[2]
BAG = ROOT / "bags/rubber_rect4"

EXTRAS = {name: texts for name, texts in extras("pushfric_core")[0].items() if name != "test"}


def run(without, *arguments):
    packages = [Requirement(text).name for extra in without for text in EXTRAS[extra]]
    modules = [dependencies.MODULES.get(package, package) for package in packages]
    return pushfric_without([*modules, "pushfric_ros", "rclpy"], *arguments)


@pytest.fixture
def pushes(tmp_path):
    problem = four_feet()
    rows = [(*one.contact_point, *one.contact_normal, *one.twist, one.push_id) for one in problem.observations[:6]]
    lines = [",".join(REQUIRED), *(",".join(f"{value:.17g}" for value in row) for row in rows)]
    (tmp_path / "pushes.csv").write_text("\n".join(lines))
    (tmp_path / "square.yaml").write_text(f"name: square\noutline: {problem.outline.vertices.tolist()}\n")
    return tmp_path


@pytest.mark.parametrize("command", ["estimate", "region"])
def test_observations_in_a_csv_need_no_extra(command, pushes):
    done = run(EXTRAS, command, pushes / "pushes.csv", "--object", pushes / "square.yaml", "--json")
    assert done.returncode in (0, 1), done.stderr  # 1: the verdict on six observations
    assert done.stdout.startswith("{")


USERS = {
    "bags": ["estimate", BAG],
    "plot": ["estimate", BAG, "--figure", "OUT/figure.png"],
    "jobs": ["estimate", BAG, "--out", "OUT/many", "--jobs", "1"],
    "dask": ["estimate", BAG, "--out", "OUT/many", "--dask", "tcp://127.0.0.1:1"],
}


@pytest.mark.parametrize("extra", USERS)
def test_a_missing_extra_is_one_line_with_the_command_that_installs_it(extra, tmp_path):
    done = run([extra], *(str(one).replace("OUT", str(tmp_path)) for one in USERS[extra]))
    *_, line = done.stderr.splitlines()
    assert done.returncode in (1, 2)
    assert line.startswith("error: ")
    assert line.endswith(f"pip install 'pushfric_core[{extra}]'")
    assert "Traceback" not in done.stderr
