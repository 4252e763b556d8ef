# SPDX-License-Identifier: Apache-2.0
"""Simulated logs and their bags: noise, resolution, jitter and losses, as of a recorder.

The model that identifies a machine simulates its log.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import math
from pathlib import Path
import sys

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.effects import Effect, get_effect, SOURCES
from ros2_ident.errors import ErrorCode
from ros2_ident.machine.machine import Machine
from ros2_ident.models.protocol import EffectAt, FullModel
from ros2_ident.models.registry import drives_moved, planned_model
from ros2_ident.recording import Stream
from ros2_ident.simulate.motions import Motion

START = 1_700_000_000_000_000_000  # ns, stamp of the first sample


@dataclass(frozen=True)
class Log:
    """Motion and efforts of a machine at every controller cycle.

    Attributes:
        names: Joint names of the drives.
        cycle: Controller cycle [s].
        effort: (D, K) logged effort, late by the measurement delay [N m, or N].
        position: (D, K) position of the drives [m, or rad].
        velocity: (D, K) its derivative.
        effects: Values of the effects' parameters by their full names.
    """

    names: tuple[str, ...]
    cycle: float
    effort: Array
    position: Array
    velocity: Array
    effects: Mapping[str, float] = field(default_factory=dict, kw_only=True)


@dataclass(frozen=True)
class Added:
    """An effect with its numbers.

    Attributes:
        where: Drives that it sits on; all where empty.
        values: Its parameters by their short names, physical units.
    """

    effect: Effect
    where: tuple[str, ...]
    values: Mapping[str, float]

    def places(self, machine: Machine) -> list[EffectAt]:
        """Return where it sits in a machine."""
        if self.effect.place == 'all':
            return [EffectAt(self.effect.id, 'all')]
        return [EffectAt(self.effect.id, drive) for drive in self.where or machine.drives]


def read_effect(text: str) -> Added:
    """Read an effect from a command line.

    Args:
        text: `stribeck@drive_2:torque=0.05,velocity=0.03`; without `@` it sits on all drives, with
            `@drive_1+drive_2` on these. In place of its id, the file of an effect of your own that
            `add_effect_files` has read.

    Raises:
        IdentError: INVALID_GOAL where the text cannot be read, UNKNOWN_PARAMETER for an effect
        that is not known or values that are not its.
    """
    head, _, tail = text.partition(':')
    name, _, place = head.partition('@')
    try:
        pairs = [part.split('=') for part in tail.split(',') if part]
        values = {key: float(number) for key, number in pairs}
    except ValueError:
        raise ErrorCode.INVALID_GOAL.error(
            f'cannot read the effect {text!r}; write as stribeck@drive_2:torque=0.05,velocity=0.03'
        ) from None
    if name.endswith('.py'):
        effect: Effect = sys.modules[SOURCES[Path(name).expanduser().resolve()]].EFFECT
    else:
        effect = get_effect(name)
    known = [p.name for p in effect.parameters]
    if set(values) != set(known):
        raise ErrorCode.UNKNOWN_PARAMETER.error(
            f'effect {effect.id} needs the values {", ".join(known)}; '
            f'found {", ".join(values) or "none"}'
        )
    return Added(effect, tuple(place.split('+')) if place not in ('', 'all') else (), values)


def simulate(
    machine: Machine,
    parameters: Mapping[str, float],
    motion: Motion,
    effects: Sequence[Added] = (),
) -> Log:
    """Simulate a log.

    Args:
        parameters: Parameters by name, SI units; `gear_stiffness` is that of every drive. What a
            description holds is as described where not given.
        motion: Set-points of the drives.
        effects: What the machine has beside the nominal physics.

    Returns:
        The log; what the kind does not simulate is as planned.

    Raises:
        IdentError: INVALID_GOAL for an effect that has no place in the machine, UNKNOWN_PARAMETER
        for a parameter without a value, DIVERGED where the machine runs away.
    """
    if 'bandwidth' in machine.constants:
        # A log holds all frequencies, whatever is compared of it.
        machine = machine.with_constants(bandwidth=math.inf)
    model = planned_model(machine, motion.position, motion.velocity)
    values = {**parameters, **model.as_described(parameters)}
    each = [(at, effect) for effect in effects for at in effect.places(machine)]
    there = [at for at, _ in each]
    added = {f'{at.prefix}{name}': x for at, one in each for name, x in one.values.items()}
    offered = {*model.extensions(), *model.extensions(changed=True)} if there else set()
    for at in there:
        if at not in offered:
            raise ErrorCode.INVALID_GOAL.error(
                f'{at.effect} has no place on {at.where} of this machine; choose from '
                f'{", ".join(sorted({x.effect for x in offered})) or "none"}'
            )
    if there:
        model = planned_model(machine, motion.position, motion.velocity, effects=there)
    told = model.simulate(_theta(model, values | added)[None])[0]
    if not np.isfinite(told).all():
        raise ErrorCode.DIVERGED.error('the simulation diverged; set milder parameters or effects')
    rows = drives_moved(model, motion.position, motion.velocity, told)
    quantities = {output.quantity for output in model.outputs}
    if 'position' in quantities and 'velocity' not in quantities:
        rows['velocity'] = np.gradient(rows['position'], model.cycle, axis=1)
    return Log(machine.drives, model.cycle, **rows, effects=added)


def _theta(model: FullModel, values: Mapping[str, float]) -> Array:
    """Return (N,) the parameters of a model by their names, or by those that all drives share."""
    out = []
    for name in (p.name for p in model.parameters):
        base = name.rpartition('.')[2]
        if name not in values and base not in values:
            raise ErrorCode.UNKNOWN_PARAMETER.error(f'{name} has no value; give {name} or {base}')
        out.append(values[name if name in values else base])
    return np.array(out)


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
    """

    streams: Mapping[str, Stream]
    log: Log


