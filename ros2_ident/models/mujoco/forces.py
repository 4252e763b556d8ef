# SPDX-License-Identifier: Apache-2.0
"""Effects as forces and friction on the joints of candidates, at a step's beginning.

Forces are held over the step. Friction is not: its size goes to the simulator, whose own
constraint holds a joint that rests.
"""

from typing import Any

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.effects import Hook
from ros2_ident.kernel import drive as dk
from ros2_ident.kernel import hooks, rows
from ros2_ident.kernel.rows import DRIVE, DRIVE_COUNT, MACHINE_COUNT, MEMORY, MEMORY_COUNT
from ros2_ident.lanes import (
    absolute,
    inlined,
    kernel,
    load,
    maximum,
    padded,
    spread,
    store,
    where,
    WIDTH,
    with_sign,
)

W = WIDTH
# Hooks whose effects a joint of the simulator can have.
HOOKS = frozenset({Hook.FRICTION, Hook.TORQUE, Hook.CARRIAGE_FORCE})


@inlined
def _at_joint(par, first, mem, on, q, v, a, effort, friction, time, step):  # type: ignore[no-untyped-def]
    """Return the size of friction and the force besides, N m or N, on a joint.

    By the actuator's effort and the size of friction in the step before.
    """
    zero = spread(0.0)
    still = absolute(v) <= zero
    direction = with_sign(spread(1.0), where(still, effort, v))
    drag = load(par, (first + DRIVE.viscous) * W) * v
    carried = effort - friction * direction - drag
    carried = carried - load(par, (first + DRIVE.motor_mass) * W) * a
    store(mem, MEMORY.commanded * W, effort)
    state = dk.drive_state(
        par, first, mem, 0, q, v, q, carried, direction, spread(time), spread(step)
    )
    nominal = state.coulomb * direction + drag
    if on & hooks.KEEPING.FRICTION:
        hooks.friction_keeps(nominal, state, on, par, first, mem, 0, None)
    sized = hooks.friction_hook(nominal, state, on, par, first, mem, 0) - drag
    force = hooks.torque_hook(effort, state, on, par, first, mem, 0) - effort
    force = force + hooks.carriage_hook(zero, state, on, par, first, mem, 0)
    return maximum(sized * direction, zero), force


def _build(digest: str) -> Any:
    @kernel
    def forces(blocks, on, memory, seen, time, step, out):  # type: ignore[no-untyped-def]
        """Fill what the joints of G vectors of candidates feel.

        Args:
            blocks: (G, R * W) rows of the candidates.
            on: (D,) flags of the effects.
            memory: (G, D * MEMORY_COUNT * W) what they remember.
            seen: (4 * D * G * W,) position, velocity, acceleration and effort.
            time: Since the log's start, s.
            step: Of the simulator, s.
            out: (2 * D * G * W,) size of friction, read as that of the step before; other forces.
        """
        _ = digest
        groups, drives = blocks.shape[0], on.shape[0]
        mine = MEMORY_COUNT * W
        for g in range(groups):
            for d in range(drives):
                at = (d * groups + g) * W
                next_one = drives * groups * W
                friction, force = _at_joint(
                    blocks[g], MACHINE_COUNT + d * DRIVE_COUNT,
                    memory[g, d * mine : (d + 1) * mine], on[d], load(seen, at),
                    load(seen, at + next_one), load(seen, at + 2 * next_one),
                    load(seen, at + 3 * next_one), load(out, at), time, step,
                )  # fmt: skip
                store(out, at, friction)
                store(out, at + next_one, force)

    return forces


_forces = _build(hooks.sources_digest())


class Forces:
    """Effects on the joints of S candidates, from the log's start on.

    Args:
        block: (S, R) rows of the candidates, friction and armature as the simulator has them.
        on: (D,) flags of the effects.
        step: Of the simulator, s.
    """

    def __init__(self, block: Array, on: Any, step: float) -> None:
        self._count, self._on, self._step = len(block), on, step
        self._blocks = padded(block).reshape(-1, block.shape[1] * W)
        groups, drives = len(self._blocks), len(on)
        self._memory = np.zeros((groups, drives * MEMORY_COUNT * W))
        self._seen = np.zeros((4, drives, groups * W))
        self._out = np.zeros((2, drives, groups * W))
        self._out[0, :, : self._count] = rows.of(block, 'coulomb', drives).T

    def at(self, time: float, position: Array, velocity: Array, effort: Array) -> Array:
        """Return (2, S, D) size of friction and other forces at a step's beginning, N m or N.

        Args:
            time: Since the log's start, s.
            position: (S, D), as the log counts.
            velocity: (S, D).
            effort: (S, D) of the actuators.
        """
        seen = self._seen[:, :, : self._count]
        seen[2] = (velocity.T - seen[1]) / self._step if time > 0.0 else 0.0
        seen[0], seen[1], seen[3] = position.T, velocity.T, effort.T
        _forces(
            self._blocks, self._on, self._memory, self._seen.ravel(), time, self._step,
            self._out.ravel(),
        )  # fmt: skip
        return self._out[:, :, : self._count].swapaxes(1, 2)
