"""The ledger as JSON and as a table."""

from typing import TYPE_CHECKING, Any

from pushfric_core.trajectories.ledger import REASONS, Ledger

if TYPE_CHECKING:
    from rich.table import Table


def account(ledger: Ledger) -> dict[str, Any]:
    """The accounts by kind, and what does not add up."""
    return {
        "accounts": ledger.sums(),
        "doubts": [one._asdict() for one in ledger.doubts],
        "remarks": [one._asdict() for one in ledger.remarks],
    }


def table(ledger: Ledger) -> "Table":
    """The sums, one column for each kind."""
    from rich.table import Table  # imported late: the estimator's process draws no tables

    sums = ledger.sums()
    shown = Table(box=None, pad_edge=False, header_style="bold")
    shown.add_column("")
    for kind in sums:
        shown.add_column(kind, justify="right")
    for row in rows(ledger):
        shown.add_row(*row)
    return shown


def rows(ledger: Ledger) -> list[list[str]]:
    """A line for each reason that occurs: its name, and the number of each kind."""
    sums = ledger.sums().values()
    reasons = [reason for reason in ("received", *REASONS) if any(reason in account for account in sums)]
    return [[reason, *(str(account.get(reason, "")) for account in sums)] for reason in reasons]


def sums_in_words(ledger: Ledger) -> dict[str, str]:
    """For each kind, its sums in one line, for diagnostics: 871 received, 600 used, ..."""
    return {kind: ", ".join(f"{number} {reason}" for reason, number in sums.items()) for kind, sums in ledger.sums().items()}
