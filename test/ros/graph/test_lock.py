"""One run at a time for each cell, whatever lies where the lock file goes."""

import os
import pathlib
import tempfile

import pytest

from pushfric_core.errors import InvalidInput
from pushfric_ros.graph.lock import lock

NAME = "/locked"


@pytest.fixture(params=["XDG_RUNTIME_DIR", "temporary folder"])
def above(request, tmp_path, monkeypatch) -> pathlib.Path:
    """The folder that holds the folder of lock files."""
    if request.param == "XDG_RUNTIME_DIR":
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    else:
        monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
        monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def lock_file(above: pathlib.Path) -> pathlib.Path:
    """The path of the lock file: the only file, in a folder whose name varies."""
    with lock(NAME):
        (path,) = above.rglob("*.lock")
    return path


def test_a_cell_is_claimed_once_and_freed_again(above):
    with lock(NAME):
        with pytest.raises(InvalidInput, match=f"a cell named {NAME} is already running on ROS domain"), lock(NAME):
            pass
        with lock("/another"):
            pass
    with lock(NAME):
        pass
    assert list(above.iterdir()) == []


def test_a_symbolic_link_in_place_of_the_lock_file_is_not_followed(above):
    path = lock_file(above)
    precious = above / "precious"
    precious.write_text("kept")
    path.parent.mkdir(mode=0o700)
    path.symlink_to(precious)
    with pytest.raises(InvalidInput, match="the lock file cannot be created"), lock(NAME):
        pass
    assert precious.read_text() == "kept"
    assert path.is_symlink()


def test_a_folder_that_others_can_write_is_refused(above):
    folder = lock_file(above).parent
    folder.mkdir()
    os.chmod(folder, 0o777)
    with pytest.raises(InvalidInput, match="expected a folder that only you can write"), lock(NAME):
        pass


def test_a_symbolic_link_in_place_of_the_folder_is_refused(above):
    folder = lock_file(above).parent
    (above / "elsewhere").mkdir()
    folder.symlink_to(above / "elsewhere")
    with pytest.raises(InvalidInput, match="cannot hold lock files"), lock(NAME):
        pass
    assert list((above / "elsewhere").iterdir()) == []


def test_a_lock_file_that_a_killed_run_left_is_taken_over(above):
    path = lock_file(above)
    path.parent.mkdir(mode=0o700)
    path.touch()
    with lock(NAME):
        pass
    assert list(above.iterdir()) == []
