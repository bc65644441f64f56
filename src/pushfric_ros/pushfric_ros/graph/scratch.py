"""A folder for the files of a run that need a path: parameters, the simulated camera's calibration, a link to its port."""

import contextlib
import pathlib
import subprocess
import tempfile
from collections.abc import Iterator

KEEPER = ("/bin/sh", "-c", 'read -r _; rm -rf -- "$1"', "pushfric-scratch")
"""Removes the folder that is its last argument, as soon as nobody can write to its input any more."""


@contextlib.contextmanager
def scratch_folder() -> Iterator[pathlib.Path]:
    """A temporary folder for the time of the context; it goes with this process, even if that is killed."""
    folder = tempfile.mkdtemp(prefix="pushfric-")
    keeper = subprocess.Popen(
        [*KEEPER, folder],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # out of reach of the terminal's Ctrl-C
    )
    try:
        yield pathlib.Path(folder)
    finally:
        keeper.communicate()
