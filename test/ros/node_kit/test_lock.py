"""One run at a time for each cell, whoever starts it, from whatever environment, until its last process has ended."""

import os
import subprocess
import sys

import pytest

from pushfric_core.errors import InvalidInput
from pushfric_ros.node_kit.lock import lock

NAME = "/locked"

CLAIM = """
from pushfric_core.errors import InvalidInput
from pushfric_ros.node_kit.lock import lock
try:
    with lock("/locked"):
        print("claimed")
except InvalidInput as error:
    print(error)
"""


def claim_elsewhere(**environment: str) -> str:
    """The output of another process that claims the name."""
    elsewhere = subprocess.run(
        [sys.executable, "-c", CLAIM], env=os.environ | environment, capture_output=True, text=True, check=True, timeout=120
    )
    return elsewhere.stdout


def test_a_cell_is_claimed_once_and_freed_again():
    with lock(NAME):
        with pytest.raises(InvalidInput, match=f"a cell named {NAME} is already running on ROS domain"), lock(NAME):
            pass
        with lock("/another"):
            pass
    with lock(NAME):
        pass


def test_another_environment_does_not_get_past_the_claim(tmp_path):
    """Sessions differ in their folders: a lock file once lay in different folders for different sessions."""
    folders = dict.fromkeys(("TMPDIR", "XDG_RUNTIME_DIR", "HOME"), str(tmp_path))
    with lock(NAME):
        assert "is already running" in claim_elsewhere(**folders)
        another = str(int(os.environ["ROS_DOMAIN_ID"]) % 100 + 1)
        assert claim_elsewhere(ROS_DOMAIN_ID=another) == "claimed\n"
    assert claim_elsewhere(**folders) == "claimed\n"
    assert list(tmp_path.iterdir()) == []


def test_the_claim_lasts_until_whoever_it_was_handed_to_has_ended():
    """A run whose command line was killed still has nodes for a moment, and these would disturb the next run."""
    with lock(NAME) as claim:
        node = subprocess.Popen(["/bin/cat"], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, pass_fds=[claim])
    assert "its nodes have not ended yet" in claim_elsewhere()
    node.communicate()
    with lock(NAME):
        pass
