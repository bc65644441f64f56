"""`python3 -m pushfric_ros`: the command line, which Ctrl-C ends quietly even while it is still being loaded."""

import signal

from pushfric_ros.commands.interrupt import end_at_once


def main() -> None:
    """Entry point."""
    before = end_at_once()
    try:
        from pushfric_ros.commands import cli

        signal.signal(signal.SIGINT, before)
        cli.main()
    except (ImportError, AttributeError, TypeError):
        from pushfric_ros.commands import dependencies

        dependencies.explain()
        raise
    finally:
        end_at_once()


if __name__ == "__main__":
    main()
