# SPDX-License-Identifier: Apache-2.0
"""Loops of an MJCF that equality constraints close, put together where a simulation begins."""
# mypy: disable-error-code="no-any-return"

from collections.abc import Sequence
from typing import Any

import numpy as np

from ros2_ident.arrays import Array

# Steps to close a loop, and how far apart its ends may be, m or rad.
_STEPS, _CLOSED = 30, 1e-10


def close_loops(mj: Any, model: Any, data: Any, driven: Sequence[int]) -> None:
    """Move all joints but the driven ones until loops are closed, and give them their speeds.

    By Newton's method from the pose in `data` on, so a loop's branch is that pose's.

    Args:
        mj: MuJoCo.
        model: The model.
        data: Its pose and speeds, which are changed.
        driven: Degrees of freedom that stay as they are.
    """
    free = np.setdiff1d(np.arange(model.nv), driven)
    step = np.zeros(model.nv)
    for _ in range(_STEPS):
        slopes, apart = _constraints(mj, model, data)
        if np.abs(apart).max(initial=0.0) < _CLOSED:
            break
        step[free] = -np.linalg.lstsq(slopes[:, free], apart, rcond=None)[0]
        mj.mj_integratePos(model, data.qpos, step, 1.0)
    if len(apart):
        drawn = slopes[:, driven] @ data.qvel[driven]
        data.qvel[free] = -np.linalg.lstsq(slopes[:, free], drawn, rcond=None)[0]


def _constraints(mj: Any, model: Any, data: Any) -> tuple[Array, Array]:
    """Return the slopes (E, nv) of equality constraints, and how far apart their ends are (E,)."""
    own, model.opt.jacobian = model.opt.jacobian, mj.mjtJacobian.mjJAC_DENSE
    mj.mj_fwdPosition(model, data)
    model.opt.jacobian = own
    rows = data.efc_type == mj.mjtConstraint.mjCNSTR_EQUALITY
    return data.efc_J.reshape(-1, model.nv)[rows], data.efc_pos[rows]
