# SPDX-License-Identifier: Apache-2.0
"""Controllers replayed on the recorded motion, without a plant.

No machine is simulated. What a controller makes of the motion in the log tells its own deviations,
and those of the measurement behind it, from everything that happens in the machine.
"""
# mypy: ignore-errors

from ros2_ident.kernel import drive as dk
from ros2_ident.kernel import measurement
from ros2_ident.kernel.hooks import sources_digest
from ros2_ident.kernel.rows import DRIVE_COUNT, MACHINE_COUNT, MEMORY_COUNT
from ros2_ident.lanes import kernel, parted, spread, store, WIDTH

W = WIDTH


def room(drives: int) -> int:
    """Return how many numbers of room the replay of so many drives needs."""
    each = MEMORY_COUNT + measurement.PIECE + measurement.KEPT
    return int((drives * each + measurement.ROOM) * W)


def _build(digest):
    @kernel
    def replay(blocks, rows, room, command, motion, hold, on, delayed, ahead, cycle, law, task):
        """Run the controllers of blocks of candidates along a recorded motion.

        Args:
            blocks: (G, R * W) rows of `kernel.rows`.
            rows: (G, W) row of `out` for each lane, -1 for none.
            room: (`room(D)`,) to work in.
            command: (2 * D * K,) set-point positions of the drives, then their rates.
            motion: (2 * D * K,) recorded positions, then velocities.
            hold: (D,) torque at the start, for the integral part [N m].
            on: (D,) flags of the effects.
            delayed: Whether command delays are on.
            ahead: (D * K,) what the controllers add to their torque; None for nothing.
            cycle: Controller cycle [s].
            law: (D,) VELOCITY_FROM_STATE or VELOCITY_FROM_POSITIONS.
            task: A `Task`; its weights and limits are not looked at.
        """
        _ = digest
        drives = on.shape[0]
        count = command.shape[0] // (2 * drives)
        mem, rest = parted(room, drives * MEMORY_COUNT)
        torques, rest = parted(rest, drives * measurement.PIECE)
        kept, rest = parted(rest, drives * measurement.KEPT)
        for g in range(blocks.shape[0]):
            par = blocks[g]
            mem[:] = 0.0
            kept[:] = 0.0
            for d in range(drives):
                start = spread(motion[d * count])
                still = spread(0.0)
                dk.begin(mem, d * MEMORY_COUNT, law[d], start, still, cycle, spread(hold[d]))
            for k in range(count):
                piece = k % measurement.PIECE
                for d in range(drives):
                    first = MACHINE_COUNT + d * DRIVE_COUNT
                    z = spread(motion[d * count + k])
                    v = spread(motion[(drives + d) * count + k])
                    torque = dk.control(
                        par, first, mem, d * MEMORY_COUNT, on[d], law[d], cycle, z, v,
                        command, d, drives, count, k, delayed, spread(k * cycle),
                        ahead, cycle, None,
                    )  # fmt: skip
                    store(torques, (d * measurement.PIECE + piece) * W, torque)
                if piece == measurement.PIECE - 1 or k == count - 1:
                    measurement.hand_on(
                        par, torques, torques, k - piece, piece + 1, cycle, task, rows[g], kept,
                        rest,
                    )  # fmt: skip
            measurement.conclude(par, mem[:0], task, rows[g], kept)

    return replay


replay = _build(sources_digest())
