# SPDX-License-Identifier: Apache-2.0
"""A recording beside what MuJoCo makes of an MJCF, by the set-points alone."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
import copy
from dataclasses import dataclass, field, replace
import functools
import math
from typing import Any

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.effects import CATALOGUE, Context, Effect, get_effect, Hook
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.kernel import rows
from ros2_ident.machine.description import OWN_WORDS
from ros2_ident.machine.kind import Space
from ros2_ident.machine.machine import Machine, Parameter
from ros2_ident.machine.units import per_metre
from ros2_ident.models.drives.candidates import Candidates, MAY_BE_ZERO
from ros2_ident.models.drives.outputs import logged_of, MachineModel
from ros2_ident.models.drives.separate import first_seen
from ros2_ident.models.kinds import MUJOCO as KIND
from ros2_ident.models.mujoco.forces import Forces, HOOKS
from ros2_ident.models.mujoco.plant import Felt, OWN, Plant
from ros2_ident.models.protocol import EffectAt, Scales, scales_of
from ros2_ident.models.serial.law import by_regression, GAINS, JOINT, Signals
from ros2_ident.recording.motion import allowed_cutoff, CUTOFF, fill_gaps, low_pass, smooth_motion

# Rows of the kernels' whose change MuJoCo can express, and what they are at their neutral value.
_FACTORS = ('position_gain', 'velocity_gain', 'log_gain')
_EXPRESSED = frozenset(
    (*_FACTORS, 'coulomb', 'viscous', 'set_point_delay', 'torque_limit', 'log_bias', 'log_delay')
)
_SHARED = frozenset(('measurement_delay', 'free_fall'))
# What `law.by_regression` calls them.
_WORDS = {**OWN_WORDS, 'set_point_delay': 'set_point_delay'}
# What effects add to, and the rows in which they do.
_ADDED = ('frictionloss', 'coulomb'), ('damping', 'viscous')
# Parameters that are no attribute of the simulator.
_OUTSIDE = frozenset(('measurement_delay', 'joint_zero', 'set_point_delay'))
# How far a joint moves to either side by default, rad or m; speed and
# acceleration of a way through all of them together.
_TURN, _SLIDE, _SPEED, _ACCELERATION = 0.5, 0.1, 1.0, 4.0


class Mujoco(MachineModel):
    """Joints of a description under actuators, which follow the set-points of a log.

    Drives that are not compared move along as described. The cutoff is not read: recorded motion
    does not drive it.

    Raises:
        IdentError: INVALID_GOAL, UNKNOWN_MODEL, UNKNOWN_PARAMETER, MISSING_STREAM or
        BAD_MACHINE_FILE with the remedy.
    """

    compares = KIND.compares

    def __post_init__(self) -> None:
        data, machine = self.data, self.machine
        if data.command_position is None:
            raise ErrorCode.MISSING_STREAM.error(
                'the recording holds no set-point, which the actuators of the simulator follow; '
                'record it too'
            )
        super().__post_init__()
        self.scales = self._sizes(self.scales or scales_of(machine, [data]))
        self._parts = self._declared()
        self.candidates = Candidates(
            machine, self.drives, self.effects, self.fixed, self._base, True, self.scales,
            self.travels, self._parts,
        )  # fmt: skip
        order = [data.names.index(name) for name in machine.drives]
        self._command = data.command_position[order]
        still = np.stack([self._command[:, 0], np.zeros(len(order))])
        self._begin = first_seen(data, order, still)
        self._sense = np.array([at.sense for at in self.plant.places])

    @functools.cached_property
    def plant(self) -> Plant:
        """The compiled description."""
        return _plant(self.machine)

    def __getstate__(self) -> dict[str, Any]:
        # Another process compiles the description itself.
        return {name: value for name, value in vars(self).items() if name != 'plant'}

    def _sizes(self, scales: Scales) -> Scales:
        """Return scales with the actuators' limits for efforts that are not logged."""
        if self.data.effort is not None:
            return scales
        limits = np.array([self.effort_limit(name) for name in self.machine.drives])
        return scales._replace(effort=np.where(np.isfinite(limits), limits, 1.0))

    @property
    def _base(self) -> Array:
        """(R,) neutral rows, gains as factors of the description's."""
        base = rows.neutral_rows(len(self.machine.drives))
        for name in (*_FACTORS, 'gear', 'motor_turn', 'regularisation'):
            rows.of(base, name, len(self.machine.drives))[:] = 1.0
        rows.of(base, 'torque_limit', len(self.machine.drives))[:] = math.inf
        return np.asarray(base[0])

    def _declared(self) -> dict[str, list[Parameter]]:
        """Return the parameters of each name in the machine file: one, or one of each drive."""
        meaning = {key.name: key.meaning for key in KIND.keys if key.section == 'parameters'}
        found: dict[str, list[Parameter]] = {name: [] for name in self.machine.bounds}
        for name, several in found.items():
            source, absent = f'MuJoCo: {meaning[name]}', 0.0 if name in MAY_BE_ZERO else None
            kind: Any = 'measurement' if name == 'measurement_delay' else 'physical'
            for drive in [None] if name in _SHARED else self.drives:
                low, high, unit = self.machine.box(name, drive)
                full = name if drive is None else f'{drive}.{name}'
                several.append(Parameter(full, unit, low, high, kind, source, absent))
        return found

    @property
    def described(self) -> tuple[str, ...]:
        """Names of parameters and of those of every joint alike, see `FullModel.described`."""
        names = [name for name in self._parts if name in KIND.described]
        return (*names, *(p.name for name in names for p in self._parts[name]))

    def as_described(self, given: Mapping[str, float]) -> dict[str, float]:
        """Return what the description holds, see `FullModel.as_described`."""
        out = {}
        for name in set(self._parts) & set(KIND.described):
            for p in self._parts[name]:
                stated = self.plant.stated(name, self._drive_of(p))
                out[p.name] = given.get(p.name, given.get(name, stated))
        return out

    def _drive_of(self, parameter: Parameter) -> int:
        """Return the drive of a parameter, the first where all share it."""
        drive = parameter.name.rpartition('.')[0]
        return self.machine.drives.index(drive) if drive else 0

    def suggested(self) -> Array | None:
        """Return (N,) parameters, see `FullModel.suggested`.

        By regression, or as described where that leaves less of the log: dry friction of MuJoCo
        gives way as a damper does, up to its size, and a regression takes it for one.
        """
        if self.data.position is None:
            return None
        middle = np.array([0.5 * (p.low + p.high) for p in self.parameters])
        try:
            found = self._regressed(self.candidates.own_values(middle))
        except IdentError:  # a joint has hardly a position
            return None
        both = np.stack([self._begun(found), self._begun({})])
        return np.asarray(both[np.argmin(np.square(self.residuals(both)).mean(axis=1))])

    def _regressed(self, own: Mapping[str, Array]) -> dict[str, Array]:
        """Return (D,) estimates of gains, delay and what a joint has, see `law.by_regression`.

        By (1,) parameters, the free ones anything; raises BAD_VALUES below four positions.
        """
        data, drives, free = self.data, self.machine.drives, {p.name for p in self.parameters}
        assert data.position is not None
        order = [data.names.index(name) for name in drives]
        cutoff = allowed_cutoff(data.position[order], self.cycle, CUTOFF)
        sense = self._sense[:, None]
        gear = np.array([[self.plant.stated('actuator_gear', d)] for d in range(len(drives))])
        zero = self._own('joint_zero', own, 1).T
        place = sense * (data.position[order] - zero)
        # A set-point holds for a cycle, in whose middle the law is at its mean.
        both = (smooth_motion(place, self.cycle, cutoff, ahead) for ahead in (0.0, 0.5))
        seen, middle = map(np.array, both)
        effort = None
        if data.effort is not None:
            rows = [fill_gaps(x) if np.isfinite(x).any() else x for x in data.effort[order]]
            effort = low_pass(sense * np.stack(rows) / gear, self.cycle, cutoff)
        links = self.plant.inverse(*middle) / gear
        wanted = low_pass(sense * (self._command - zero), self.cycle, cutoff)
        moved, one = (gear * seen, gear * middle), np.ones(len(drives))
        signals = Signals(self.cycle, *moved, wanted, links, 0.0 * wanted, effort, one)
        # The law's efforts and positions are the actuator's, a joint's own numbers at the joint.
        power = {'armature': 2, 'damping': 2, 'frictionloss': 1}
        scale = {name: np.abs(gear[:, 0]) ** power.get(name, 0) for name in _WORDS}
        known = {name: np.zeros(len(drives)) for name in (*GAINS, *JOINT)}
        for name, word in _WORDS.items():
            for d, drive in enumerate(drives):
                full, stated = f'{drive}.{name}', self.plant.stated(name, d)
                if name in _OUTSIDE:
                    stated = float(self._own(name, own, 1)[0, d])
                value = math.nan if full in free else float(own.get(full, [stated])[0])
                known[word][d] = value / scale[name][d]
        found, _ = by_regression(signals, known)
        return {name: scale[name] * found[word] for name, word in _WORDS.items()}

    # ------------------------------------------------------------------ what it is

    @functools.cached_property
    def travels(self) -> tuple[str, ...]:
        """(D,) `m` where a joint slides, else `rad`."""
        return tuple('m' if at.slides else 'rad' for at in self.plant.places)

    @property
    def effort_units(self) -> tuple[str, ...]:
        """(D,) unit of the joints' efforts."""
        return tuple('N' if x == 'm' else 'N m' for x in self.travels)

    @property
    def effort_unit(self) -> str:
        """Unit of efforts."""
        return 'N' if self.travel[0] == 'm' else 'N m'

    @property
    def travel(self) -> tuple[str, float]:
        """Unit of the positions, m where all drives compared slide, and so many for a metre."""
        slide = all(self.travels[d] == 'm' for d in self.signals.places)
        unit = 'm' if slide else 'rad'
        return unit, per_metre(unit)

    # ------------------------------------------------------------------ effects

    def extensions(self, *, changed: bool = False) -> tuple[EffectAt, ...]:
        """Return every effect that an MJCF can express, at every drive it can sit on."""
        context = self._context
        return tuple(
            EffectAt(effect.id, drive)
            for effect in CATALOGUE.values()
            if effect.place == 'drive' and _expressed(effect) and effect.applies(context)
            for drive in self.drives
        )

    @property
    def _context(self) -> Context:
        """Properties of simulator and log; an identified attribute is no effect."""
        rows_of = dict(_ADDED) | {'kp': 'position_gain', 'kv': 'velocity_gain'}
        rows_of |= {'force_limit': 'torque_limit', 'measurement_delay': 'log_delay'}
        return Context(
            drives=len(self.machine.drives),
            identified=frozenset(rows_of.get(name, name) for name in self.machine.bounds),
            lifted=True,
            features=frozenset({'motor_torque'}),
            effort='effort' in self.signals.quantities,
        )

    def extended(self, effects: Sequence[EffectAt]) -> 'Mujoco':
        """Return the model of the same recording with these effects and no others."""
        for at in effects:
            if not _expressed(get_effect(at.effect)):
                raise ErrorCode.INVALID_GOAL.error(
                    f'a {self.name} cannot be extended by {at.effect}, which is no force on a '
                    'joint and no attribute of an MJCF'
                )
        return replace(self, effects=tuple(effects))

    def free_run(self) -> 'Mujoco':
        """Return the model that compares all that the log holds."""
        return replace(self, quantities=logged_of(self.data, self.drives), weights=None)

    def effort_limit(self, place: str) -> float:
        """Return the effort that a share of a drive's limit refers to [N m]."""
        return self.plant.stated('force_limit', self.machine.drives.index(place))

    # ------------------------------------------------------------------ simulation

    def simulate(self, theta: Array) -> Array:
        """Return (S, O, K) outputs of candidates (S, N); inf where one diverged."""
        theta = np.atleast_2d(np.asarray(theta, dtype=float))
        out = np.empty((len(theta), len(self.signals), self._command.shape[1]))
        together = self.plant.together(self._command.shape[1])
        for first in range(0, len(theta), together):
            part = slice(first, first + together)
            out[part] = self._simulated(theta[part], self.signals.quantities)
        out[~np.isfinite(out).all(axis=(1, 2))] = math.inf
        return out

    def as_found(self, theta: Array) -> tuple[Any, Array]:
        """Return MuJoCo's model of a candidate (N,), and (D,) how late set-points act, s."""
        own, block = self.candidates.own_values(theta[None]), self.candidates.rows(theta[None])
        row = {name: self.candidates.of(block, name) for name in _EXPRESSED}
        model = copy.copy(self.plant.model)
        self.plant.changed(model, self._attributes(own, row, 0))
        late = self._own('set_point_delay', own, 1) + row['set_point_delay']
        return model, late[0]

    def simulated_effort(self, theta: Array) -> Array:
        """Return (P, K) what the actuators of the drives compared do, for one candidate (N,)."""
        return np.asarray(self._simulated(np.atleast_2d(theta), ('effort',))[0])

    def _simulated(self, theta: Array, quantities: Sequence[str]) -> Array:
        own = self.candidates.own_values(theta)
        block, sense = self.candidates.rows(theta), self._sense
        row = {name: self.candidates.of(block, name) for name in _EXPRESSED}
        zero = self._own('joint_zero', own, len(theta))
        late = self._own('set_point_delay', own, len(theta)) + row['set_point_delay']
        values = [self._attributes(own, row, s) for s in range(len(theta))]
        command = _late(self._command, late / self.cycle)
        start = np.repeat(self._begin[None], len(theta), axis=0)
        start[:, 0] = sense * (start[:, 0] - zero)
        start[:, 1] *= sense
        in_joints = sense[:, None] * (command - zero[:, :, None])
        told = self.plant.rollout(values, in_joints, start, self._forces(values, block, zero))
        parts = []
        for quantity in quantities:
            seen = sense[:, None] * told[quantity]
            if quantity == 'position':
                seen = seen + zero[:, :, None]
            if quantity == 'effort':
                seen = _late(seen, row['log_delay'] / self.cycle)
                seen = row['log_gain'][:, :, None] * seen + row['log_bias'][:, :, None]
            parts.append(seen[:, list(self.signals.places)])
        return np.concatenate(parts, axis=1)

    def _forces(
        self, values: Sequence[dict[str, dict[int, float]]], block: Array, zero: Array
    ) -> Felt | None:
        """Return the effects' forces on joints of candidates with attributes; None for none."""
        if not self.candidates.on.any():
            return None
        block, sense = block.copy(), self._sense
        for name, row in (*_ADDED, ('armature', 'motor_mass')):
            each = [[self._attribute(v, name, d) for d in range(len(sense))] for v in values]
            self.candidates.of(block, row)[:] = each
        felt = Forces(block, self.candidates.on, self.cycle / self.plant.substeps)

        def forces(time: float, position: Array, velocity: Array, effort: Array) -> Array:
            loss, force = felt.at(time, sense * position + zero, sense * velocity, sense * effort)
            return np.stack([loss, sense * force])

        return forces

    def _own(self, name: str, own: Mapping[str, Array], count: int) -> Array:
        """Return (S, D) a parameter of each drive; the constant where it is none, or 0."""
        named = name in self.machine.constants
        known = {d: self.machine.number(name, d) if named else 0.0 for d in self.machine.drives}
        each = [own.get(f'{d}.{name}', np.full(count, known[d])) for d in self.machine.drives]
        return np.stack(each, axis=1)

    def _attributes(
        self, own: Mapping[str, Array], row: Mapping[str, Array], s: int
    ) -> dict[str, dict[int, float]]:
        """Return the simulator's attributes in candidate `s`, effects put in."""
        found: dict[str, dict[int, float]] = defaultdict(dict)
        for name in (name for name in self._parts if name not in _OUTSIDE):
            for p in self._parts[name]:
                found[name][self._drive_of(p)] = float(own[p.name][s])
        for name, target in _ADDED:
            for d in np.flatnonzero(row[target][s]).tolist():
                value = self._attribute(found, name, d) + row[target][s, d]
                found[name][d] = max(float(value), 0.0)
        for name, target in (('kp', 'position_gain'), ('kv', 'velocity_gain')):
            for d in np.flatnonzero(row[target][s] != 1.0).tolist():
                found[name][d] = float(self._attribute(found, name, d) * row[target][s, d])
        for d in np.flatnonzero(np.isfinite(row['torque_limit'][s])).tolist():
            full, limit = self.candidates.full_effort(d), self._attribute(found, 'force_limit', d)
            whole = limit if math.isfinite(limit) else full
            found['force_limit'][d] = float(row['torque_limit'][s, d] / full * whole)
        return found

    def _attribute(self, found: Mapping[str, Mapping[int, float]], name: str, d: int) -> float:
        """Return an attribute as a candidate has it so far, else the description's."""
        return found[name][d] if d in found.get(name, {}) else self.plant.stated(name, d)


