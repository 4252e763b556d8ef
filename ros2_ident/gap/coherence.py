# SPDX-License-Identifier: Apache-2.0
"""Whether a residual follows a coordinate more coherently than its own memory would make it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ros2_ident.arrays import Array
from ros2_ident.gap.blocks import FEWEST
from ros2_ident.gap.coordinates import Coordinate
from ros2_ident.gates.scale import STEP
from ros2_ident.identify.hidden import SETTLE
from ros2_ident.search.noise import correlation_time

# A block is so many times as long as the residual's memory.
_TIMES = 12.0
# A drive whose slow gap is below this share of the floor has nothing to be explained.
LEAST = 0.1


@dataclass(frozen=True)
class Coarse:
    """A drive's residual on the coarse grid.

    Attributes:
        at: (T,) cycles.
        value: (T,) mean residual times the root of `weight`.
        weight: (T,) samples averaged.
        block: (T,) number of the block.
        explainable: Sum of squares above the noise.
        widen: Factor on what chance gives, for the memory that reaches across blocks.
    """

    at: NDArray[np.int64]
    value: Array
    weight: Array
    block: NDArray[np.int64]
    explainable: float
    widen: float


def coarse_of(row: Array, cycle: float, noise: float) -> Coarse | None:
    """Return the means of a residual over short stretches; None where there are too few.

    Args:
        row: (K,) residual, NaN where there is no sample.
        cycle: Time from column to column, s.
        noise: The drive's noise floor.
    """
    stride = max(1, round(STEP / cycle))
    size = row.size // stride * stride
    parts = row[:size].reshape(-1, stride)
    there = np.isfinite(parts)
    weight = there.sum(axis=1).astype(float)
    keep = weight > 0.0
    if keep.sum() < 10 * FEWEST:
        return None
    total = np.where(there, parts, 0.0).sum(axis=1)[keep]
    weight = weight[keep]
    at = (np.flatnonzero(keep) * stride + stride // 2).astype(np.int64)
    value = total / np.sqrt(weight)
    block, widen = blocks_of(total / weight, at, cycle, row.size)
    explainable = float(value @ value) - noise**2 * value.size
    if explainable < (LEAST * noise) ** 2 * float(weight.sum()):
        # Nothing to share out; what is found is stated as a share of this little then.
        explainable = (LEAST * noise) ** 2 * float(weight.sum())
    return Coarse(at, value, weight, block, explainable, widen)


def blocks_of(
    mean: Array, at: NDArray[np.int64], cycle: float, size: int
) -> tuple[NDArray[np.int64], float]:
    """Return the number of each value's block (T,), and the factor `Coarse.widen`.

    Args:
        mean: (T,) residual on the coarse grid.
        at: (T,) cycles.
        cycle: Time of a cycle, s.
        size: Cycles of the log.
    """
    stride = float(np.median(np.diff(at)))
    memory = correlation_time(mean)
    length = max(SETTLE / cycle, _TIMES * memory * stride)
    length = max(1.0, min(length, size / FEWEST))
    block = np.unique((at // length).astype(np.int64), return_inverse=True)[1]
    # What neighbouring blocks have in common is lost with the coin: their part of the variance.
    return block, 1.0 / (1.0 - min(0.5 * (memory - 1.0) * stride / length, 1.0 / 3.0))


def orthonormal(columns: Array, weight: Array, constant: bool) -> Array:
    """Return an orthonormal basis of weighted columns, without the constant unless asked for."""
    root = np.sqrt(weight)[:, None]
    weighted = columns * root
    if not constant:
        one = root / np.linalg.norm(root)
        weighted = weighted - one * (one * weighted).sum(axis=0)
    weighted = weighted / np.maximum(np.sqrt((weighted**2).sum(axis=0)), 1e-300)
    # By the small Gram matrix: a decomposition of the long one would wake the library's threads.
    size, turn = np.linalg.eigh(np.einsum('tb,tc->bc', weighted, weighted))
    keep = size > 1e-8 * max(float(size.max(initial=0.0)), 1e-300)
    kept: Array = np.einsum('tb,bc->tc', weighted, turn[:, keep] / np.sqrt(size[keep]))
    return kept


def bases_of(coordinate: Coordinate, weight: Array) -> list[Array]:
    """Return one basis, or one for each group of columns where only the best group counts."""
    if coordinate.pick is None:
        return [orthonormal(coordinate.columns, weight, False)]
    groups = range(0, coordinate.columns.shape[1], coordinate.pick)
    return [
        orthonormal(coordinate.columns[:, g : g + coordinate.pick], weight, False) for g in groups
    ]


def tested(
    values: Sequence[Array],
    bases: Sequence[Sequence[Array]],
    block: NDArray[np.int64],
    widen: float,
    signs: Array,
    explainable: float,
) -> list[tuple[float, float, Array]]:
    """Return for each coordinate its share, its p-value and the basis that explains most."""
    out = []
    for value, groups in zip(values, bases, strict=True):
        observed, chance, best = -1.0, np.zeros(len(signs)), groups[0]
        for basis in groups:
            parts = np.zeros((signs.shape[1], basis.shape[1]))
            np.add.at(parts, block, basis * value[:, None])
            square = float((parts.sum(axis=0) ** 2).sum())
            chance = np.maximum(chance, widen * (thrown(signs, parts) ** 2).sum(axis=1))
            if square > observed:
                observed, best = square, basis
        p_value = (1.0 + float((chance >= observed).sum())) / (1.0 + chance.size)
        expected = float(chance.mean())
        gain = max(0.0, observed - expected)
        out.append((gain / max(explainable - expected, gain, 1e-300), p_value, best))
    return out


def thrown(signs: Array, parts: Array) -> Array:
    """Return signs @ parts, without the library's threads: they cost more than they bring here."""
    out: Array = np.einsum('fn,nb->fb', signs, parts)
    return out
