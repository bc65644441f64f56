"""A sample of the campaign of faults, with real processes."""

import pathlib
import subprocess
import sys
from dataclasses import replace

import pytest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2]))

from faults import failing_sync
from faults.__main__ import DOCUMENT, page
from faults.campaign import Outcome, attempt, evidence, table
from faults.cases import CASES


@pytest.mark.parametrize("case", [case for case in CASES if case.quick], ids=lambda case: case.fault)
def test_a_fault_has_the_effect_that_is_asked_for(case):
    outcome = attempt(replace(case, short=True))  # the runs that go on make four pushes instead of fourteen
    assert outcome.problems == ()
    assert case.fault in table(evidence([[outcome]]))


def test_the_document_shows_the_evidence():
    assert DOCUMENT.read_text(encoding="utf-8") == page()
    *_, row = table(evidence([[Outcome(case, "exit code 1 after 3 s", "", ("lost",))] for case in CASES[:2]])).splitlines()
    assert row.startswith("| kill -9 of tracker, estimator | started again, or the run ends")
    assert row.endswith(" | exit code 1 after 3 s; lost; lost | 0 of 2 |")


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


@pytest.mark.skipif(not failing_sync.known(), reason="fsync is made to fail on Linux only, on x86_64 and aarch64")
def test_a_bag_of_which_nobody_knows_whether_it_is_on_the_disk_is_not_finished(tmp_path):
    command = [sys.executable, "-m", "faults.failing_sync", sys.executable, "-c", FINISHING, str(tmp_path / "bag")]
    root = pathlib.Path(__file__).resolve().parents[2]
    said = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=300, check=True).stdout
    assert said == f"{tmp_path}/bag: cannot write the bag: Input/output error\n"
    assert [file.name for file in (tmp_path / "bag").iterdir()] == ["bag_0.mcap"]
