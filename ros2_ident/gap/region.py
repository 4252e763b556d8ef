# SPDX-License-Identifier: Apache-2.0
"""Region of a gap along a coordinate: the shortest one that holds most of it."""

from dataclasses import dataclass
import math
from typing import Literal

import numpy as np

from ros2_ident.arrays import Above, Array, Below
from ros2_ident.gap.coordinates import Coordinate, PHASES

# The regions that hold this share of what is explained are named.
_MOST = 0.75
# Phases that hold this share of it, and so many times their share of the time, are named.
_MAINLY, _DENSER = 0.5, 1.5
# A region wider than this share of the coordinate is all of it.
_WIDE = 0.8

Trend = Literal['', 'rising', 'falling']


@dataclass(frozen=True)
class Region:
    """A part of a coordinate.

    Attributes:
        low: Lower end; minus infinity where it reaches to the coordinate's end.
        high: Upper end likewise.
        unit: Unit of both.
        labels: The parts' names where the coordinate has no numbers.
    """

    low: Below = -math.inf
    high: Above = math.inf
    unit: str = ''
    labels: tuple[str, ...] = ()


def region_of(
    coordinate: Coordinate, fitted: Array, weight: Array, noise: float
) -> tuple[Region, Trend]:
    """Return where along a coordinate a fitted residual lies, and whether it grows along it.

    Args:
        coordinate: The coordinate.
        fitted: (T,) part of the residual that it explains, in the effort's unit.
        weight: (T,) samples that each entry stands for.
        noise: Noise floor.
    """
    if coordinate.pick:
        order = _order(coordinate, fitted, coordinate.pick)
        return Region(order, order, coordinate.unit), ''
    if coordinate.name in ('offset', 'recent acceleration'):
        return Region(), ''
    sides = np.sign(coordinate.columns)
    inside = np.abs(coordinate.columns) > 0.0
    if coordinate.labels and coordinate.name != 'phase':
        size = np.abs((coordinate.columns / coordinate.columns.std(axis=0)).T @ fitted)
        return Region(labels=(coordinate.labels[int(np.argmax(size))],)), ''
    if coordinate.labels:
        held = dict(zip(coordinate.labels, (weight * fitted**2) @ inside, strict=True))
        names = sorted(held, key=lambda name: -held[name])
        most = np.cumsum([held[name] for name in names]) >= _MOST * sum(held.values())
        return Region(labels=tuple(names[: 1 + int(np.argmax(most))])), ''
    counts = np.array([float(weight[c].sum()) for c in inside.T])
    means = np.array(
        [
            float(np.average((fitted * s)[c], weights=weight[c]))
            for s, c in zip(sides.T, inside.T, strict=True)
        ]
    )
    power = np.maximum(counts * means**2 - noise**2, 0.0)
    return _narrowest(coordinate, power)[0], _trend(means, coordinate.place.mean(axis=1), counts)


def concentration(
    coordinate: Coordinate, power: Array, time: Array
) -> tuple[Region, float, float]:
    """Return where the gap is large, the share of it that lies there, and that of the time.

    Args:
        coordinate: What cuts the motion into regions.
        power: (B,) squares above the noise in each region.
        time: (B,) samples in each region.
    """
    share, lasts = power / power.sum(), time / time.sum()
    if coordinate.labels:
        density = share / np.maximum(lasts, 1e-9)
        chosen: list[int] = []
        for i in np.argsort(-density):
            if share[chosen].sum() >= _MOST or density[i] < 1.0:
                break
            chosen.append(int(i))
        region = Region(labels=tuple(coordinate.labels[i] for i in chosen))
    else:
        region, first, last = _narrowest(coordinate, np.maximum(power, 0.0))
        chosen = list(range(first, last + 1))
    return region, float(share[chosen].sum()), float(lasts[chosen].sum())


def phase_of(power: Array, time: Array) -> str:
    """Return the phase that holds most of it; empty where none holds much more than its time.

    Args:
        power: (P,) what is explained in each phase.
        time: (P,) samples in each phase.
    """
    total, whole = float(power.sum()), float(time.sum())
    if total <= 0.0:
        return ''
    held, lasts = power / total, time / whole
    top = int(np.argmax(held))
    return PHASES[top] if held[top] >= max(_MAINLY, _DENSER * lasts[top]) else ''


def _order(coordinate: Coordinate, fitted: Array, size: int) -> float:
    """Return the motor order whose lines hold most."""
    columns = coordinate.columns / np.linalg.norm(coordinate.columns, axis=0)
    power = (columns.T @ fitted) ** 2
    groups = power.reshape(-1, size).sum(axis=1)
    return float(coordinate.place[size * int(np.argmax(groups)), 0])


def _narrowest(coordinate: Coordinate, power: Array) -> tuple[Region, int, int]:
    """Return the shortest region that holds most of the power (B,), and its end columns."""
    total = np.concatenate([[0.0], np.cumsum(power)])
    size = len(power)
    best = (size, 0.0, 0, size - 1)
    for first in range(size if total[-1] > 0.0 else 0):
        enough = np.flatnonzero(total[first + 1 :] - total[first] >= _MOST * total[-1])
        if enough.size:
            last = first + int(enough[0])
            best = min(best, (last - first, -(total[last + 1] - total[first]), first, last))
    first, last = best[2:]
    if last - first + 1 > _WIDE * size:
        return Region(), first, last
    low = coordinate.place[first, 0] if first else -math.inf
    high = coordinate.place[last, 1] if first == 0 or last < size - 1 else math.inf
    return Region(float(low), float(high), coordinate.unit), first, last


def _trend(means: Array, centres: Array, counts: Array) -> Trend:
    """Return whether the means go up or down along the coordinate."""
    if means.size < 4:
        return ''
    a = centres - np.average(centres, weights=counts)
    b = means - np.average(means, weights=counts)
    spread = np.sqrt(np.average(a**2, weights=counts) * np.average(b**2, weights=counts))
    slope = float(np.average(a * b, weights=counts)) / max(float(spread), 1e-300)
    return 'rising' if slope > 0.9 else 'falling' if slope < -0.9 else ''
