"""A sample of the campaign of faults, with real processes."""

import pathlib
import subprocess
import sys

import pytest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2]))

from faults import failing_sync
from faults.__main__ import circumstances
from faults.campaign import Outcome, attempt, table
from faults.cases import CASES


@pytest.mark.parametrize("case", [case for case in CASES if case.quick], ids=lambda case: case.fault)
def test_a_fault_has_the_effect_that_is_asked_for(case):
    outcome = attempt(case)
    assert outcome.problems == ()
    assert case.fault in table([[outcome]])


def test_each_fault_has_a_name_of_its_own():
    assert len({case.fault for case in CASES}) == len(CASES)


def test_the_table_says_how_it_came_about():
    tried = [[Outcome(case, "exit code 0", "", ())] for case in CASES[1:]]
    assert f"Not tried: {CASES[0].fault}." in circumstances(tried, [2.0, 11.0])
    whole = circumstances([[Outcome(CASES[0], "exit code 0", "", ())], *tried], [2.0, 11.0])
    assert whole.startswith("Each fault was tried once, on ")
    assert whole.endswith("load average 2 to 11. No fault was left out.")


FINISHING = """
import sys
from pushfric_core.errors import InvalidInput
from pushfric_ros.bags.bag_writer import BagWriter
writer = BagWriter(sys.argv[1])
try:
    writer.close()
except InvalidInput as error:
    print(error)
"""


@pytest.mark.skipif(not failing_sync.known(), reason="fsync is made to fail on Linux only, on x86_64 and aarch64")
def test_a_bag_of_which_nobody_knows_whether_it_is_on_the_disk_is_not_finished(tmp_path):
    command = [sys.executable, "-m", "faults.failing_sync", sys.executable, "-c", FINISHING, str(tmp_path / "bag")]
    root = pathlib.Path(__file__).resolve().parents[2]
    said = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=300, check=True).stdout
    assert said == f"{tmp_path}/bag: cannot write the bag: Input/output error\n"
    assert [file.name for file in (tmp_path / "bag").iterdir()] == ["bag_0.mcap"]
