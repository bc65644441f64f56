"""The ROS domain of this process; needs the standard library alone."""

import os

from pushfric_core.errors import InvalidInput

LAST_DOMAIN = 232
"""The largest ROS_DOMAIN_ID whose ports exist (RTPS 2.5, 9.6.2.3)."""


def domain() -> int:
    """The ROS domain that the environment names.

    Raises:
        InvalidInput: it is none.
    """
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not (text.isascii() and text.isdecimal() and len(text) < 10 and int(text) <= LAST_DOMAIN):
        raise InvalidInput(f"ROS_DOMAIN_ID must be a number from 0 to {LAST_DOMAIN}, got {text[:40]!r}")
    return int(text)
