"""The non-dominated front of points that cost time and have an error, and its knee."""

from __future__ import annotations

import math
from collections.abc import Mapping


def front(points: Mapping[str, tuple[float, float]]) -> tuple[str, ...]:
    """Names of the points (time, error) that no other one beats in one and equals in the other; by time."""
    found: list[str] = []
    best = math.inf
    for name in sorted(points, key=lambda n: points[n]):
        if points[name][1] < best:
            found.append(name)
            best = points[name][1]
    return tuple(found)


def knee(points: Mapping[str, tuple[float, float]]) -> str:
    """The point of a front that lies furthest below the line from its fastest to its most exact point.

    Both axes logarithmic and scaled to 0..1 (Satopaa et al. 2011, "Kneedle"). Empty for fewer than three
    points, or where none lies below.
    """
    names = [n for n in front(points) if min(points[n]) > 0]
    if len(names) < 3:
        return ""
    logs = {n: (math.log(points[n][0]), math.log(points[n][1])) for n in names}
    (x0, y0), (x1, y1) = logs[names[0]], logs[names[-1]]
    below = {n: 1.0 - (x - x0) / (x1 - x0) - (y - y1) / (y0 - y1) for n, (x, y) in logs.items()}
    lowest = max(below, key=lambda n: below[n])
    return lowest if below[lowest] > 1e-9 else ""
