"""One run at a time for each cell of a ROS domain: a lock file in a folder that only this user can write."""

import contextlib
import fcntl
import os
import pathlib
import stat
import tempfile
from collections.abc import Iterator

from pushfric_core.errors import InvalidInput


@contextlib.contextmanager
def lock(namespace: str) -> Iterator[None]:
    """Claim a cell's name on this machine's ROS domain until the context ends; the claim also ends with the process.

    Raises:
        InvalidInput: another run holds the name (two would mistake each other's messages for their own), or the lock file
            cannot be made safely.
    """
    domain = os.environ.get("ROS_DOMAIN_ID", "0")
    while True:
        path = _runtime_folder() / f"domain-{domain}{namespace.replace('/', '-')}.lock"
        try:
            file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
        except FileNotFoundError:
            continue  # another run has just ended and removed the folder
        except OSError as error:
            raise InvalidInput(f"{path}: the lock file cannot be created: {error.strerror}") from error
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(file)
            raise InvalidInput(
                f"a cell named {namespace} is already running on ROS domain {domain}; end it, or set another ROS_DOMAIN_ID"
            ) from None
        if _is_at(path, file):
            break
        os.close(file)  # the run that held it has just removed the file, so the locked one has no name any more
    try:
        yield
    finally:
        os.unlink(path)
        os.close(file)
        with contextlib.suppress(OSError):  # it is not empty while another cell runs
            path.parent.rmdir()


def _is_at(path: pathlib.Path, file: int) -> bool:
    try:
        return os.path.samestat(os.stat(path, follow_symlinks=False), os.fstat(file))
    except FileNotFoundError:
        return False


def _runtime_folder() -> pathlib.Path:
    """The folder for this user's lock files: in XDG_RUNTIME_DIR if that is set, otherwise in the system's temporary folder.

    Raises:
        InvalidInput: the folder cannot be made, or others could write into it.
    """
    above = os.environ.get("XDG_RUNTIME_DIR")
    folder = pathlib.Path(above) / "pushfric" if above else pathlib.Path(tempfile.gettempdir()) / f"pushfric-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
    except OSError as error:
        raise InvalidInput(f"{folder}: cannot hold lock files: {error.strerror}") from error
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o022:
        raise InvalidInput(f"{folder}: cannot hold lock files, expected a folder that only you can write")
    return folder
