"""Runs a command in which every fdatasync fails, as on a broken disk: `python -m faults.failing_sync COMMAND...`.

Bags are synced with it, small files with fsync.

The kernel itself answers so (seccomp), to the command and to all processes that it starts.
"""

import ctypes
import errno
import os
import platform
import struct
import sys

SYSTEM_CALLS = {"x86_64": 75, "aarch64": 83}
"""The number of fdatasync, by machine (asm/unistd.h)."""

NO_NEW_PRIVILEGES, SECCOMP, FILTER = 38, 22, 2  # prctl(2)
LOAD, EQUAL, RETURN = 0x20, 0x15, 0x06  # of the classic BPF, linux/bpf_common.h
ALLOWED, FAILS = 0x7FFF0000, 0x00050000 | errno.EIO  # linux/seccomp.h


def known() -> bool:
    """Whether this works here: on Linux, on the machines above."""
    return sys.platform == "linux" and platform.machine() in SYSTEM_CALLS


def fail_syncs() -> None:
    """Let every fdatasync of this process and its children fail with EIO from now on.

    Raises:
        OSError: the kernel does not allow it.
    """
    steps = [(LOAD, 0, 0, 0), (EQUAL, 0, 1, SYSTEM_CALLS[platform.machine()]), (RETURN, 0, 0, FAILS), (RETURN, 0, 0, ALLOWED)]
    filters = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *step) for step in steps))
    program = struct.pack("HP", len(steps), ctypes.addressof(filters))
    libc = ctypes.CDLL(None, use_errno=True)
    for options in ((NO_NEW_PRIVILEGES, 1, 0, 0, 0), (SECCOMP, FILTER, program, 0, 0)):
        if libc.prctl(*options):
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


if __name__ == "__main__":
    fail_syncs()
    os.execvp(sys.argv[1], sys.argv[1:])
