"""The command line, called in this process or in one of its own, and waiting for what must happen."""

import contextlib
import json
import pathlib
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

from click.testing import Result
from typer.testing import CliRunner

from pushfric_core.commands.cli import app

PROGRAM = (sys.executable, "-m", "pushfric_core")


def invoked(*arguments: object) -> Result:
    """A call in this process; `exception` is what it raised."""
    return CliRunner().invoke(app, list(map(str, arguments)))


def printed(*arguments: object) -> str:
    """What a call in this process prints to stdout; it must end well, or raises what it raises."""
    run = CliRunner().invoke(app, list(map(str, arguments)), catch_exceptions=False)
    assert run.exit_code == 0, run.output
    return run.stdout


def figures(*arguments: object) -> Any:
    """What a call in this process prints as JSON."""
    return json.loads(printed(*arguments, "--json"))


def pushfric(*arguments: object, **options: Any) -> subprocess.CompletedProcess[str]:
    """A call in a process of its own, until it ends."""
    given = {"capture_output": True, "text": True, "timeout": 500, "stdin": subprocess.DEVNULL} | options
    try:
        return subprocess.run([*PROGRAM, *map(str, arguments)], check=False, **given)
    except subprocess.TimeoutExpired as error:  # what it said tells why, for example that it waits for a person
        raise AssertionError((error.stderr or b"").decode()) from error


@contextlib.contextmanager
def killed_at_the_end(command: list[Any], **options: Any) -> Iterator[subprocess.Popen]:
    """A process that does not outlive what needs it."""
    with subprocess.Popen(command, **options) as process:
        try:
            yield process
        finally:
            process.kill()


@contextlib.contextmanager
def simulated_arm(log: pathlib.Path) -> Iterator[subprocess.Popen]:
    """The arm of the examples in a process of its own, which is told to end; all that it says is in this file."""
    arm = pathlib.Path(__file__).parents[1] / "examples/arm.py"
    with log.open("w") as said, killed_at_the_end([sys.executable, arm], stdout=said, stderr=said) as process:
        yield process
        process.terminate()
        process.wait(60)


def all_was_seen(run: subprocess.CompletedProcess[str]) -> bool:
    """Whether a run in real time ended well; if not, its camera or all of it paused, as on a busy machine, and it says so."""
    paused = any(f"\nerror: {what} came for" in run.stderr for what in ("no pose", "neither poses nor pusher states"))
    assert run.returncode == paused, run.stderr
    return not paused


def but_the_middleware(said: str) -> str:
    """What a process said but for Fast DDS's errors: it reports one where processes that start together want the same port."""
    return "".join(line for line in said.splitlines(keepends=True) if "RTPS_TRANSPORT_SHM" not in line)


def wait_until(condition: Callable[[], object], what: object = "the awaited event", seconds: float = 120.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"{what} did not happen within {seconds:g} s"
        time.sleep(0.005)
