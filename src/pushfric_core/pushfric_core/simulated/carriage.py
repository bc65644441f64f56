"""How a carriage moves along its rail: pieces of constant acceleration, as the planner of a controller makes them."""

import math
from collections.abc import Sequence
from typing import NamedTuple


class CarriageMotion(NamedTuple):
    """Pieces of constant acceleration [(s, mm/s^2)], from a position [mm] and speed [mm/s] at a time [s]."""

    begin: float
    position: float
    speed: float
    pieces: tuple[tuple[float, float], ...]

    @property
    def end(self) -> float:
        return self.begin + sum(duration for duration, _ in self.pieces)

    def at(self, now: float) -> tuple[float, float]:
        """Position [mm] and speed [mm/s]."""
        position, speed, left = self.position, self.speed, max(0.0, now - self.begin)
        for duration, acceleration in self.pieces:
            t = min(left, duration)
            position += speed * t + acceleration * t * t / 2
            speed += acceleration * t
            left -= t
        return position, speed


def blended(
    begin: float, position: float, speed: float, lines: Sequence[tuple[float, float]], acceleration: float
) -> tuple[CarriageMotion, list[float]]:
    """The motion through several lines, to rest: GRBL's planner in one dimension.

    If a line goes on in the direction of the line before, the carriage keeps the slower of the two speeds; if the direction
    is reversed, it stops.

    Args:
        begin: now [s].
        position: of the carriage [mm].
        speed: of the carriage [mm/s].
        lines: target [mm] and speed [mm/s] of each.
        acceleration: [mm/s^2]
    Returns:
        The motion, and when each line ends [s].
    """
    starts = [position, *(target for target, _ in lines[:-1])]
    ways = [target - start for start, (target, _) in zip(starts, lines, strict=True)]
    joints = [abs(speed)] + [0.0] * len(lines)  # speed at the beginning of each line, and at the end of the last
    for i in range(1, len(lines)):
        joints[i] = min(lines[i - 1][1], lines[i][1]) if ways[i - 1] * ways[i] > 0 else 0.0
    for i in reversed(range(1, len(lines))):
        joints[i] = min(joints[i], math.sqrt(joints[i + 1] ** 2 + 2 * acceleration * abs(ways[i])))
    for i, way in enumerate(ways):
        joints[i + 1] = min(joints[i + 1], math.sqrt(joints[i] ** 2 + 2 * acceleration * abs(way)))
    pieces: list[tuple[float, float]] = []
    ends = []
    elapsed = begin
    for i, (way, (_, fastest)) in enumerate(zip(ways, lines, strict=True)):
        for duration, pull in _ramps(abs(way), joints[i], joints[i + 1], fastest, acceleration):
            pieces.append((duration, math.copysign(pull, pull * way)))
            elapsed += duration
        ends.append(elapsed)
    return CarriageMotion(begin, position, speed, tuple(pieces)), ends


def _ramps(way: float, first: float, last: float, fastest: float, acceleration: float) -> list[tuple[float, float]]:
    """Ramps up or down to the greatest speed that a line allows, along at it, and down to the speed at its end."""
    peak = min(max(fastest, last), math.sqrt((first**2 + last**2) / 2 + acceleration * way))
    up, down = abs(peak - first) / acceleration, (peak - last) / acceleration
    along = way - up * (first + peak) / 2 - down * (peak + last) / 2
    level = max(0.0, along) / peak if peak else 0.0
    return [(up, math.copysign(acceleration, peak - first)), (level, 0.0), (down, -acceleration)]
