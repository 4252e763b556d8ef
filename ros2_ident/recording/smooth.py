# SPDX-License-Identifier: Apache-2.0
"""Zero-phase smoothing of recorded motion, and its derivatives."""

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording.streams import FloatArray

_ORDER = 4


# The highest cutoff, in shares of the rate: the filter needs room below half of it.
ROOM = 0.2


def allowed_cutoff(position: FloatArray, cycle: float, wanted: float) -> float:
    """Return the cutoff with which positions can be smoothed, as near to the wanted one as may be.

    Args:
        position: Measured positions (D, K), NaN at cycles without a sample.
        cycle: Time from cycle to cycle, s.
        wanted: Frequency up to which motion is wanted, Hz.

    Returns:
        The frequency wanted, or a fifth of the rate of the slowest drive's samples, Hz.
    """
    there = [np.flatnonzero(np.isfinite(row)) for row in np.atleast_2d(position)]
    steps = [float(np.median(np.diff(t))) for t in there if t.size > 1]
    return min(wanted, ROOM / (max(steps, default=1.0) * cycle))


def smooth_motion(
    position: FloatArray, cycle: float, cutoff: float, ahead: float = 0.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Smooth recorded positions and differentiate them twice, without delay.

    Cycles without a sample are filled by a cubic spline through the samples. A Butterworth
    low-pass of order 4 runs forwards and backwards (its gain at `cutoff` is then a half, not
    0.71); velocity and acceleration are the derivatives of a quintic spline through the result,
    exact for the frequencies that pass.

    Both ends are continued by point reflection, as if the motion went on with the velocity it has
    there. Motion that starts and ends at rest is therefore reproduced to its ends; else the
    acceleration of the first and last `1 / cutoff` seconds is drawn towards zero and better left
    out.

    Args:
        position: Measured positions (D, K), rad or m, NaN at cycles without a sample.
        cycle: Time from cycle to cycle, s.
        cutoff: Frequency up to which motion is kept, Hz; below half the sampling rate.
        ahead: Cycles after each cycle's beginning at which the motion is wanted, 0 to 1.

    Returns:
        Position, velocity and acceleration, each (D, K), without NaN; before a drive's first and
        after its last sample it stands still.

    Raises:
        IdentError: BAD_VALUES where a drive has fewer than four samples or the cutoff does not fit
            the rate.
    """
    position = np.atleast_2d(np.asarray(position, dtype=np.float64))
    filled = np.empty_like(position)
    time = np.arange(position.shape[1], dtype=np.float64)
    for row, samples in enumerate(position):
        there = np.flatnonzero(np.isfinite(samples))
        if there.size < 4:
            raise IdentError(
                ErrorCode.BAD_VALUES,
                f'drive {row + 1} of {position.shape[0]} has {there.size} position samples, at '
                'least 4 are needed; record a longer motion',
            )
        rate = 1.0 / (float(np.median(np.diff(there))) * cycle)
        if not 0.0 < cutoff < 0.5 * rate:
            raise IdentError(
                ErrorCode.BAD_VALUES,
                f'the smoothing cutoff is {cutoff:g} Hz but positions come at {rate:g} Hz; choose '
                f'one between 0 and {0.5 * rate:g} Hz',
            )
        if there.size == samples.size:
            filled[row] = samples
        else:
            spline = make_interp_spline(time[there], samples[there], k=3)
            filled[row] = spline(np.clip(time, there[0], there[-1]))
    smooth = low_pass(filled, cycle, cutoff)
    # time in cycles keeps the spline's knots well scaled
    time = np.arange(smooth.shape[1], dtype=np.float64)
    spline = make_interp_spline(time, smooth, k=5 if time.size > 5 else 3, axis=1)
    if ahead:
        time += ahead
        smooth = np.ascontiguousarray(spline(time))
    velocity = np.ascontiguousarray(spline(time, 1)) / cycle
    acceleration = np.ascontiguousarray(spline(time, 2)) / cycle**2
    return smooth, velocity, acceleration


def settling(cycle: float, cutoff: float) -> int:
    """Return after how many cycles `low_pass` has forgotten an end of a log to a thousandth."""
    poles = butter(_ORDER, cutoff, fs=1.0 / cycle, output='zpk')[1]
    return int(np.ceil(np.log(1e-3) / np.log(np.abs(poles).max())))


def low_pass(values: FloatArray, cycle: float, cutoff: float, order: int = _ORDER) -> FloatArray:
    """Low-pass rows forwards and backwards: no delay.

    Args:
        values: Rows (..., K) without NaN.
        cycle: Time from column to column, s.
        cutoff: Frequency of gain one half, Hz; at or above half the rate the values come back as
            they are.
        order: Of the Butterworth filter that runs each way.

    Returns:
        The smooth rows (..., K).
    """
    if cutoff >= 0.499 / cycle:
        return np.array(values, dtype=np.float64)
    sections = butter(order, cutoff, fs=1.0 / cycle, output='sos')
    # the filter has forgotten its start after a few periods of the cutoff
    reach = min(values.shape[-1] - 1, int(np.ceil(3.0 / (cutoff * cycle))))
    out: FloatArray = sosfiltfilt(sections, values, axis=-1, padtype='odd', padlen=reach)
    return np.ascontiguousarray(out)
