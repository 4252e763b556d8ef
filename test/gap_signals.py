# SPDX-License-Identifier: Apache-2.0
"""Motions, residuals and floors made for the tests of the gap's parts."""

import numpy as np
from scipy.signal import lfilter

from ros2_ident.gap.coordinates import Motion
from ros2_ident.gap.noise_floor import Floor
from ros2_ident.search.noise import NoiseModel

CYCLE = 5e-4
NOISE = 0.01


def white(deviation: float) -> NoiseModel:
    return NoiseModel(np.empty(0), deviation**2, deviation**2, 0)


def floor_of(drives: int = 2, value: float = NOISE) -> Floor:
    ones = np.ones(drives)
    low, high = 0.98 * value * ones, 1.02 * value * ones
    return Floor(value * ones, low, high, 'prediction', (white(value),) * drives)


def motion(seconds: float = 8.0, drives: int = 2, seed: int = 0) -> Motion:
    """Return moves of different lengths and speeds with rests between them."""
    generator = np.random.default_rng(seed)
    count = round(seconds / CYCLE)
    time = np.arange(count) * CYCLE
    position = np.zeros((drives, count))
    for d in range(drives):
        at = 0.3
        here = 0.5
        while at < seconds - 0.5:
            lasts = generator.uniform(0.15, 0.9)
            there = np.clip(here + generator.normal(0.0, 0.08), 0.4, 0.6)
            x = np.clip((time - at) / lasts, 0.0, 1.0)
            position[d] += (there - here) * (10.0 * x**3 - 15.0 * x**4 + 6.0 * x**5)
            here = there
            at += lasts + (0.2 if generator.random() < 0.3 else 0.0)
        position[d] += 0.5
    velocity = np.gradient(position, CYCLE, axis=1)
    acceleration = np.gradient(velocity, CYCLE, axis=1)
    load = 0.2 + 0.03 * acceleration + 0.01 * np.sin(2.0 * position / 0.05)
    torque = load + 0.05 * np.tanh(velocity / 0.005) + 0.03 * velocity
    return Motion(
        tuple(f'drive_{d + 1}' for d in range(drives)),
        CYCLE,
        np.full(drives, 78.54),
        position,
        velocity,
        acceleration,
        np.gradient(acceleration, CYCLE, axis=1),
        torque,
        load,
        'N m',
        'm',
        'N m',
        torque,
    )


def residual(
    of: Motion,
    planted: np.ndarray | None = None,
    drive: int = 0,
    *,
    phi: float = 0.0,
    noise: float = NOISE,
    seed: int = 0,
) -> np.ndarray:
    """Return noise sampled every other cycle, coloured by `phi`, with a signal on one drive."""
    drives, count = of.position.shape
    white = np.random.default_rng(seed).standard_normal((drives, count // 2 + 2000))
    coloured = lfilter([1.0], [1.0, -phi], white, axis=1)[:, 2000:] * np.sqrt(1.0 - phi**2)
    out = np.full((drives, count), np.nan)
    out[:, ::2] = noise * coloured[:, : (count + 1) // 2]
    if planted is not None:
        out[drive] += planted
    return out
