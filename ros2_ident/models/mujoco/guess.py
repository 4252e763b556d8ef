# SPDX-License-Identifier: Apache-2.0
"""Gains, friction and armature by inverse dynamics, for a search to begin with.

What a recorded motion asks of an actuator, less what the description's links ask, is linear in
them (Gautier, Janot, Vandanjon, IEEE TCST 21(2), 2013). Noise of the motion biases the estimate, a
free run then does not.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy

from ros2_ident.arrays import Array
from ros2_ident.recording import Dataset
from ros2_ident.recording.motion import allowed_cutoff, CUTOFF, fill_gaps, low_pass, smooth_motion

NAMES = 'kp', 'kv', 'armature', 'frictionloss', 'damping'
# Slower than this share of the top speed the direction of friction is open.
_SLOW = 0.05


def by_inverse_dynamics(
    plant: Any, data: Dataset, order: list[int], late: Array, known: Mapping[str, Array]
) -> dict[str, Array]:
    """Return estimates of `NAMES`, each (D,), at least 0, in the joints' units.

    Args:
        plant: The description, see `Plant`.
        data: The recording, with positions and set-points.
        order: Row in the recording of each drive.
        late: (D,) how late the set-points arrive, s.
        known: (D,) values by name, NaN where they are to be found; also `joint_zero` and
            `velocity_feedforward`.

    Raises:
        IdentError: BAD_VALUES where a joint has fewer than four positions.
    """
    assert data.position is not None and data.command_position is not None
    sense = np.array([[at.sense] for at in plant.places])
    raw = sense * (data.position[order] - known['joint_zero'])
    cutoff = allowed_cutoff(data.position[order], data.cycle, CUTOFF)
    # A set-point holds for a cycle, in whose middle the law is at its mean.
    q, v, a = smooth_motion(raw, data.cycle, cutoff, ahead=0.5)
    now = smooth_motion(raw, data.cycle, cutoff)
    wanted = sense * (data.command_position[order] - known['joint_zero'])
    time = np.arange(wanted.shape[1]) * data.cycle
    wanted = np.stack([np.interp(time - t, time, x) for t, x in zip(late, wanted, strict=True)])
    wanted = low_pass(wanted, data.cycle, cutoff)
    ahead = known['velocity_feedforward'] * np.gradient(wanted, data.cycle, axis=1)
    links = plant.inverse(q, v, a)
    gear = np.array([[plant.stated('actuator_gear', d)] for d in range(len(order))])
    in_cycle, at_start = (
        gear * np.stack([wanted - gear * x[0], ahead - gear * x[1]]) for x in ((q, v), now)
    )
    found = {name: np.array(known[name], dtype=float) for name in NAMES}
    unknown = np.isnan([found[name] for name in NAMES]).any(axis=0)
    for d in np.flatnonzero(unknown):
        resists = np.stack([a[d], np.sign(v[d]), v[d]])
        moves = np.abs(v[d]) >= _SLOW * np.abs(v[d]).max()
        # The law moves links, armature and friction ...
        rows, left = [np.concatenate([in_cycle[:, d], -resists])[:, moves]], [links[d, moves]]
        if data.effort is not None and np.isfinite(data.effort[order[d]]).any():
            effort = low_pass(sense[d] * fill_gaps(data.effort[order[d]]), data.cycle, cutoff)
            # ... and is the logged effort, at a cycle's beginning.
            rows.append(np.concatenate([at_start[:, d], 0.0 * resists])[:, moves])
            left.append(effort[moves])
        columns, right = np.concatenate(rows, axis=1), np.concatenate(left)
        own = np.array([found[name][d] for name in NAMES])
        free = np.isnan(own)
        right = right - own[~free] @ columns[~free]
        scale = np.maximum(np.linalg.norm(columns[free], axis=1), 1e-300)
        own[free] = scipy.optimize.nnls((columns[free] / scale[:, None]).T, right)[0] / scale
        for name, value in zip(NAMES, own, strict=True):
            found[name][d] = value
    return found
