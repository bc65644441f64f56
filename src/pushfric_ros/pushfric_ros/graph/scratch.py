"""A folder for the files of a run that need a path: parameters, the simulated camera's calibration, a link to its port."""

import contextlib
import pathlib
import subprocess
import tempfile
from collections.abc import Iterator

KEEPER = ("/bin/sh", "-c", 'read -r _; rm -rf -- "$1"', "pushfric-scratch")
"""Command that removes the folder named by its last argument once nobody can write to its input any longer."""


@contextlib.contextmanager
def scratch_folder() -> Iterator[pathlib.Path]:
    """A temporary folder for the context; it is removed with this process, even if the process is killed."""
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
