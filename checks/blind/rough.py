# SPDX-License-Identifier: Apache-2.0
"""What lies between a machine and its log: coloured noise, a logger, a network, a recorder.

The noise is an autoregression; its size is the standard deviation of what the log holds beside the
machine's own effort.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from checks.blind.forms.outside import bad_state
from checks.reference.plant import Array, Log
from ros2_ident.recording import Stream
from ros2_ident.simulate.bag import START
from ros2_ident.simulate.motions import Motion

Whole = npt.NDArray[np.int64]

# Most by which the stated noise is off.
OFF = 2.5
HARD = (0.9, 0.99)


@dataclass(frozen=True)
class Rough:
    """The noise of one case's logs.

    Attributes:
        sigma: Standard deviation of the effort's noise [N m, or N].
        colour: Coefficients a_j of n_k = sum a_j n_(k-j) + white.
        smoothing: Samples over which the logger takes a mean; 1: none. What that does to the
            effort itself is an imperfection of the case.
        step: Resolution of the effort, in units of sigma.
        period: Time between two messages [s].
        clock: By how much the recorder's clock is fast; not zero: its log is resampled.
        jitter: Standard deviation of a stamp [s].
        drop: Share of the messages lost.
        burst: Mean length of a loss, in messages.
        position_step: Resolution of the logged position [m].
        velocity_noise: Standard deviation of the logged speed [m/s].
        stated: What the machine file says of the noise over what is true; 0: it says nothing.
        hard: Whether the colour is AR(1) of 0.9 or 0.99 and the stated noise off by `OFF`.
    """

    sigma: float
    colour: tuple[float, ...] = ()
    smoothing: int = 1
    step: float = 0.2
    period: float = 1e-3
    clock: float = 0.0
    jitter: float = 1e-5
    drop: float = 1e-3
    burst: float = 1.0
    position_step: float = 1e-6
    velocity_noise: float = 5e-5
    with_velocity: bool = True
    with_command_velocity: bool = False
    stated: float = 1.0
    hard: bool = False

    @property
    def memory(self) -> float:
        """First-order correlation of the autoregression."""
        a = (*self.colour, 0.0, 0.0)
        return a[0] / (1.0 - a[1])


def draw_rough(limit: float, rng: np.random.Generator, hard: bool) -> Rough:
    """Draw the noise of a case.

    Args:
        limit: The drives' torque limit; scales the noise [N m, or N].
    """

    def between(low: float, high: float) -> float:
        return float(low * (high / low) ** rng.random())

    off = float(rng.choice([1.0 / OFF, OFF]))
    stated = between(1.0 / OFF, OFF) if rng.random() > 0.15 else 0.0
    period = float(rng.choice([1e-3, 1e-3, 1e-3, 2e-3, 4e-3]))
    # Interpolation on a coarser grid would change the effort itself.
    resampled = period < 3e-3 and rng.random() < 0.3
    smoothed = period < 1.5e-3 and rng.random() < 0.4
    return Rough(
        sigma=limit * between(7e-4, 4e-3),
        colour=(float(rng.choice(HARD)),) if hard else draw_colour(rng),
        smoothing=int(rng.choice([2, 3])) if smoothed else 1,
        step=between(0.02, 1.5),
        period=period,
        clock=float(rng.uniform(-2e-4, 2e-4)) if resampled else 0.0,
        jitter=float(rng.uniform(2e-6, 6e-5)),
        drop=between(3e-4, 1.5e-2),
        burst=between(1.0, 5.0),
        position_step=between(2e-7, 8e-6),
        velocity_noise=between(2e-5, 3e-4),
        with_velocity=bool(rng.random() < 0.8),
        with_command_velocity=bool(rng.random() < 0.5),
        stated=off if hard else stated,
        hard=hard,
    )


def draw_colour(rng: np.random.Generator) -> tuple[float, ...]:
    """Draw white noise, or an autoregression of first or second order that is stable."""
    dice = rng.random()
    if dice < 0.25:
        return ()
    if dice < 0.7:
        return (float(1.0 - 10.0 ** rng.uniform(-2.0, -0.05)),)
    radius = float(rng.uniform(0.5, 0.98))
    angle = 2.0 * np.pi * float(rng.uniform(0.005, 0.2))
    return (2.0 * radius * np.cos(angle), -(radius**2))


def coloured(rough: Rough, shape: tuple[int, int], rng: np.random.Generator) -> Array:
    """Return noise (D, T) of the case's colour behind its logger, its deviation `sigma`."""
    settle = 2000
    white = rng.standard_normal((shape[0], shape[1] + settle))
    noise = lfilter([1.0], [1.0, *(-a for a in rough.colour)], white, axis=1)
    mean = np.full(rough.smoothing, 1.0 / rough.smoothing)
    noise = lfilter(mean, [1.0], noise, axis=1)[:, settle:]
    size = np.sqrt(np.mean(noise**2, axis=1, keepdims=True))
    return np.asarray(rough.sigma * noise / size)


