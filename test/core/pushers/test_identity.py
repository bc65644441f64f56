"""What tells one serial device from another."""

import math
import os
import types

import pytest

from pushfric_core.errors import InvalidInput
from pushfric_core.pushers import serial_line
from pushfric_core.pushers.position_memory import PositionMemory
from pushfric_core.pushers.serial_line import identity_of


def test_a_position_that_trembles_is_not_written_again(tmp_path):
    """239 times in 6 s, with 2 um of noise, inside the loop that watches over the motion."""
    memory = PositionMemory(str(tmp_path), "port")
    file = tmp_path / "port.json"
    memory.keep(0.01)
    assert memory.settle(60) is None
    first = file.stat().st_ino
    for tremble in (2e-6, -2e-6, 1.9e-5):
        memory.keep(0.01 + tremble)
        assert memory.settle(60) is None
    assert file.stat().st_ino == first
    memory.keep(math.nan)
    assert memory.settle(60) is None
    assert math.isnan(PositionMemory(str(tmp_path), "port").recall())


def test_a_disk_that_refuses_is_said_and_holds_nothing_up(tmp_path):
    (tmp_path / "file").write_text("")
    memory = PositionMemory(str(tmp_path / "file"), "port")
    memory.keep(0.01)
    assert isinstance(memory.settle(60), InvalidInput)
    assert memory.settled
    (tmp_path / "file").unlink()
    memory.keep(0.01)
    assert memory.settle(60) is None
    assert PositionMemory(str(tmp_path / "file"), "port").recall() == 0.01


def test_every_link_to_a_port_leads_to_the_same_device(tmp_path):
    master, slave = os.openpty()
    try:
        port = os.ttyname(slave)
        (tmp_path / "by-id").symlink_to(port)
        (tmp_path / "again").symlink_to(tmp_path / "by-id")
        assert identity_of(port) == port
        assert identity_of(str(tmp_path / "again")) == port
        assert port.startswith("/")
    finally:
        os.close(master)
        os.close(slave)


@pytest.mark.parametrize(
    ("device", "text"),
    [
        ({"serial_number": "A50285BI"}, "usb:0403:6001:A50285BI:1.0"),
        ({"serial_number": "A50285BI", "usb_interface_path": "/sys/bus/1-2:1.1"}, "usb:0403:6001:A50285BI:1.1"),
        ({}, "usb-socket:1-2:1.0"),
    ],
)
def test_a_usb_device_is_known_by_its_number_else_by_its_socket(monkeypatch, device, text):
    usb = {"serial_number": None, "usb_interface_path": "/sys/bus/1-2:1.0", "location": "1-2:1.0", "vid": 0x0403, "pid": 0x6001}
    monkeypatch.setattr(serial_line, "SysFS", lambda path: types.SimpleNamespace(**usb | device))
    assert identity_of("/dev/ttyUSB0") == identity_of("/dev/ttyUSB7") == text
    assert not text.startswith("/")
