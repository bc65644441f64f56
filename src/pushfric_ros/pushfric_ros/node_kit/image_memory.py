"""Shared memory enough for images, in the processes that publish them.

Fast DDS passes messages between processes of one machine through a segment of the sender's shared memory. Its half MiB does
not hold one 640 x 480 colour image: most of such images are lost at camera rate, without an error. `fastdds.xml` makes it
larger; a camera driver takes it through FASTRTPS_DEFAULT_PROFILES_FILE. Other middlewares ignore it.
"""

import os
import pathlib
import shutil

PROFILES = pathlib.Path(__file__).with_name("fastdds.xml")

FILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Name the profiles, before and since Fast DDS 3."""

FILES = ("DEFAULT_FASTRTPS_PROFILES.xml", "DEFAULT_FASTDDS_PROFILES.xml")
"""Profiles that Fast DDS takes from the working folder."""

SHARED_MEMORY = pathlib.Path("/dev/shm")

FREE = 48 * 2**20
"""Only where so much shared memory is free [bytes]; without a segment Fast DDS would fall back to the network."""


def make_room_for_images() -> None:
    """Have this process's middleware take the larger segment, unless its user configured it; call before `rclpy.init`."""
    configured = any(name in os.environ for name in (*FILE_VARIABLES, "FASTDDS_BUILTIN_TRANSPORTS"))
    if configured or any(pathlib.Path(name).exists() for name in FILES):
        return
    if SHARED_MEMORY.is_dir() and shutil.disk_usage(SHARED_MEMORY).free >= FREE:
        for name in FILE_VARIABLES:
            os.environ[name] = str(PROFILES)
