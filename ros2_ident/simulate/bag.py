# SPDX-License-Identifier: Apache-2.0
"""Bags of a simulated log: noise, resolution, jitter and losses, as of a recorder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.machine.machine import Machine
from ros2_ident.recording import Stream
from ros2_ident.simulate.effects import Added
from ros2_ident.simulate.log import Log, simulate
from ros2_ident.simulate.motions import Motion

Whole = np.ndarray[Any, np.dtype[np.int64]]

START = 1_700_000_000_000_000_000  # ns, stamp of the first sample


@dataclass(frozen=True)
class Nuisance:
    """Disturbances between a machine and its log.

    Attributes:
        effort_noise: Standard deviation of the logged effort [N m, or N].
        effort_step: Its resolution [N m, or N].
        position_step: Resolution of the logged position [m].
        velocity_noise: Standard deviation of the logged speed [m/s].
        jitter: Standard deviation of a stamp about its sample's time [s]; at most a third of the
            period.
        drop: Share of the samples that are lost, in each stream by itself.
        period: Time between two samples [s].
        command_velocity: Whether the command stream holds the set-point's derivative.
    """

    effort_noise: float = 0.01
    effort_step: float = 0.002
    position_step: float = 1e-6
    velocity_noise: float = 5e-5
    jitter: float = 10e-6
    drop: float = 1e-3
    period: float = 1e-3
    command_velocity: bool = False


CLEAN = Nuisance(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, command_velocity=True)


@dataclass(frozen=True)
class SimulatedBag:
    """A simulated log and the streams made of it.

    Attributes:
        streams: Streams by topic: `/joint_states`, `/effort`, `/joint_command`.
        log: The log before noise, at every controller cycle.
        motion: Its set-points.
    """

    streams: Mapping[str, Stream]
    log: Log
    motion: Motion


def nuisance_of(machine: Machine) -> Nuisance:
    """Return the nuisance of a machine file: its effort noise, a fifth of it as resolution."""
    noise = machine.effort_noise
    return Nuisance(effort_noise=noise, effort_step=0.2 * noise)


def _rounded(values: Array, step: float) -> Array:
    return np.asarray(step * np.round(values / step)) if step > 0.0 else values


def make_streams(
    log: Log, motion: Motion, nuisance: Nuisance, rng: np.random.Generator
) -> dict[str, Stream]:
    """Sample a simulated log as a recorder would.

    Args:
        log: What the machine did.
        motion: Its set-points.
        nuisance: What lies between.
        rng: Source of chance.

    Returns:
        Streams by topic.
    """
    every = max(1, round(nuisance.period / log.cycle))
    samples = np.arange(0, log.effort.shape[1], every)

    def stamps() -> tuple[Whole, Whole]:
        kept = samples[rng.random(samples.size) >= nuisance.drop]
        limit = 0.3 * every * log.cycle
        late = np.clip(nuisance.jitter * rng.standard_normal(kept.size), -limit, limit)
        ns = np.round((kept * log.cycle + late) * 1e9).astype(np.int64)
        return kept, START + ns

    streams = {}
    kept, stamp = stamps()
    speed = log.velocity[:, kept].T
    streams['/joint_states'] = Stream(
        log.names,
        stamp,
        position=_rounded(log.position[:, kept].T, nuisance.position_step),
        velocity=speed + nuisance.velocity_noise * rng.standard_normal(speed.shape),
    )
    kept, stamp = stamps()
    effort = log.effort[:, kept].T
    noisy = effort + nuisance.effort_noise * rng.standard_normal(effort.shape)
    streams['/effort'] = Stream(log.names, stamp, effort=_rounded(noisy, nuisance.effort_step))
    kept, stamp = stamps()
    streams['/joint_command'] = Stream(
        log.names,
        stamp,
        position=motion.position[:, kept].T,
        velocity=motion.velocity[:, kept].T if nuisance.command_velocity else None,
    )
    return streams


def simulate_bag(
    machine: Machine,
    parameters: Mapping[str, float],
    motion: Motion,
    seed: int = 0,
    nuisance: Nuisance | None = None,
    effects: Sequence[Added] = (),
) -> SimulatedBag:
    """Simulate a log and make streams of it.

    Args:
        machine: The machine.
        parameters: Parameters by name, see `simulate`.
        motion: Set-points, from `draw_motion`.
        seed: Seed of noise, jitter and losses, and of what is drawn of effects.
        nuisance: What lies between machine and log; by the machine file's noise where not given.
        effects: What the machine has beside the nominal physics.

    Raises:
        IdentError: As `simulate`.
    """
    log = simulate(machine, parameters, motion, effects, np.random.default_rng([seed, 1]))
    rng = np.random.default_rng(seed)
    streams = make_streams(log, motion, nuisance or nuisance_of(machine), rng)
    return SimulatedBag(streams, log, motion)
