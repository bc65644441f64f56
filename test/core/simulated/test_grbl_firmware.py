"""How the carriage of the simulated GRBL moves; what it answers is compared with real firmware in test_answers.py."""

import itertools
import random

import pytest

from pushfric_core.simulated.grbl_firmware import SimulatedGrbl


@pytest.fixture
def clock() -> list[float]:
    """A clock that only the test advances [s]."""
    return [100.0]


def made(clock, **options) -> SimulatedGrbl:
    return SimulatedGrbl(lambda: clock[0], travel=0.1, max_speed=0.1, acceleration=0.1, **options)


def told(controller, *data: bytes) -> None:
    for one in data:
        controller._receive(one)
        controller._execute_lines()


def test_it_moves_with_trapezoidal_speed(clock):
    controller = made(clock)
    told(controller, b"G1 X40 F3000\n")  # 50 mm/s, reached in 0.5 s over 12.5 mm
    for seconds, millimetres, speed in ((0.0, 0.0, 0), (0.5, 12.5, 50), (0.7, 22.5, 50), (1.05, 36.875, 25)):
        clock[0] = 100.0 + seconds
        assert controller._now() == pytest.approx((millimetres, speed))
    clock[0] = 200.0
    assert controller.position() == pytest.approx(0.04)
    assert controller._state == "Idle"


def test_it_brakes_in_a_hold_goes_on_and_plans_ahead(clock):
    controller = made(clock)
    told(controller, b"G1 X40 F3000\n", b"X0\n")
    clock[0] += 0.5
    told(controller, b"!")
    clock[0] += 0.6
    assert controller.position() == pytest.approx(0.025)
    told(controller, b"~")
    clock[0] += 100
    assert controller.position() == pytest.approx(0.0)


def test_the_end_of_the_travel_is_a_hard_limit(clock):
    controller = made(clock)
    told(controller, b"G0 X500\n")
    while controller._state == "Run":
        assert clock[0] < 200.0
        clock[0] += 0.01
        assert 0.0 < controller.position() < 0.105
    assert controller._state == "Alarm"
    assert controller._deaf  # only a reset is accepted now
    controller.reset()
    assert controller._state == "Idle"


def test_it_homes_to_the_pull_off_before_its_switch(clock):
    controller = made(clock, homing=True)
    told(controller, b"G1 X1 F10\n")
    assert controller._state == "Alarm"
    told(controller, b"$H\n")
    while controller._state != "Idle":
        assert clock[0] < 200.0
        clock[0] += 0.5
        controller.position()
    assert controller._offset == -99.0  # [mm]: the pull-off is lost
    rest = controller.position()
    told(controller, b"G1 X1 F10\n")  # beyond the soft limit
    assert controller._state == "Alarm"
    assert controller.position() == rest == pytest.approx(0.0)


@pytest.mark.parametrize("seed", [1, 17, 27])
def test_the_simulated_carriage_keeps_its_speed_while_time_goes_on_between_any_two_steps(seed):
    """As on a busy machine: each look at the clock is later than the last, and a block may end between two."""
    randomly = random.Random(seed)
    times = itertools.accumulate(randomly.expovariate(1 / 0.002) for _ in itertools.count())
    controller = SimulatedGrbl(lambda: next(times))
    target, speeds = 0.0, []
    while target < 60.0:
        if target - 1e3 * controller.position() < 8.0:
            target += 1.5
            told(controller, b"$J=G21G90X%.3fF1200.000\n" % target)
        speeds.append(controller._now()[1])
    assert max(speeds) == pytest.approx(20.0, rel=1e-6)
    assert min(speeds) >= 0.0
