"""Errors with physical, numerical or input reasons; a wrong argument is a ValueError."""


class PushfricError(Exception):
    """Base of all outcomes that a caller may want to catch and report."""


class InvalidInput(PushfricError):
    """A file or value from outside cannot be used. The text says what is wrong, where, and what was expected."""


class UninformativePush(PushfricError):
    """A motion that says nothing about the support: the object did not move."""


class InfeasibleProgram(PushfricError):
    """No w satisfies the hard constraints of the linear program."""


class SolverFailed(PushfricError):
    """The solver stopped without a solution that it could certify."""


class SolverUnavailable(PushfricError):
    """The solver that is asked for needs a package that is not installed."""
