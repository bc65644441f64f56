"""A group of commands, in plain help."""

from typing import Any

import typer.core


class Group(typer.core.TyperGroup):
    """Lists its commands with the whole first paragraph of their help, however narrow the terminal."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        commands = [self.get_command(ctx, name) for name in self.list_commands(ctx)]
        rows = [(str(one.name), (one.help or "").split("\n\n")[0]) for one in commands if one is not None]
        with formatter.section("Commands"):
            formatter.write_dl([(name, " ".join(text.split())) for name, text in rows])
