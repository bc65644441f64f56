"""A sample of the campaign of faults, with real processes."""

import pathlib
import subprocess
import sys

import pytest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2]))

from faults import failing_sync
from faults.__main__ import DOCUMENT, page
from faults.camera import FAULTS
from faults.cases import CASES, GOES_ON, QUICK
from faults.cell_run import new_run
from faults.table import table
from pushfric_ros.faults.fault import tried


@pytest.mark.parametrize("fault", [fault for fault in CASES if fault.name in QUICK], ids=lambda fault: fault.name)
def test_a_fault_has_the_effect_that_is_asked_for(fault):
    assert tried(fault, new_run).problem is None


def test_the_document_shows_the_evidence():
    assert DOCUMENT.read_text(encoding="utf-8") == page()
    told = {"asked": "all ends", "tries": [{"seen": "exit code 1 after 3 s", "problem": "lost", "tries": 2}]}
    *_, row = table([told | {"fault": fault.name} for fault in CASES[:2]]).splitlines()
    again = "1 on try 2, 1 on try 2"
    assert row == f"| kill -9 of tracker, estimator | all ends | exit code 1 after 3 s; lost; lost | 0 of 2, {again} |"


def test_a_run_waits_for_a_person_or_goes_on_with_each_fault_of_the_camera():
    assert {name for name, (_, why) in FAULTS.items() if not why} == {*GOES_ON}


FINISHING = """
import sys
from pushfric_core.errors import InvalidInput
from pushfric_core.bags.bag_writer import BagWriter
writer = BagWriter(sys.argv[1])
try:
    writer.close()
except InvalidInput as error:
    print(error)
"""


@pytest.mark.skipif(not failing_sync.known(), reason="fdatasync is made to fail on Linux only, on x86_64 and aarch64")
def test_a_bag_of_which_nobody_knows_whether_it_is_on_the_disk_is_not_finished(tmp_path):
    command = [sys.executable, "-m", "faults.failing_sync", sys.executable, "-c", FINISHING, str(tmp_path / "bag")]
    root = pathlib.Path(__file__).resolve().parents[2]
    said = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=300, check=True).stdout
    assert said == f"{tmp_path}/bag: cannot write the bag: Input/output error\n"
    assert [file.name for file in (tmp_path / "bag").iterdir()] == ["bag_0.mcap"]
