"""Errors with physical, numerical or input reasons; a wrong argument is a ValueError."""


class PushfricError(Exception):
    """Base of all outcomes that a caller may want to catch and report."""


LONGEST = 1000
"""Characters of the text of an InvalidInput, which may quote input of any length."""


class InvalidInput(PushfricError):
    """A file or value from outside cannot be used. The text says on one line what is wrong, where, and what was expected."""

    def __init__(self, text: str) -> None:
        line = " ".join(text.splitlines())
        super().__init__(line if len(line) <= LONGEST else f"{line[:LONGEST]}...")


class UninformativePush(PushfricError):
    """A motion that says nothing about the support: the object did not move."""


class InfeasibleProgram(PushfricError):
    """No w satisfies the hard constraints of the linear program."""


class SolverFailed(PushfricError):
    """The solver stopped without a solution that it could certify."""


class SolverUnavailable(PushfricError):
    """The solver that is asked for needs a package that is not installed."""
