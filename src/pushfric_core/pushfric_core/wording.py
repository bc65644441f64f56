"""Numbers in sentences."""


def counted(number: int, one: str, several: str = "") -> str:
    """A number with its noun: 1 push, 2 pushes.

    Args:
        number: how many there are.
        one: the noun in the singular.
        several: the noun in the plural; empty: with an s.
    """
    return f"{number} {one if number == 1 else several or one + 's'}"


def data_of(data_points: int, pushes: int) -> str:
    """What an estimate rests on: 81 data points of 14 pushes."""
    return f"{counted(data_points, 'data point')} of {counted(pushes, 'push', 'pushes')}"
