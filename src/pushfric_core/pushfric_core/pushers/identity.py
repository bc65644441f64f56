"""The identity of a serial device, whatever its port is called today."""

import os

from serial.tools.list_ports_linux import SysFS


def identity_of(port: str) -> str:
    """The device at a port: its USB serial number, else the USB socket it is plugged into, else the path of the port itself.

    All links to a port lead to the same one. A path begins at the root, and may name another device after a restart.
    """
    path = os.path.realpath(port)
    device = SysFS(path)
    interface = os.path.basename(device.usb_interface_path or "").rpartition(":")[2]  # of a device with several ports
    if device.serial_number:
        return f"usb:{device.vid:04x}:{device.pid:04x}:{device.serial_number}:{interface}"
    if device.location:
        return f"usb-socket:{device.location}"
    return path