def record(
    log: Log, motion: Motion, rough: Rough, rng: np.random.Generator
) -> tuple[dict[str, Stream], dict[str, Stream], Array]:
    """Record a simulated log.

    Returns:
        Streams by topic, the same with the machine's own effort, and (D,) the standard deviation
        of what the logged effort holds beside it.
    """
    every = max(1, round(rough.period / log.cycle))
    native = np.arange(0, log.effort.shape[1], every)
    noise = coloured(rough, (len(log.names), native.size), rng)
    first = float(rng.uniform(0.0, 0.9)) * every if rough.clock else 0.0
    grid = np.arange(first, native[-1], every * (1.0 + rough.clock))

    def taken(rows: Array) -> Array:
        """Return (T, D) rows as the recorder samples them: linear between the logger's."""
        return np.column_stack([np.interp(grid, native, row) for row in rows])

    clean = taken(log.effort[:, native])
    effort = _rounded(clean + taken(noise), rough.step * rough.sigma)
    true = np.sqrt(np.mean((effort - clean) ** 2, axis=0))
    place = _rounded(taken(log.position[:, native]), rough.position_step)
    speed = taken(log.velocity[:, native])
    speed = speed + rough.velocity_noise * rng.standard_normal(speed.shape)
    target, target_speed = taken(motion.position[:, native]), taken(motion.velocity[:, native])
    instants = grid * log.cycle
    streams, own = {}, {}
    state = {'position': place, 'velocity': speed if rough.with_velocity else None}
    ahead = target_speed if rough.with_command_velocity else None
    for topic, fields in (
        ('/joint_states', state),
        ('/effort', {'effort': effort}),
        ('/joint_command', {'position': target, 'velocity': ahead}),
    ):
        kept, stamp = _stamps(instants, rough, rng)
        there = {name: value[kept] for name, value in fields.items() if value is not None}
        streams[topic] = own[topic] = Stream(log.names, stamp, **there)
        if topic == '/effort':
            own[topic] = Stream(log.names, stamp, effort=clean[kept])
    return streams, own, np.asarray(true)


def _rounded(values: Array, step: float) -> Array:
    return np.asarray(step * np.round(values / step)) if step > 0.0 else values


def _stamps(
    instants: Array, rough: Rough, rng: np.random.Generator
) -> tuple[npt.NDArray[np.bool_], Whole]:
    """Return which messages came, and their stamps [ns]."""
    lost = bad_state(rng, instants.size, rough.drop, max(1.0 + 1e-9, rough.burst))
    limit = 0.3 * rough.period
    late = np.clip(rough.jitter * rng.standard_normal(instants.size), -limit, limit)
    stamp = START + np.round((instants + late) * 1e9).astype(np.int64)
    return ~lost, stamp[~lost]
