"""Enough shared memory for images, in the processes that publish them.

Fast DDS passes messages between processes of one machine through a segment of the sender's shared memory. Its half MiB is too
small for one 640 x 480 colour image, so at camera rate most of such images are lost without an error. `fastdds.xml` makes it
larger; a camera driver can use the file through FASTRTPS_DEFAULT_PROFILES_FILE. Other middlewares ignore it.
"""

import os
import pathlib
import shutil

PROFILES = pathlib.Path(__file__).with_name("fastdds.xml")

FILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Environment variables that name the file of profiles, before and since Fast DDS 3."""

FILES = ("DEFAULT_FASTRTPS_PROFILES.xml", "DEFAULT_FASTDDS_PROFILES.xml")
"""Files of profiles that Fast DDS takes from the working folder."""

SHARED_MEMORY = pathlib.Path("/dev/shm")

FREE = 48 * 2**20
"""Least free shared memory [bytes]; if Fast DDS cannot make a segment, it falls back to the network."""


def make_room_for_images() -> None:
    """Make this process's middleware use the larger segment, unless the user configured it; call it before `rclpy.init`."""
    configured = any(name in os.environ for name in (*FILE_VARIABLES, "FASTDDS_BUILTIN_TRANSPORTS"))
    if configured or any(pathlib.Path(name).exists() for name in FILES):
        return
    if SHARED_MEMORY.is_dir() and shutil.disk_usage(SHARED_MEMORY).free >= FREE:
        for name in FILE_VARIABLES:
            os.environ[name] = str(PROFILES)
