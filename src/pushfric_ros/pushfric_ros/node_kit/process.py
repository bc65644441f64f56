"""A clean start and end of a node's process."""

import atexit
import contextlib
import faulthandler
import gc
import inspect
import itertools
import math
import os
import signal
import sys
import time
from collections.abc import Callable
from typing import NoReturn

import diagnostic_msgs.msg
import rcl_interfaces.msg
import rcl_interfaces.srv
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions, install_signal_handlers
from rclpy.type_support import check_for_type_support

import pushfric_msgs.msg
import pushfric_msgs.srv
from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_ros.node_kit.executor import NodeExecutor
from pushfric_ros.node_kit.lock import node_lock
from pushfric_ros.node_kit.network import configured
from pushfric_ros.node_kit.timers import wall_timer

EXIT_INVALID_INPUT = 2

URGENT, PATIENT = -10, 5
"""Niceness of what watches over a motion, and of what gives way to the rest of the cell: the view and the planner."""

WINDING_UP, LAST_WORDS = 5.0, 0.1
"""How long a node may take to wind up, and its last messages to leave [s]; `ros2 launch` kills a node after 10 s."""

HUNG = 60
"""A node that takes this long [s] to be made, or whose executor has not turned for so long, has hung: the kernel ends its
process by SIGALRM.

So the process that started the node sees it die. A watching thread, which could hang as well, is not needed. A stopped process
is ended when it goes on.
"""

LAST_RESORT, LAST_RESORT_IDLE = 5.0, 60.0
"""A process that was asked to end, or began to end, has this much CPU time [s] left before the kernel ends it; if it hangs
without using the CPU, the second time [s].

Fast DDS may spin for ever if it is destroyed while it learns of the end of another process (eProsima/Fast-DDS#6513), and it
keeps Python from running meanwhile. A healthy end takes 0.2 s of CPU time, but on a busy machine many times longer.
"""


def load_early() -> None:
    """Do now what rclpy does late, in each process: load the C side of messages, and index modules for the first log line."""
    for package in (pushfric_msgs.msg, pushfric_msgs.srv, diagnostic_msgs.msg, rcl_interfaces.msg, rcl_interfaces.srv):
        for message in vars(package).values():
            if isinstance(message, type):
                check_for_type_support(message)
    inspect.getmodule(sys._getframe())


def run_node(make: Callable[[], Node], winds_up: bool = False, images: bool = False, niceness: int = 0) -> NoReturn:
    """Make a node, spin it until SIGINT, SIGTERM or its own end, destroy it and leave.

    A name that another node has, bad parameters and unusable input (InvalidInput) end the process with one line and exit code
    2; any other PushfricError that a node raises while it is destroyed ends it with one line and exit code 1. A node ends its
    process by raising SystemExit in a callback, with an exit code, or with the line that says why it fails. A node that hangs
    is ended by SIGALRM after `HUNG`, and one that hangs at its end by SIGPROF or SIGALRM after `LAST_RESORT`. A node that
    `winds_up` has a method `wind_up`; after a signal it is called, while the node is still spun, until it returns True, so
    that the node can report how it ended. A node that sends or takes `images` gets memory for them (`network.configured`). A
    `niceness` below 0 is taken if the system allows it; doctor says whether it does.
    """
    with contextlib.suppress(PermissionError):  # before there are threads, which inherit it
        os.setpriority(os.PRIO_PROCESS, 0, niceness)
    # A KeyboardInterrupt could strike anywhere. rclpy's own handlers, which run before these, end the spinning.
    asked_to_stop: list[int] = []
    ending = False

    def limit_the_end() -> None:
        nonlocal ending
        if not ending:
            ending = True
            faulthandler.unregister(signal.SIGALRM)
            signal.setitimer(signal.ITIMER_PROF, LAST_RESORT)
            signal.setitimer(signal.ITIMER_REAL, LAST_RESORT_IDLE)

    def turn() -> None:
        if not ending:
            signal.alarm(HUNG)

    def stop(caught: int, _: object) -> None:
        asked_to_stop.append(caught)
        limit_the_end()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    faulthandler.register(signal.SIGALRM, chain=True)  # which then ends the process: where it hung is told
    turn()  # a node may hang while it is made, too
    node = executor = None
    code = 0
    name = contextlib.ExitStack()
    try:
        with configured(images):
            # rclpy's handlers would take the context from under a node that is being made
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
            if not asked_to_stop:
                executor = NodeExecutor()
                name.enter_context(node_lock(_full_name(make)))
                node = make()
                gc.freeze()  # what lasts as long as the node: collections that look at it all take tens of milliseconds
        if executor is not None and node is not None:
            executor.add_node(node)
            wall_timer(node, 1.0, turn)
            if winds_up:
                _spin_until(executor, lambda: bool(asked_to_stop))
                _spin_until(executor, node.wind_up, WINDING_UP)  # type: ignore[attr-defined]
                _spin_until(executor, lambda: False, LAST_WORDS)
            else:
                install_signal_handlers(SignalHandlerOptions.ALL)
                if not asked_to_stop:
                    executor.spin()
    except InvalidInput as error:
        code = _refuse(error)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else _refuse(PushfricError(str(end.code)))
    except ExternalShutdownException:
        pass
    except rclpy_implementation.RCLError:
        if not asked_to_stop:  # a real fault; after a signal, something was made or waited for without a context
            raise
    finally:
        limit_the_end()
        try:
            if node is not None:
                if executor is not None:
                    executor.remove_node(node)
                node.destroy_node()
        except PushfricError as error:
            code = _refuse(error)
        if executor is not None:
            executor.shutdown()
        rclpy.try_shutdown()
    del node, executor
    name.close()
    _leave(code)


def _full_name(make: Callable[[], Node]) -> str:
    """The full name that the process's arguments give the node.

    A node that is made to be asked for it would leave the graph again, which may hang (LAST_RESORT).
    """
    rules = [rule.partition(":=") for flag, rule in itertools.pairwise(sys.argv) if flag in ("-r", "--remap")]
    given = {name: to for name, _, to in reversed(rules)}  # the first one counts
    name = given.get("__node", make.__module__.rpartition(".")[2].strip("_"))
    return "/".join(("", *filter(None, given.get("__ns", "").split("/")), name))


def _leave(code: int) -> NoReturn:
    """End the process now: to tear down the interpreter would take longer than all the rest, and would undo nothing more."""
    # The middleware gives its shared memory back when the last handle of the node has gone.
    rclpy.get_default_context().destroy()
    gc.collect()
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):  # its reader has gone
            stream.flush()
    os._exit(code)


def _spin_until(executor: NodeExecutor, done: Callable[[], bool], seconds: float = math.inf) -> None:
    deadline = time.monotonic() + seconds
    while not done() and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.01)


def _refuse(error: PushfricError) -> int:
    print(f"error: {error}", file=sys.stderr, flush=True)
    return EXIT_INVALID_INPUT if isinstance(error, InvalidInput) else 1
