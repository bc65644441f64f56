"""How the middleware of a process is set up: who can reach it, and how much memory its images have.

Nodes can be reached from this machine alone unless the cell's file says otherwise. ROS 2's own LOCALHOST only stops a process
from *looking for* others: with Fast DDS its sockets stay open to every network, and accept messages from everybody. So the
files of profiles next to this module bind the sockets to the loopback interface.

Processes that start together find each other at once: Fast DDS alone lets them miss each other for 3 s, every other time.

Only processes that send or take images use shared memory; all others talk by UDP alone. With shared memory, a process on a busy
machine may be taken for dead and its port replaced, by any process that starts in any domain, and then it hears nothing more,
without an error (eProsima/Fast-DDS#6117, #5737). Images are too large for the buffers of sockets. They are passed through a
segment of the sender's shared memory. Fast DDS's own half MiB is too small for one 640 x 480 colour image, so at camera rate
most of such images are lost without an error; here, it has more. A camera driver can use `fastdds_images.xml`, too.

Sockets have buffers of 4 MiB, or as much as the kernel allows (net.core.rmem_max): the usual 208 KiB overflow where 50 planners
ask at once, and Fast DDS sends a lost request again only after 3 s.
"""

import contextlib
import os
import pathlib
import shutil
from collections.abc import Iterator, Mapping

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.utilities import get_rmw_implementation_identifier

from pushfric_core.cell.node_settings import Discovery
from pushfric_core.errors import InvalidInput
from pushfric_ros.node_kit.lock import domain
from pushfric_ros.node_kit.reach import (
    FILE_VARIABLES,
    RANGE,
    SHARED_MEMORY,
    VARIABLES,
    configured_by_user,
    stays_on_this_machine,
)

RCLError = rclpy_implementation.RCLError

REFUSALS = ("failed to initialize", "error creating node")
"""Beginnings of rcl's errors if a variable such as ROS_LOG_DIR or ROS_STATIC_PEERS has an impossible value."""

HERE = pathlib.Path(__file__).parent
NETWORK = HERE / "fastdds.xml"
THIS_MACHINE = HERE / "fastdds_this_machine.xml"
IMAGES = HERE / "fastdds_images.xml"
IMAGES_ON_THIS_MACHINE = HERE / "fastdds_images_this_machine.xml"

FREE = 48 * 2**20
"""Least free shared memory [bytes]; if Fast DDS cannot make a segment, it falls back to the network."""


@contextlib.contextmanager
def _environment(variables: Mapping[str, str | None]) -> Iterator[None]:
    """Within the context, the environment has these values of variables; None: it does not have the variable."""
    before = {name: os.environ.get(name) for name in variables}
    _set(variables)
    try:
        yield
    finally:
        _set(before)


def apart() -> contextlib.AbstractContextManager[None]:
    """Nodes of a context of rclpy that is initialized within find no nodes of other contexts, and none of these finds them."""
    return _environment({**dict.fromkeys(VARIABLES), RANGE: "OFF"})


def asked_for(discovery: Discovery) -> dict[str, str]:
    """The environment variables for the nodes of a cell; none if the user has set any of `VARIABLES`."""
    return {} if any(os.environ.get(name) for name in VARIABLES) else {RANGE: discovery.name}


def for_camera_drivers() -> str | None:
    """The command that gives a camera driver's process enough shared memory for its images; None: not with this middleware."""
    if not get_rmw_implementation_identifier().startswith("rmw_fastrtps"):
        return None
    return f"export {_file_variable()}={IMAGES}"


@contextlib.contextmanager
def configured(images: bool = False) -> Iterator[None]:
    """Within the context, the environment makes Fast DDS set up a process's first node as this module says.

    Args:
        images: the process sends or takes images; its first node decides.
    Raises:
        InvalidInput: ROS_DOMAIN_ID is not a domain, or another variable keeps the middleware from starting; or SROS 2 is
            switched on, but the node made within the context has no keys, or the middleware no security.
    """
    domain()
    try:
        with _environment(_settings(images)):
            yield
    except RCLError as error:
        said = " ".join(str(error).split())[:300]
        if os.environ.get("ROS_SECURITY_ENABLE", "").lower() == "true":
            raise InvalidInput(f"ROS_SECURITY_ENABLE is true, but {said}") from error
        if said.startswith(REFUSALS):
            raise InvalidInput(f"the middleware does not start, check the environment variables ROS_...: {said}") from error
        raise


def _set(variables: Mapping[str, str | None]) -> None:
    for name, value in variables.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


def _settings(images: bool) -> Mapping[str, str | None]:
    local = stays_on_this_machine()
    if not get_rmw_implementation_identifier().startswith("rmw_fastrtps") or configured_by_user():
        return {RANGE: Discovery.LOCALHOST.name} if local else {}
    roomy = images and SHARED_MEMORY.is_dir() and shutil.disk_usage(SHARED_MEMORY).free >= FREE
    if not local:
        return {_file_variable(): str(IMAGES if roomy else NETWORK)}
    # with LOCALHOST, ROS 2 would add transports of its own, which are open to every network
    profiles = IMAGES_ON_THIS_MACHINE if roomy else THIS_MACHINE
    return {RANGE: "SYSTEM_DEFAULT", "ROS_LOCALHOST_ONLY": None, _file_variable(): str(profiles)}


def _file_variable() -> str:
    return FILE_VARIABLES[os.environ.get("ROS_DISTRO") != "jazzy"]
