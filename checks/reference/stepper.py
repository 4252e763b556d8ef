# SPDX-License-Identifier: Apache-2.0
"""Adaptive Runge-Kutta of order 8 over one controller cycle: DOP853 of Hairer and Wanner.

Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, 1993, II.10; the
coefficients are scipy's. The controller holds its torque over a cycle, so the integration starts
anew at every cycle and never steps across a jump of the torque.
"""

import math

import numpy as np
from scipy.integrate._ivp import dop853_coefficients as table

from checks.reference import layout as at
from checks.reference.compiled import compiled
from checks.reference.dynamics import derivative, DriveLaw, project

Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]

STAGES = int(table.N_STAGES)
A = np.ascontiguousarray(table.A[:STAGES, :STAGES])
B = np.ascontiguousarray(table.B)
C = np.ascontiguousarray(table.C[:STAGES])
E3 = np.ascontiguousarray(table.E3)
E5 = np.ascontiguousarray(table.E5)
MOST = 20_000  # steps in a cycle; who needs more runs away
SHORTEST = 1e-10  # s; a step this short is taken as it is: it spans a kink, not a motion


@compiled
def error_ratio(
    slopes: Array, step: float, old: Array, new: Array, rtol: float, atol: float
) -> float:
    """Return the estimated error of a step over its tolerance, summed over all states.

    Returns:
        At most 1 where the step is good.
    """
    fifth = 0.0
    third = 0.0
    for j in range(old.size):
        scale = atol + rtol * max(abs(old[j]), abs(new[j]))
        five = 0.0
        three = 0.0
        for s in range(STAGES + 1):
            five += slopes[s, j] * E5[s]
            three += slopes[s, j] * E3[s]
        fifth += (five / scale) ** 2
        third += (three / scale) ** 2
    if fifth == 0.0 and third == 0.0:
        return 0.0
    return abs(step) * fifth / math.sqrt(fifth + 0.01 * third)


@compiled
def advance(
    law: DriveLaw,
    time: float,
    end: float,
    x: Array,
    held: Array,
    shared: Array,
    drive: Array,
    step: float,
    rtol: float,
    atol: float,
    slopes: Array,
    matrix: Array,
    side: Array,
    tally: Array,
) -> float:
    """Integrate the plant over one cycle of held torque.

    Args:
        x: (n,) state, changed in place.
        step: First step to try [s].
        tally: (3,) steps taken, steps refused, largest rod error before a correction [m]; added
            to.

    Returns:
        The step to try first in the next cycle [s], or -1 where the state is no longer finite, or
        the steps no longer get anywhere.
    """
    rods = shared[at.PLATFORM] == 1.0 and shared[at.RIGID] == 0.0
    derivative(law, time, x, held, shared, drive, matrix, side, slopes[0])
    trial = np.empty_like(x)
    tries = 0
    while time < end:
        tries += 1
        if tries > MOST:
            return -1.0
        last = step >= (end - time) * (1.0 - 1e-12)
        h = end - time if last else step
        for s in range(1, STAGES):
            for j in range(x.size):
                total = 0.0
                for r in range(s):
                    total += A[s, r] * slopes[r, j]
                trial[j] = x[j] + h * total
            stage = slopes[s]
            derivative(law, time + C[s] * h, trial, held, shared, drive, matrix, side, stage)
        for j in range(x.size):
            total = 0.0
            for s in range(STAGES):
                total += B[s] * slopes[s, j]
            trial[j] = x[j] + h * total
        derivative(law, time + h, trial, held, shared, drive, matrix, side, slopes[STAGES])
        ratio = error_ratio(slopes, h, x, trial, rtol, atol)
        if not math.isfinite(ratio):
            if h < SHORTEST:
                return -1.0
            step = 0.1 * h
            tally[1] += 1.0
            continue
        factor = 10.0 if ratio == 0.0 else min(10.0, max(0.2, 0.9 * ratio**-0.125))
        if ratio > 1.0 and h > SHORTEST:
            step = h * min(1.0, factor)
            tally[1] += 1.0
            continue
        time = end if last else time + h
        x[:] = trial
        slopes[0] = slopes[STAGES]
        tally[0] += 1.0
        # A last step cut short by the cycle's end says nothing against the longer one before it.
        step = max(step, h * factor) if last else h * factor
        if rods:
            tally[2] = max(tally[2], project(time, x, shared, drive, matrix, side))
    return step
