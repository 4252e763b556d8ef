# SPDX-License-Identifier: Apache-2.0
"""From named parameters to the rows that the kernels read."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
import functools
import math

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.effects import Effect, EffectParameter, get_effect, Hook
from ros2_ident.errors import ErrorCode
from ros2_ident.kernel import rows
from ros2_ident.machine.machine import Kind, Machine, Parameter
from ros2_ident.machine.units import angular, straight
from ros2_ident.models.protocol import EffectAt, Scales

# What a share of an unstated limit refers to, in sizes of the logged effort.
UNLIMITED = 2.0
_GRAVITY = 9.81  # m/s^2
# Width of a step without one.
_NARROW = 1e-12
# A parameter without its drive, and the drive's number; None where all drives share it.
Target = tuple[str, int | None]


@dataclass(frozen=True)
class Slot:
    """Where a nominal parameter goes: the rows it fills, and what it is.

    Attributes:
        row: The row it fills.
        shared: Whether all drives have the same.
        kind: As of a `Parameter`.
        source: Where it comes from.
        force: Whether it is a force at the carriage where the row is a torque at the motor.
    """

    row: str
    shared: bool
    kind: Kind
    source: str
    force: bool = False


_PAPER = 'Ludwig and Gerstmayr 2011, Table 3'
_FILE = 'a constant of the machine file'
# Rows that constants of the machine file fill, where they have another name.
_ROWS = {
    'gear_factor': 'gear',
    'coulomb_regularisation': 'regularisation',
    'velocity_feedforward': 'feedforward',
    'shaft_radius': 'rail_radius',
    'shaft_azimuth': 'rail_azimuth',
    'arm_inertia': 'rail_mass',
    'armature': 'drive_inertia',
    'duty_limit': 'torque_limit',
}
_CONSTANTS = (
    'gear_factor', 'rail_mass', 'coulomb_regularisation', 'position_gain', 'velocity_gain',
    'integral_gain', 'velocity_feedforward', 'torque_limit', 'rail_azimuth', 'gravity',
    'rail_radius', 'rod_length', 'arm_length', 'torque_constant', 'resistance', 'supply_voltage',
    'load_mass', 'load_length', 'arm_mass', 'load_inertia', 'load_angle', 'shaft_radius',
    'shaft_azimuth', 'arm_inertia', 'arm_moment', 'arm_zero', 'armature', 'duty_limit',
    'set_point_delay',
)  # fmt: skip
SLOTS: Mapping[str, Slot] = dict(
    measurement_delay=Slot('log_delay', True, 'measurement', _PAPER),
    gear_stiffness=Slot('gear_stiffness', False, 'physical', _PAPER),
    gear_damping_ratio=Slot('gear_damping', False, 'physical', f'{_PAPER}, eq. 23'),
    tool_mass=Slot('tool_mass', True, 'physical', _PAPER),
    drive_inertia=Slot('drive_inertia', False, 'physical', _PAPER),
    moving_mass=Slot('rail_mass', False, 'physical', 'Newton; motor and carriage as one mass'),
    coulomb_torque=Slot('coulomb', False, 'physical', 'Coulomb 1785'),
    viscous_torque=Slot('viscous', False, 'physical', 'linear viscous friction'),
    coulomb_friction=Slot('coulomb', False, 'physical', 'Coulomb 1785', force=True),
    viscous_friction=Slot('viscous', False, 'physical', 'linear viscous friction', force=True),
    constant_force=Slot('constant_load', False, 'physical', 'Janot, Gautier, Brunot 2019, offset'),
    **{
        name: Slot(row, row in rows.MACHINE_ROWS, 'physical', _FILE)
        for name in _CONSTANTS
        for row in [_ROWS.get(name, name)]
    },
)
# Of these zero is an answer: a machine can be without them, and an angle may be any.
_ZERO = ('measurement_delay', 'gear_damping_ratio', 'integral_gain', 'velocity_feedforward',
         'rail_azimuth', 'arm_zero', 'load_angle', 'damping', 'frictionloss', 'stiffness', 'kv',
         'set_point_delay', 'joint_zero')  # fmt: skip
_ZERO_ROWS = 'coulomb', 'viscous', 'constant_load'
MAY_BE_ZERO = {*_ZERO, *(name for name, slot in SLOTS.items() if slot.row in _ZERO_ROWS)}
# And these are friction of a drive or joint.
COULOMB = {'frictionloss', *(name for name, slot in SLOTS.items() if slot.row == 'coulomb')}
FRICTION = COULOMB | {'damping', *(n for n, slot in SLOTS.items() if slot.row == 'viscous')}
# Fills rows of all candidates and drives from other rows of theirs.
Derive = Callable[[Array], None]


@dataclass(eq=False)
class Candidates:
    """The parameters of a machine with effects, and the rows of candidates.

    Attributes:
        machine, effects, fixed, scales, travels: As of a `MachineModel`.
        drives: Drives whose parameters are free; the others follow their mean.
        base: (R,) rows of what the machine file knows, the rest neutral.
        rigid: Whether nominally motor and carriage move as one mass.
        own: Parameters that fill no row here but something of the model's own, by their name in
            the machine file.
        free: The parameters, in the order of theta's columns.
        on: (D,) flags of the effects that have a kernel.
        flexible: (D,) where an effect hangs a share of a rigid drive's mass on a spring.
        delayed: Whether set-points may be late.
        frame: Whether an effect lets the frame move.
        smoothed: (D,) where an effect smooths the logged effort.

    Raises:
        IdentError: INVALID_GOAL or UNKNOWN_PARAMETER with the remedy.
    """

    machine: Machine
    drives: tuple[str, ...]
    effects: tuple[EffectAt, ...]
    fixed: Mapping[str, float]
    base: Array
    rigid: bool
    scales: Scales
    travels: tuple[str, ...]
    own: Mapping[str, Sequence[Parameter]]

    def __post_init__(self) -> None:
        self._all = self._declared()
        self._known_names()
        free = [entry for entry in self._all if entry[0].name not in self.fixed]
        self.free: tuple[Parameter, ...] = tuple(p for p, _ in free)
        self._targets = [target for _, target in free]
        self.on = np.zeros(len(self.machine.drives), dtype=np.int64)
        for at in self.effects:
            if get_effect(at.effect).hook is not Hook.PARAMETER:
                self.on[self._places(at)] |= rows.bit(at.effect)
        late = 'set_point_delay'
        self.delayed = bool(self.acting(late)) or self.machine.known(late)
        self.frame = bool(self.acting('frame_frequency'))
        self.smoothed = self._where(self.acting('log_smoothing'))
        sprung = self.acting('load_share')
        self.flexible = self._where(sprung)
        if sprung and not self.rigid:
            raise ErrorCode.INVALID_GOAL.error(
                f'{sprung[0].effect} has no place in a machine whose gear is elastic already; its '
                'parameter is gear_stiffness'
            )

    def acting(self, row: str) -> list[EffectAt]:
        """Return the effects that act on a row."""
        each = [(at, get_effect(at.effect).parameters) for at in self.effects]
        return [at for at, parameters in each if any(p.target == row for p in parameters)]

    def _where(self, effects: Sequence[EffectAt]) -> npt.NDArray[np.bool_]:
        """Return (D,) the drives of some effects."""
        out = np.zeros(len(self.machine.drives), dtype=bool)
        for at in effects:
            out[self._places(at)] = True
        return out

    # ------------------------------------------------------------------ declaration

    def _places(self, at: EffectAt) -> list[int]:
        if at.where == 'all':
            return list(range(len(self.machine.drives)))
        if at.where not in self.machine.drives:
            raise ErrorCode.INVALID_GOAL.error(
                f'{at.effect} cannot sit on {at.where!r}; '
                f'choose from {", ".join(self.machine.drives)} or all'
            )
        return [self.machine.drives.index(at.where)]

    def _declared(self) -> list[tuple[Parameter, Target]]:
        """Return all parameters, held ones included, each with where it goes."""
        declared: list[tuple[Parameter, Target]] = []
        for name in self.machine.bounds:
            if name in self.own:
                declared += [(p, (p.name, None)) for p in self.own[name]]
                continue
            slot = SLOTS.get(name)
            if slot is None:
                raise ErrorCode.UNKNOWN_PARAMETER.error(
                    f'machine file: the {self.machine.kind} model has no parameter {name!r}; '
                    f'it knows {", ".join(SLOTS)}'
                )
            for drive in [None] if slot.shared else self.drives:
                full = name if drive is None else f'{drive}.{name}'
                index = None if drive is None else self.machine.drives.index(drive)
                low, high, unit = self.machine.box(name, drive)
                # In a machine of joints that turn one may slide, moved by forces.
                slides = index is not None and self.travels[index] != self.machine.travel_unit
                if slides and self.machine.number('gear_factor', drive) == 1.0:
                    unit = straight(unit)
                # An inertia that may be below zero makes up for links, too.
                kind: Kind = 'base' if name == 'drive_inertia' and low < 0.0 else slot.kind
                absent = 0.0 if name in MAY_BE_ZERO else None
                declared.append(
                    (Parameter(full, unit, low, high, kind, slot.source, absent), (name, index))
                )
        for at in self.effects:
            declared += self._of_effect(get_effect(at.effect), at)
        return declared

    def _of_effect(self, effect: Effect, at: EffectAt) -> list[tuple[Parameter, Target]]:
        place = self._places(at)[0]
        kind: Kind = 'measurement' if effect.group == 'measurement' else 'physical'
        turns = self.travels[place] == 'rad'
        # A machine of joints that turn may have one that slides.
        linear = 'N' if self.machine.travel_unit == 'rad' else self.machine.model_unit
        out: list[tuple[Parameter, Target]] = []
        for p in self.scaled(at):
            name, target = f'{at.prefix}{p.name}', f'{effect.id}.{p.name}'
            unit = p.unit.replace('effort', 'N m' if turns else linear)
            unit = unit.replace('force', 'N m' if turns else 'N')
            absent = p.neutral if p.role == 'size' else None
            declared = Parameter(name, unit, p.low, p.high, kind, effect.source, absent)
            out.append((declared, (target, None if at.where == 'all' else place)))
        return out

    def _known_names(self) -> None:
        """Refuse to hold what is no parameter."""
        names = {p.name for p, _ in self._all} | {
            f'{d}.{n}' for d in self.machine.drives for n in self.machine.bounds
        }
        for name in self.fixed:
            if name not in names:
                raise ErrorCode.UNKNOWN_PARAMETER.error(
                    f'{name!r} cannot be fixed: no such parameter; '
                    f'the model has {", ".join(sorted(names))}'
                )

    def scaled(self, at: EffectAt) -> tuple[EffectParameter, ...]:
        """Return an effect's parameters with the numbers they have at a place, in their units."""
        places = self._places(at)
        most = Scales(*(each[places] for each in self.scales))
        effort, speed, stroke = (float(each.max()) for each in most[:3])
        force = float((self.scales.effort * self.machine.numbers('gear_factor'))[places].max())
        factors = {
            'effort': effort, 'force': force, '1/(effort)': 1.0 / effort,
            'm': stroke, '1/m': 1.0 / stroke, 'force/m': force / stroke,
            'm/s': speed, 'effort s/m': effort / speed, 'effort s^2/m^2': effort / speed**2,
            '1/W': 1.0 / (force * speed), 'load': force / _GRAVITY, 'load m': force / _GRAVITY,
        }  # fmt: skip
        turns = self.travels[places[0]] == 'rad'
        # Slower than nominal friction turns over no law is seen. By hand: nor does a default for
        # that leave out more than a tenth of the speeds.
        still = self.of(self.base[None], 'regularisation')[0, places]
        slow = min(float(still.max()), 0.1 * speed)
        # Where no gear is stated orders are of the joint's turn: those of two samples a period.
        turn = float(self.of(self.base[None], 'motor_turn')[0, places].min())
        dense = 0.0 if turn != 1.0 else math.pi / (self.machine.number('cycle') * speed)
        # Of less than a period over the stroke (Rayleigh's limit) it is a spring or a constant.
        fewest = 2.0 * math.pi / (turn * stroke) if turn else 0.0
        out = []
        for p in get_effect(at.effect).parameters:
            # What belongs to the machine is no angle, however its drives turn.
            own = p.target in rows.MACHINE_ROWS
            factor = factors.get(p.unit, 1.0) if not own or 'load' in p.unit else 1.0
            first = float(most.lowest.min()) if p.role == 'position' else 0.0
            order = p.role == 'order'
            top = max(first + p.high * factor, dense if order else -math.inf)
            least = slow if p.unit == 'm/s' else fewest if order and fewest < top else -math.inf
            low, neutral, *starts = (
                max(first + x * factor, least) for x in (p.low, p.neutral, *p.starts)
            )
            unit = angular(p.unit) if turns and not own else p.unit.replace('load', 'kg')
            once = tuple(dict.fromkeys(starts))
            out.append(replace(p, unit=unit, low=low, high=top, neutral=neutral, starts=once))
        return tuple(out)

    def full_effort(self, drive: int) -> float:
        """Return the effort that a share of a drive's limit refers to.

        That is the limit, or, where none is stated, more than the drive was ever seen to make.
        """
        limit = float(self.machine.numbers('torque_limit')[drive])
        return limit if math.isfinite(limit) else UNLIMITED * float(self.scales.effort[drive])

    # ------------------------------------------------------------------ rows

    def of(self, block: Array, name: str) -> Array:
        """Return a view of a number of (S, R) rows: (S,) the machine's, (S, D) the drives'."""
        return rows.of(block, name, len(self.machine.drives))

    def rows(self, theta: Array, derive: Derive = lambda block: None) -> Array:
        """Return (S, R) kernel rows of (S, N) candidates in physical units.

        Args:
            theta: Candidates (S, N).
            derive: Fills what follows from other rows, before the gears' damping. Not
                kept: a method of the model would hold the model, and its data, in a circle.
        """
        theta = np.atleast_2d(np.asarray(theta, dtype=float))
        if theta.shape[1] != len(self.free):
            raise ValueError(
                f'theta has {theta.shape[1]} columns, the model {len(self.free)} parameters'
            )
        block = np.repeat(self.base[None], len(theta), axis=0)
        values = self._values(theta)
        of = functools.partial(self.of, block)
        for (name, d), value in values.items():
            if name in SLOTS:
                self._at(of(SLOTS[name].row), d)[...] = value
        gear = of('gear')
        of('constant_load')[:] *= gear  # stated as what it asks of the motor
        for name, d in values:
            if name in SLOTS and SLOTS[name].force and d is not None:
                of(SLOTS[name].row)[:, d] /= gear[:, d]
        if 'gear_factor' in self.machine.bounds and not self.machine.stated('travel_per_turn'):
            of('motor_turn')[:] = gear
        derive(block)
        # The motors' inertia at the rail; a damping ratio becomes a constant, eq. 23 of the paper.
        motor, rail = of('drive_inertia') * gear**2, of('rail_mass')
        of('motor_mass')[:] = motor
        reduced = of('gear_stiffness') * motor * rail / np.maximum(motor + rail, 1e-12)
        of('gear_damping')[:] *= 2.0 * np.sqrt(np.maximum(reduced, 0.0))
        for at in self.effects:
            effect, places = get_effect(at.effect), self._places(at)
            place = None if at.where == 'all' else places[0]
            for number, p in enumerate(effect.parameters):
                value = values[f'{effect.id}.{p.name}', place]
                if p.target:
                    self._shift(block, p.target, p.how, places, value)
                else:
                    row = rows.of_effect(block, effect.id, number, len(self.machine.drives))
                    self._at(row, place)[...] = value
        self._split(of)
        # Divided here, not in every cycle; along a recorded motion a regularisation may be 0.
        for derived, name in (('gear_inverse', 'gear'), ('friction_slope', 'regularisation')):
            of(derived)[:] = 1.0 / np.where(of(name) == 0.0, _NARROW, of(name))
        return block

    @staticmethod
    def _at(row: Array, d: int | None) -> Array:
        """Return what of a row, (S,) or (S, D), a parameter fills, candidates last."""
        return row.T if d is None else row[:, d]

    def own_values(self, theta: Array) -> dict[str, Array]:
        """Return the (S,) values of the model's own parameters, by their full names."""
        values = self._values(np.atleast_2d(theta))
        return {p.name: values[p.name, None] for several in self.own.values() for p in several}

    def dry_friction(self, block: Array, torque: Array) -> Array:
        """Return (S, D) the largest friction of drives whose gears torques (S, D) [N m] press.

        What does not depend on the speed alone; viscous friction is not stiff.
        """
        per_unit = {'effort': np.ones_like(torque), '1': torque, '1/(effort)': torque**2}
        return self._with_sizes(self.of(block, 'coulomb').copy(), block, Hook.FRICTION, per_unit)

    def contact(self, block: Array) -> Array:
        """Return (S, D) the largest stiffness [N/m] of springs between frame and carriages."""
        none = np.zeros((len(block), len(self.machine.drives)))
        return self._with_sizes(none, block, Hook.CARRIAGE_FORCE, {'force/m': none + 1.0})

    def _with_sizes(
        self, total: Array, block: Array, hook: Hook, per_unit: Mapping[str, Array]
    ) -> Array:
        """Add the sizes of a hook's effects, each times the (S, D) of its unit."""
        for at in self.effects:
            effect, places = get_effect(at.effect), self._places(at)
            for number, p in enumerate(effect.parameters):
                if effect.hook is hook and p.role == 'size' and p.unit in per_unit:
                    size = rows.of_effect(block, effect.id, number, total.shape[1])
                    total[:, places] += (np.abs(size) * per_unit[p.unit])[:, places]
        return total

    def _values(self, theta: Array) -> dict[Target, Array]:
        """Return every parameter's (S,) values: held, free, and of drives that only follow."""
        values: dict[Target, Array] = {}
        for d, drive in enumerate(self.machine.drives):
            for name in self.machine.bounds:
                if f'{drive}.{name}' in self.fixed:
                    values[name, d] = np.full(len(theta), self.fixed[f'{drive}.{name}'])
        for parameter, target in self._all:
            if parameter.name in self.fixed:
                values[target] = np.full(len(theta), self.fixed[parameter.name])
        for column, target in enumerate(self._targets):
            values[target] = theta[:, column]
        # Drives that only follow have the mean of the identified ones unless they are known: their
        # gears still move the carriages, and with stiff ones the torque of the others is far off.
        chosen = [self.machine.drives.index(name) for name in self.drives]
        for d, drive in enumerate(self.machine.drives):
            for name in set(self.machine.bounds) - set(self.own) if d not in chosen else ():
                own = self.machine.stated(name) or f'{drive}.{name}' in self.machine.own_bounds
                if not (own or SLOTS[name].shared or f'{drive}.{name}' in self.fixed):
                    values[name, d] = np.mean([values[name, c] for c in chosen], axis=0)
        return values

    def _split(self, of: Callable[[str], Array]) -> None:
        """Hang a share of rigid drives' masses on springs behind the motors."""
        there = self.flexible
        share = np.clip(of('load_share')[:, there], 1e-3, 0.999)
        mass = of('motor_mass')[:, there] + of('rail_mass')[:, there]
        of('motor_mass')[:, there], of('rail_mass')[:, there] = mass * (1.0 - share), mass * share
        reduced = mass * share * (1.0 - share)
        omega = 2.0 * math.pi * of('load_frequency')[:, there]
        of('gear_stiffness')[:, there] = reduced * omega**2
        damping = 2.0 * of('load_damping')[:, there] * omega
        of('gear_damping')[:, there] = reduced * damping

    def _shift(
        self, block: Array, target: str, how: str, drives: Sequence[int], value: Array
    ) -> None:
        row = self.of(block, target)
        for d in drives if row.ndim > 1 else [None]:
            here = self._at(row, d)
            if d is not None and how == 'scale' and target == 'torque_limit':
                # An unstated limit is none, but a share of it is one.
                here[np.isinf(here) & (value < 1.0)] = UNLIMITED * self.scales.effort[d]
            here[:] = {'scale': here * value, 'set': value, 'add': here + value}[how]