def _expressed(effect: Effect) -> bool:
    """Return whether the simulator can have an effect: by a force on a joint, or attributes."""
    targets = {p.target for p in effect.parameters if p.target}
    return effect.hook in {*HOOKS, Hook.PARAMETER} and targets <= _EXPRESSED


@dataclass(frozen=True)
class _Same:
    """A machine that is the key of its compiled model: by what the model is made from."""

    made: tuple[Any, ...]
    machine: Machine = field(compare=False)


@functools.lru_cache(maxsize=8)
def _compiled(key: _Same) -> Plant:
    return Plant(key.machine)


def _plant(machine: Machine) -> Plant:
    """Return the compiled model of a machine, made once in a process."""
    words = ('description', 'joint', 'actuator', 'direction', 'body')
    # As text: what is unknown is NaN, which is unlike itself.
    numbers = (str(machine.numbers(word)) for word in (*OWN, 'cycle'))
    own = machine.given & {*OWN}, 'kp' in machine.bounds
    made = (machine.drives, *own, *numbers, *map(machine.texts, words))
    return _compiled(_Same(made, machine))


def space(machine: Machine) -> Space:
    """Return where the joints move by default: about where they are drawn."""
    plant = _plant(machine)
    most = np.where([at.slides for at in plant.places], _SLIDE, _TURN)
    low, high = np.clip(plant.ends, plant.home - most, plant.home + most)
    sense = np.array([at.sense for at in plant.places])
    return Space(0.5 * sense * (low + high), 0.45 * (high - low), _SPEED, _ACCELERATION)


def ends(machine: Machine) -> tuple[Array, Array]:
    """Return low and high ends (D,) of the joints that turn, rad, infinite for others."""
    plant = _plant(machine)
    ways = np.sort(np.array([at.sense for at in plant.places]) * np.array(plant.ends), axis=0)
    ways[:, [at.slides for at in plant.places]] = [[-np.inf], [np.inf]]
    return ways[0], ways[1]


def _late(signal: Array, cycles: Array) -> Array:
    """Return signals (S, D, K) or (D, K) late by (S, D) cycles, linear between two instants."""
    count = signal.shape[-1]
    whole = np.broadcast_to(signal, (*cycles.shape, count))
    if not cycles.any():
        return np.ascontiguousarray(whole)
    at = np.clip(np.arange(count) - cycles[..., None], 0.0, count - 1.0)
    before = np.minimum(at.astype(np.int64), max(count - 2, 0))
    low = np.take_along_axis(whole, before, axis=2)
    high = np.take_along_axis(whole, np.minimum(before + 1, count - 1), axis=2)
    return np.asarray(low + (at - before) * (high - low))
