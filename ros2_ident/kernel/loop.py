# SPDX-License-Identifier: Apache-2.0
"""The loop over blocks of candidates and the log's pieces, the same for every machine.

A machine gives two compiled functions: how it starts, and how it moves through a piece of
`measurement.PIECE` cycles. Both are inlined: the loop costs nothing and a machine's kernel is
compiled as if it were written out.
"""
# mypy: ignore-errors

import numpy as np

from ros2_ident.kernel import measurement
from ros2_ident.lanes import copied, inlined, WIDTH

W = WIDTH


@inlined
def _finite(place, rate, finite):
    """Write 1 for lanes in which every coordinate is finite, else 0."""
    for lane in range(W):
        finite[lane] = 1.0
        for r in range(place.size // W):
            if not np.isfinite(place[r * W + lane] + rate[r * W + lane]):
                finite[lane] = 0.0


@inlined
def simulate(
    start, advance, inputs, blocks, rows, substeps, state, going, begin, end, cycle, place, rate,
    kept, torques, moves, finite, rest, wanted, measured, samples, weights, moving, limits, out,
):  # fmt: skip
    """Simulate blocks of candidates from cycle `begin` to `end`.

    Args:
        start: `start(par, cycle, count, *inputs)` writes where a block's motion begins.
        advance: `advance(par, substeps, first, cycles, cycle, count, *inputs)` simulates so many
            cycles from `first` on and writes `torques`, and where they are wanted `moves`.
        inputs: What the two share: room to work in and the recording.
        blocks: (G, R * W) rows of `kernel.rows`.
        rows: (G, W) row of `out` for each lane, -1 for none; becomes -1 for a lane that is given
            up.
        substeps: (G, 2 * W) integration steps in a cycle, while fast and otherwise.
        state: (G, ...) what goes on from one part of the log to the next; need not be set for the
            first.
        going: The part of the room that goes on so; `place`, `rate` and `kept` lie in it.
        begin: First cycle of this part of the log, a multiple of `measurement.PIECE`.
        end: Cycle behind its last, likewise, or the number of cycles.
        cycle: Controller cycle [s].
        place: Positions of the coordinates.
        rate: Their rates.
        kept, torques, moves, finite, rest: Room for `measurement`.
        wanted, measured, samples, weights, moving, limits, out: As for `measurement`.
    """
    count = wanted.shape[2]
    for g in range(blocks.shape[0]):
        par = blocks[g]
        if begin > 0:
            copied(state[g], going)
        else:
            going[:] = 0.0
            start(par, cycle, count, *inputs)
        for first in range(begin, end, measurement.PIECE):
            cycles = min(measurement.PIECE, end - first)
            advance(par, substeps[g], first, cycles, cycle, count, *inputs)
            measurement.hand_on(
                par, torques, moves, first, cycles, cycle, wanted, measured, samples, moving,
                rows[g], kept, rest, out,
            )  # fmt: skip
            if measurement.give_up(samples, weights, rows[g], limits, kept, out):
                break
        copied(going, state[g])
        if end == count:
            _finite(place, rate, finite)
            measurement.conclude(par, finite, measured, samples, weights, rows[g], kept, out)
