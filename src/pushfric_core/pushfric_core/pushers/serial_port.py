"""A serial port that never blocks: opened for one program alone, and written to within a time limit."""

import contextlib
import os
import select
import termios

from pushfric_core.errors import extra

with extra("serial", "a serial port"):
    import serial
    from serial.tools.list_ports_linux import SysFS

from pushfric_core.pushers.clock import clock

WRITE_TIMEOUT = 0.5  # [s]


def open_port(path: str, baud: int) -> serial.Serial:
    """Open a port for this process alone; its DTR line keeps its level when the port is closed.

    A change of DTR restarts many boards, which then lose their position.

    Args:
        path: of the port.
        baud: its speed [bit/s].
    Raises:
        OSError: the port cannot be opened, is in use, or has no such speed.
    """
    port = None
    try:
        port = serial.Serial(path, baud, timeout=0, exclusive=True)
        attributes = termios.tcgetattr(port.fd)
        attributes[2] &= ~termios.HUPCL
        termios.tcsetattr(port.fd, termios.TCSANOW, attributes)
    except (ValueError, termios.error) as error:
        if port is not None:
            port.close()
        raise OSError(str(error)) from error
    return port


def write_all(port: serial.Serial, data: bytes) -> None:
    """Write these bytes.

    pyserial's own timeout also fails a write that has succeeded, if the process stood still meanwhile.

    Args:
        port: as `open_port` opened it.
        data: the bytes.
    Raises:
        OSError: the port takes no bytes for WRITE_TIMEOUT, or is gone.
    """
    deadline = clock() + WRITE_TIMEOUT
    while data:
        if not select.select([], [port.fd], [], max(0.0, deadline - clock()))[1]:
            raise TimeoutError(f"it takes no bytes for {WRITE_TIMEOUT:g} s")
        with contextlib.suppress(BlockingIOError):
            data = data[os.write(port.fd, data) :]


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
