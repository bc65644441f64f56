"""The doctor's checks of a controller on a serial port; they move, hold, reset and unlock nothing."""

import contextlib
import grp
import math
import os
from collections.abc import Iterator

from serial.tools.list_ports import comports

from pushfric_core.pushers.pusher import Check, Grade, Limits, Mode, PusherConfig, PusherError, drive
from pushfric_core.pushers.serial_pusher import SerialPusher
from pushfric_core.pushers.serial_settings import SerialSettings

RAMP_SHARE = 0.1
"""The ramps to the speed of a push and from it may take this share of the push."""
ROUNDING = 1e-4
"""Tolerance of the pusher's positions [m]."""


def examine(serial: SerialSettings, config: PusherConfig, distance: float, speed: float) -> Iterator[Check]:
    """The checks, one after the other; a check whose premise failed is left out.

    Args:
        serial: the controller's port and axis.
        config: the stage.
        distance: of the planned pushes [m].
        speed: of the planned pushes [m/s].
    """
    port = check_port(serial.port)
    yield port
    if port.level is not Grade.FAILED:
        controller, limits = check_controller(serial, config)
        yield controller
        if limits is not None:
            yield check_limits(serial, config, distance, speed, limits)


def check_port(path: str) -> Check:
    """The serial port, untouched."""
    if not os.path.exists(path):
        there = ", ".join(port.device for port in comports()) or "none"
        advice = f"plug it in; existing ports: {there}; names that stay the same are under /dev/serial/by-id/"
        return Check("port", Grade.FAILED, f"no serial port at {path}", advice)
    if not os.access(path, os.R_OK | os.W_OK):
        try:
            group = grp.getgrgid(os.stat(path).st_gid).gr_name
        except KeyError:
            group = "dialout"
        return Check("port", Grade.FAILED, f"no permission to use {path}", f"sudo usermod -aG {group} $USER, then log in again")
    return Check("port", Grade.OK, path)


def check_controller(serial: SerialSettings, config: PusherConfig) -> tuple[Check, Limits | None]:
    """Who answers at the port, without doing anything to it; and its limits, if it is a controller at rest."""
    with contextlib.closing(SerialPusher(serial, only_look=True)) as pusher:
        try:
            pusher.connect()
            last = drive(pusher)
        except PusherError as error:
            advice = f"{serial.dialect().sign_of_life}; docs/hardware.md lists what can go wrong"
            return Check("controller", Grade.FAILED, str(error), advice), None
        position = last.position if last is not None else math.nan
        finding = f"{pusher.name}, {pusher.mode.value}" + (f", at {1e3 * position:z.1f} mm" if not config.home else "")
        at_rest = pusher.mode in (Mode.IDLE, Mode.ALARM)
        return judge(pusher.mode, position, finding, config), pusher.limits if at_rest else None


def judge(mode: Mode, position: float, finding: str, config: PusherConfig) -> Check:
    """Judge a controller that answers by its mode and its stroke position [m]."""
    if mode is Mode.ALARM and not config.home:
        advice = (
            "bring the pusher to its home end by hand, switch the controller off and on, and call ./pushfric reset in the run"
        )
        return Check("controller", Grade.WARNING, finding, advice)
    if mode in (Mode.RUNNING, Mode.HOMING):
        advice = "something else moves it, and the doctor did not interfere: wait, or stop it at the controller"
        return Check("controller", Grade.FAILED, f"{finding}: it moves now", advice)
    if mode not in (Mode.IDLE, Mode.ALARM):
        return Check("controller", Grade.WARNING, finding, "it accepts no motion: release its hold or door, or reset it")
    if not config.home and not -ROUNDING <= position <= config.stroke + ROUNDING:
        advice = "that is beyond the stroke: bring it to its home end, switch it off and on, or home it"
        return Check("controller", Grade.WARNING, finding, advice)
    return Check("controller", Grade.OK, finding)


def check_limits(serial: SerialSettings, config: PusherConfig, distance: float, speed: float, limits: Limits) -> Check:
    """Compare the controller's settings with what the cell's file asks of it."""
    travel_setting, speed_setting, acceleration_setting, _ = serial.dialect().settings_of(serial.axis[-1])
    travel = f"travel {1e3 * limits.travel:g} mm" if math.isfinite(limits.travel) else "travel neither enforced nor known"
    finding = f"{travel}, {1e3 * limits.max_speed:g} mm/s, {1e3 * limits.acceleration:g} mm/s^2"
    if config.stroke > limits.travel + ROUNDING:
        advice = f"shorten pusher.stroke, {1e3 * config.stroke:g} mm, or set {travel_setting} to the axis's travel"
        advice += "; where it homes ($22), the pull-off $27 counts as lost"
        return Check("limits", Grade.FAILED, finding, advice)
    if speed > limits.max_speed:
        return Check("limits", Grade.FAILED, finding, f"lower plan.speed, {1e3 * speed:g} mm/s, or raise {speed_setting}")
    if config.max_speed > limits.max_speed:
        advice = f"lower pusher.max_speed, {1e3 * config.max_speed:g} mm/s, or raise {speed_setting}"
        return Check("limits", Grade.WARNING, finding, advice)
    if speed**2 / limits.acceleration > RAMP_SHARE * distance:
        return Check(
            "limits", Grade.WARNING, finding, f"ramps take much of a push: raise {acceleration_setting}, or push more slowly"
        )
    return Check("limits", Grade.OK, finding)
