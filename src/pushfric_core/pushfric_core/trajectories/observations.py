"""The observations that an estimate rests on, in order, and as a table."""

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, overload

from pushfric_core.errors import extra
from pushfric_core.trajectories.observation import Observation
from pushfric_core.wording import data_of

if TYPE_CHECKING:
    import pandas

UNKNOWN = (math.nan, math.nan, math.nan)


class Observations(Sequence[Observation]):
    """Observations in order; they never change. `to_frame` makes a table of them.

    Args:
        observations: a list is not copied, and may grow, if `count` is given.
        count: how many of the observations these are, from the first on; None: all.

    Example:
        >>> from pushfric_core import Observation, Observations, Twist
        >>> pushes = Observations([Observation((0.01, -0.03), (0.0, -1.0), Twist(0.0, 0.02, 0.1), push_id=4)])
        >>> len(pushes), pushes[0].push_id
        (1, 4)
    """

    def __init__(self, observations: Iterable[Observation] = (), count: int | None = None) -> None:
        self._all = observations if isinstance(observations, list) and count is not None else tuple(observations)
        self._count = len(self._all) if count is None else count

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[Observation]:
        return iter(self._all[: self._count])

    @overload
    def __getitem__(self, index: int) -> Observation: ...
    @overload
    def __getitem__(self, index: slice) -> "Observations": ...
    def __getitem__(self, index: int | slice) -> "Observation | Observations":
        if isinstance(index, slice):
            return Observations(self._all[: self._count][index])
        return self._all[range(self._count)[index]]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and tuple(self) == tuple(other)

    def __hash__(self) -> int:
        return hash(tuple(self))

    def __repr__(self) -> str:
        pushes = len({observation.push_id for observation in self})
        return f"<{type(self).__name__}: {data_of(len(self), pushes)}>"

    def to_rows(self) -> list[dict[str, float]]:
        """The rows of `to_frame`, by the names of its columns."""
        return [_row(observation) for observation in self]

    def to_frame(self) -> "pandas.DataFrame":
        """A table with a row for each observation, object frame, SI units; NaN where something is not known.

        Its columns are those of a CSV of observations, so `to_frame().to_csv(path, index=False)` writes what `load` reads, and
        then `duration` [s], `stamp` [ns], `pose_x`, `pose_y`, `pose_theta` (table frame) and `depth` [m].

        Raises:
            MissingPackage: pandas is not installed.
        """
        with extra("pandas", "to_frame"):
            import pandas
        return pandas.DataFrame(self.to_rows())


def _row(observation: Observation) -> dict[str, float]:
    force_x, force_y = observation.force or UNKNOWN[:2]
    tip_vx, tip_vy = observation.tip_velocity or UNKNOWN[:2]
    pose_x, pose_y, pose_theta = observation.pose or UNKNOWN
    return {
        "push_id": observation.push_id,
        "contact_x": observation.contact_point[0],
        "contact_y": observation.contact_point[1],
        "normal_x": observation.contact_normal[0],
        "normal_y": observation.contact_normal[1],
        "vx": observation.twist.vx,
        "vy": observation.twist.vy,
        "omega": observation.twist.omega,
        "half_width": observation.half_width,
        "force_x": force_x,
        "force_y": force_y,
        "tip_vx": tip_vx,
        "tip_vy": tip_vy,
        "duration": math.nan if observation.duration is None else observation.duration,
        "stamp": observation.stamp,
        "pose_x": pose_x,
        "pose_y": pose_y,
        "pose_theta": pose_theta,
        "depth": math.nan if observation.depth is None else observation.depth,
    }
