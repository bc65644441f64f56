"""A sample of the campaign of faults, with real processes."""

import pathlib
import sys

import pytest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2]))

from faults.campaign import attempt, table
from faults.cases import CASES


@pytest.mark.parametrize("case", [case for case in CASES if case.quick], ids=lambda case: case.fault)
def test_a_fault_has_the_effect_that_is_asked_for(case):
    outcome = attempt(case)
    assert outcome.problems == ()
    assert case.fault in table([[outcome]])


def test_each_fault_has_a_name_of_its_own():
    assert len({case.fault for case in CASES}) == len(CASES)
