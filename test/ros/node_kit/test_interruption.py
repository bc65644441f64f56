"""Ctrl-C that comes while rclpy works."""

import os
import signal

import pytest

from pushfric_ros.node_kit.visit import held_back


def test_ctrl_c_takes_effect_at_the_end():
    done = []

    def work():
        with held_back():
            os.kill(os.getpid(), signal.SIGINT)
            done.append("the work")

    with pytest.raises(KeyboardInterrupt):
        work()
    assert done == ["the work"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
