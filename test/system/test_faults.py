"""A sample of the campaign of faults, with real processes."""

import pathlib
import sys

import pytest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2]))

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
