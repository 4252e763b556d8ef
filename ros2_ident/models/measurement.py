# SPDX-License-Identifier: Apache-2.0
"""From the torque a controller commanded to the one a log holds; and a candidate's cost."""
# mypy: ignore-errors

from numba import njit
import numpy as np

from ros2_ident.lanes import WIDTH
from ros2_ident.models.hooks import sources_digest
from ros2_ident.models.rows import DRIVE_COUNT, MACHINE_COUNT, row_of

W = WIDTH
DELAY, GAIN, BIAS, LAG, CROSSTALK = (
    row_of(name, 0) - MACHINE_COUNT
    for name in ('effort_delay', 'effort_gain', 'effort_bias', 'effort_lag', 'effort_crosstalk')
)


@njit
def _logged(block, torque, finite, cycle, out):
    """Write what the log of eight candidates holds.

    Args:
        block: (R * 8,) rows of the candidates.
        torque: (D, K, 8) commanded torque.
        finite: (8,) 1.0 where the candidate stayed finite.
        cycle: Controller cycle [s].
        out: (8, D, K) logged torque, written; inf where the candidate diverged. The delay
            interpolates linearly between cycles; before the first cycle the torque is the first
            one.
    """
    drives, count, _ = torque.shape
    for lane in range(W):
        for d in range(drives):
            row = MACHINE_COUNT + d * DRIVE_COUNT
            gain = block[(row + GAIN) * W + lane]
            bias = block[(row + BIAS) * W + lane]
            lag = block[(row + LAG) * W + lane]
            cross = block[(row + CROSSTALK) * W + lane]
            delay = block[(row + DELAY) * W + lane] / cycle
            target = out[lane, d]
            if finite[lane] == 0.0 or not np.isfinite(delay) or delay < 0.0:
                target[:] = np.inf
                continue
            keep = np.exp(-cycle / lag) if lag > 0.0 else 0.0
            whole = int(np.floor(delay))
            part = delay - whole
            before = 0.0
            value = 0.0
            for k in range(-1, count - whole):
                source = max(k, 0)
                raw = gain * torque[d, source, lane] + bias
                if cross != 0.0:
                    for other in range(drives):
                        if other != d:
                            raw += cross * torque[other, source, lane]
                if k <= 0 and lag > 0.0:
                    value = raw
                elif lag > 0.0:
                    value = keep * value + (1.0 - keep) * raw
                else:
                    value = raw
                if k < 0:
                    before = value
                    continue
                if k == 0:
                    for j in range(min(whole, count)):
                        target[j] = value
                target[k + whole] = value + part * (before - value)
                before = value


def _build(digest):
    @njit(nogil=True, cache=True)
    def logged(blocks, torque, finite, cycle, out):
        """Write the logged torque of all blocks into `out` (G * 8, D, K); see `_logged`."""
        _ = digest
        for g in range(blocks.shape[0]):
            _logged(blocks[g], torque[g], finite[g], cycle, out[g * W : (g + 1) * W])

    @njit(nogil=True, cache=True)
    def costs(simulated, measured, out):
        """Write eq. 2 of the paper for each candidate: the RMS error averaged over the outputs.

        Args:
            simulated: (S, D, K) logged torque.
            measured: (D, K) measured torque, NaN where there is no sample.
            out: (S,) cost, written; inf for a diverged candidate. Outputs without a sample do not
                count.
        """
        _ = digest
        for i in range(simulated.shape[0]):
            total = 0.0
            outputs = 0
            for d in range(measured.shape[0]):
                square = 0.0
                samples = 0
                for k in range(measured.shape[1]):
                    if not np.isnan(measured[d, k]):
                        error = measured[d, k] - simulated[i, d, k]
                        square += error * error
                        samples += 1
                if samples:
                    total += np.sqrt(square / samples)
                    outputs += 1
            out[i] = total / outputs if np.isfinite(total) and outputs else np.inf

    return logged, costs


logged, costs = _build(sources_digest())
