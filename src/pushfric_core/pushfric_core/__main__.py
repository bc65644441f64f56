"""`python3 -m pushfric_core`: the command line, which Ctrl-C ends quietly even while it is still being loaded."""
# ruff: noqa: E402

import _signal  # type: ignore[import-not-found]  # `signal` itself takes milliseconds to load

_signal.pthread_sigmask(_signal.SIG_BLOCK, {_signal.SIGINT})  # until `run` can answer

from pushfric_core.commands.program import run


def main() -> None:
    """Entry point."""
    run(_command_line)


def _command_line() -> None:
    try:
        from pushfric_core.commands import cli

        cli.main()
    except (ImportError, AttributeError, TypeError) as error:
        from pushfric_core.commands import dependencies

        dependencies.explain(error)
        raise


if __name__ == "__main__":
    main()
