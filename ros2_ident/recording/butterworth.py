# SPDX-License-Identifier: Apache-2.0
"""Butterworth low-pass of even order, forwards and backwards, with the numbers of `scipy.signal`.

To import that package takes longer than to filter a short log without it.
"""

import sys

import numpy as np
import scipy

from ros2_ident.recording.streams import FloatArray

# From so many values on the import is the shorter.
MANY = 300_000


def butterworth(order: int, share: float) -> tuple[FloatArray, FloatArray]:
    """Return poles (order,) and second-order sections (order / 2, 6), by the bilinear transform.

    Args:
        order: Even.
        share: Cutoff over half the rate.
    """
    wide = 4.0 * np.tan(np.pi * share / 2.0)
    analogue = -wide * np.exp(1j * np.pi * np.arange(1.0 - order, order, 2.0) / (2 * order))
    poles = (4.0 + analogue) / (4.0 - analogue)
    upper, lower = (x[np.argsort(x.real)] for x in (poles[poles.imag > 0], poles[poles.imag < 0]))
    pairs = (upper + lower.conj()) / 2
    # the pair nearest to the unit circle is the last
    pairs = pairs[np.argsort(np.abs(1 - np.abs(pairs)), kind='stable')[::-1]]
    sections = np.array([[1.0, 2.0, 1.0, *np.poly([p, p.conj()])] for p in pairs])
    sections[0, :3] *= wide**order * np.real(1.0 / np.prod(4.0 - analogue))
    return poles, sections


def forwards_and_backwards(sections: FloatArray, rows: FloatArray, reach: int) -> FloatArray:
    """Filter rows (..., K), continued at either end by `reach` values turned about the last."""
    first, last = 2 * rows[..., :1], 2 * rows[..., -1:]
    ends = rows[..., reach:0:-1], rows[..., -2 : -reach - 2 : -1]
    out = np.concatenate((first - ends[0], rows, last - ends[1]), axis=-1)
    flat = out.reshape(-1, out.shape[-1])
    # as if the first value had lasted
    still, gain = np.empty((len(sections), 2)), 1.0
    for state, (b0, b1, b2, a0, a1, a2) in zip(still, sections, strict=True):
        rest = np.linalg.solve([[a0 + a1, -1.0], [a2, 1.0]], [b1 - a1 * b0, b2 - a2 * b0])
        state[:] = gain * rest
        gain *= np.sum([b0, b1, b2]) / np.sum([a0, a1, a2])
    known = rows.size > MANY or 'scipy.signal' in sys.modules
    run = scipy.signal.sosfilt if known else _filtered
    for _ in range(2):
        for row in flat:
            row[:] = run(sections, row, zi=still * row[0])[0][::-1]
    return np.ascontiguousarray(out[..., reach : out.shape[-1] - reach])


def _filtered(sections: FloatArray, row: FloatArray, zi: FloatArray) -> tuple[list[float]]:
    """Filter a row (direct form II transposed) from a state on."""
    values = row.tolist()
    for (b0, b1, b2, _, a1, a2), (now, then) in zip(sections.tolist(), zi.tolist(), strict=True):
        for k, value in enumerate(values):
            values[k] = new = b0 * value + now
            now = b1 * value - a1 * new + then
            then = b2 * value - a2 * new
    return (values,)