def nuisance_of(machine: Machine) -> Nuisance:
    """Return the nuisance of a machine file: its effort noise, a fifth of it as resolution."""
    noise = machine.effort_noise
    return Nuisance(effort_noise=noise, effort_step=0.2 * noise)


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

    def stream(**rows: tuple[Array, float | None, float]) -> Stream:
        """Sample (D, K) rows, each with its noise, None for none, and its resolution."""
        kept = samples[rng.random(samples.size) >= nuisance.drop]
        limit = 0.3 * every * log.cycle
        late = np.clip(nuisance.jitter * rng.standard_normal(kept.size), -limit, limit)
        stamp = START + np.round((kept * log.cycle + late) * 1e9).astype(np.int64)
        sampled = {}
        for name, (row, noise, step) in rows.items():
            values = row[:, kept].T
            if noise is not None:
                values = values + noise * rng.standard_normal(values.shape)
            sampled[name] = step * np.round(values / step) if step > 0.0 else values
        return Stream(log.names, stamp, **sampled)

    told = {'position': (motion.position, None, 0.0)}
    if nuisance.command_velocity:
        told['velocity'] = motion.velocity, None, 0.0
    return {
        '/joint_states': stream(
            position=(log.position, None, nuisance.position_step),
            velocity=(log.velocity, nuisance.velocity_noise, 0.0),
        ),
        '/effort': stream(effort=(log.effort, nuisance.effort_noise, nuisance.effort_step)),
        '/joint_command': stream(**told),
    }


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
        parameters: Parameters by name, see `simulate`.
        motion: Set-points, from `draw_motion`.
        seed: Seed of noise, jitter and losses.
        nuisance: What lies between machine and log; by the machine file's noise where not given.
        effects: What the machine has beside the nominal physics.

    Raises:
        IdentError: As `simulate`.
    """
    log = simulate(machine, parameters, motion, effects)
    rng = np.random.default_rng(seed)
    streams = make_streams(log, motion, nuisance or nuisance_of(machine), rng)
    return SimulatedBag(streams, log)
