"""The message definitions that pushfric_core carries, so that it reads and writes bags where pushfric_msgs is not installed."""

import pathlib

from pushfric_core.bags.constants import FOLDER

MESSAGES = pathlib.Path(__file__).parents[3] / "src" / "pushfric_msgs" / "msg"


def test_the_definitions_are_those_of_pushfric_msgs():
    here, there = ({path.name: path.read_bytes() for path in folder.glob("*.msg")} for folder in (FOLDER, MESSAGES))
    assert here == there, f"copy {MESSAGES}/*.msg to {FOLDER}"
