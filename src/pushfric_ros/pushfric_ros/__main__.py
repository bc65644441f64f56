"""`python3 -m pushfric_ros`: the command line, which Ctrl-C ends quietly even while it is still being loaded."""

import signal

from pushfric_ros.commands.interrupt import end_at_once


def main() -> None:
    """Entry point."""
    before = end_at_once()
    from pushfric_ros.commands import cli  # takes a second or two

    try:
        signal.signal(signal.SIGINT, before)
        cli.main()
    finally:
        end_at_once()


if __name__ == "__main__":
    main()
