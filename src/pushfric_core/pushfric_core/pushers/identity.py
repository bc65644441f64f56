"""What tells one serial device from another, whatever its port is called today."""

import os
from typing import NamedTuple

from serial.tools.list_ports_linux import SysFS


class Identity(NamedTuple):
    """A device: by its USB serial number, else by the USB socket it is plugged into, else by the path of its port."""

    text: str
    lasts: bool  # whether it holds when ports are named anew, after a restart or in another socket


def identity_of(port: str) -> Identity:
    """The identity of the device at a port; all links to a port lead to the same one."""
    path = os.path.realpath(port)
    device = SysFS(path)
    interface = os.path.basename(device.usb_interface_path or "").rpartition(":")[2]  # of a device with several ports
    if device.serial_number:
        return Identity(f"usb:{device.vid:04x}:{device.pid:04x}:{device.serial_number}:{interface}", True)
    if device.location:
        return Identity(f"usb-socket:{device.location}", True)
    return Identity(path, False)
