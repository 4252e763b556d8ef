# SPDX-License-Identifier: Apache-2.0
"""Dry friction as a passive force of MuJoCo, compiled: it is asked for four times a step.

MuJoCo's own `frictionloss` is a constraint and ideally dry. The machine file states a regularised
sign, M_C tanh(v / v_eps), so that one is brought in as the callback `mjcb_passive`.
"""

from collections.abc import Iterator
from contextlib import contextmanager
import ctypes
import math
from typing import Any

import mujoco
from numba import carray, cfunc, types
from numba.extending import intrinsic
import numpy as np

SPEED, FORCE, WIDTH, COUNT, FIRST = 0, 1, 2, 3, 4
DOF, FORWARD, BACKWARD, STRIDE = 0, 1, 2, 3
ROOM = 4
# Where the compiled function finds addresses and numbers: 8-byte words, floats by their bits.
TABLE = np.zeros(FIRST + ROOM * STRIDE)
WORDS = TABLE.view(np.int64)
HERE = TABLE.ctypes.data


def _pointer_to(kind: Any) -> Any:
    """Return a compiled function that makes a pointer of an address."""

    @intrinsic
    def pointer(typingctx: Any, address: Any) -> Any:
        made = types.CPointer(kind)

        def cast(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return builder.inttoptr(args[0], context.get_value_type(made))

        return made(types.int64), cast

    return pointer


_doubles, _words = _pointer_to(types.float64), _pointer_to(types.int64)


@cfunc(types.void(types.voidptr, types.voidptr))
def _passive(model, data):
    table = carray(_doubles(HERE), (FIRST + ROOM * STRIDE,))
    words = carray(_words(HERE), (FIRST + ROOM * STRIDE,))
    speed = carray(_doubles(words[SPEED]), (64,))
    force = carray(_doubles(words[FORCE]), (64,))
    for i in range(words[COUNT]):
        at = FIRST + i * STRIDE
        dof = words[at + DOF]
        rate = speed[dof]
        level = table[at + FORWARD] if rate > 0.0 else table[at + BACKWARD]
        force[dof] -= level * math.tanh(rate / table[WIDTH])


@contextmanager
def dry_friction(
    data: mujoco.MjData, dofs: list[int], levels: list[tuple[float, float]], width: float
) -> Iterator[None]:
    """Let joints of a simulation have dry friction while the context lasts.

    Args:
        levels: Of each, friction forwards and backwards [N m].
        width: Speed over which the sign is regularised [rad/s].
    """
    WORDS[SPEED], WORDS[FORCE] = data.qvel.ctypes.data, data.qfrc_passive.ctypes.data
    WORDS[COUNT], TABLE[WIDTH] = len(dofs), width
    for i, (dof, (forward, backward)) in enumerate(zip(dofs, levels, strict=True)):
        at = FIRST + i * STRIDE
        WORDS[at + DOF] = dof
        TABLE[at + FORWARD], TABLE[at + BACKWARD] = forward, backward
    pointer = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(_passive.address)
    mujoco.set_mjcb_passive(pointer)
    try:
        yield
    finally:
        mujoco.set_mjcb_passive(None)
