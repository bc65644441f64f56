"""What can go wrong for physical, numerical or input reasons; a plain wrong argument is a ValueError."""


class PushfricError(Exception):
    """Base of every outcome a caller may want to catch and report."""


class InvalidInput(PushfricError):
    """Something a person handed in cannot be used. The text says what, where, and what was expected."""


class UninformativePush(PushfricError):
    """A motion that says nothing about the support: the object did not move."""


class InfeasibleProgram(PushfricError):
    """No w satisfies the hard constraints of the linear program."""


class SolverFailed(PushfricError):
    """The solver stopped without a solution it could certify."""


class SolverUnavailable(PushfricError):
    """The solver that is asked for needs a package that is not installed."""
