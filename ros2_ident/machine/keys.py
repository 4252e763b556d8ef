# SPDX-License-Identifier: Apache-2.0
"""Every key of a machine file: unit, meaning, default, and what is plausible.

One table. The loader and `ident check` judge by it, `ident new-machine` and the reference page are
written from it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Literal

KINDS: Mapping[str, str] = {
    'linear_axis': 'carriages that know nothing of each other; gear elastic or rigid',
    'tripod': 'three vertical drives, three rods, one platform',
    'belt_drive': 'two gears, a belt and a mass on it; for Python only',
}
LAWS = ('cascade_pi', 'cascade_p', 'pi')  # pi: as cascade_pi

A, T, B = KINDS
Section = Literal['', 'geometry', 'drive', 'controller', 'parameters']


def _both(value: object) -> Mapping[str, object]:
    """Return the same example for a linear axis and a tripod."""
    return {A: value, T: value}


@dataclass(frozen=True)
class Key:
    """One key of a machine file.

    Attributes:
        section: The mapping it stands in; empty for the file itself.
        name: The key.
        unit: Its unit, `1` for a plain number, empty where it is no number. The values of
            `parameters` are intervals in it.
        meaning: What it is.
        examples: Value in a new machine file by kind of machine; the keys say which kinds have it.
        absent: What its absence means; empty where it may not be absent.
        low: Smallest plausible value.
        high: Largest plausible value.
        force_unit: Its unit where the effort is a force.
        shown: Whether a new machine file sets it; else it stands there behind a `#`.
    """

    section: Section
    name: str
    unit: str
    meaning: str
    examples: Mapping[str, object]
    absent: str = ''
    low: float = -math.inf
    high: float = math.inf
    force_unit: str = ''
    shown: bool = True

    @property
    def path(self) -> tuple[str, ...]:
        """Where it stands: section and name, or the name alone."""
        return (self.section, self.name) if self.section else (self.name,)


_KNOWN: tuple[Key, ...] = (
    Key(
        '',
        'machine',
        '',
        'kind of machine: ' + ', '.join(KINDS),
        {kind: kind for kind in KINDS},
    ),
    Key(
        '',
        'drives',
        '',
        'joint names in the bag; a tripod has three, in the order of rail_azimuth',
        {A: ('axis',), T: ('drive_1', 'drive_2', 'drive_3'), B: ('driving_gear',)},
    ),
    Key(
        '',
        'effort_unit',
        '',
        'of the logged effort: N m, N, A or percent',
        _both('N m'),
        absent='N m by default',
    ),
    Key(
        '',
        'torque_constant',
        'N m/A',
        'torque per current',
        _both(0.5),
        absent='needed where effort_unit is A',
        low=-1e3,
        high=1e3,
        force_unit='N/A',
        shown=False,
    ),
    Key(
        '',
        'rated_torque',
        'N m',
        'torque at 100 %',
        _both(2.4),
        absent='needed where effort_unit is percent',
        low=-1e5,
        high=1e5,
        force_unit='N',
        shown=False,
    ),
    Key(
        '',
        'effort_noise',
        'N m',
        'standard deviation of the logged effort at rest',
        {A: 0.01, T: 0.01, B: 0.0},
        absent='0.01 by default',
        low=0.0,
        high=1e4,
        force_unit='N',
    ),
    Key(
        'geometry',
        'rail_azimuth',
        'rad',
        'where the three rails stand, about the vertical',
        {T: (0.0, 2.0943951, 4.1887902)},
        low=-2.0 * math.pi,
        high=2.0 * math.pi,
    ),
    Key(
        'geometry',
        'rail_radius',
        'm',
        'circle of the joints on the carriages less that on the platform',
        {T: 0.30},
        low=1e-3,
        high=10.0,
    ),
    Key(
        'geometry',
        'rod_length',
        'm',
        'from joint to joint, all rods alike',
        {T: 0.60},
        low=1e-3,
        high=20.0,
    ),
    Key(
        'geometry',
        'gravity',
        'm/s^2',
        'downwards, against positive positions',
        {T: 9.81},
        low=-9.9,
        high=9.9,
    ),
    Key(
        'geometry',
        'gravity',
        'm/s^2',
        'against positive positions: 0 lying flat, 9.81 upright',
        {A: 0.0},
        absent='0 by default',
        low=-9.9,
        high=9.9,
    ),
    Key('geometry', 'radius', 'm', 'r of both gears', {B: 1.0e-2}, low=1e-4, high=1.0),
    Key('geometry', 'rail_position', 'm', 'x_0 of the mass', {B: 0.2}, low=0.0, high=100.0),
    Key(
        'geometry',
        'length_1',
        'm',
        'belt, driving gear to mass at x_0 = 0',
        {B: 0.1875},
        low=0.0,
        high=100.0,
    ),
    Key(
        'geometry',
        'length_2',
        'm',
        'belt, mass to driven gear at x_0 = 0',
        {B: 0.7875},
        low=0.0,
        high=100.0,
    ),
    Key(
        'geometry',
        'length_3',
        'm',
        'belt from gear to gear',
        {B: 0.975},
        low=1e-3,
        high=100.0,
    ),
    Key(
        'drive',
        'gear_factor',
        'rad/m',
        'motor angle per travel of the carriage',
        _both(78.54),
        absent='left out where the effort is a force',
        low=0.1,
        high=1e5,
    ),
    Key(
        'drive',
        'travel_per_turn',
        'm',
        'travel per motor turn, for effects that follow it; beside a force only',
        _both(0.08),
        absent='2 pi / gear_factor by default',
        low=1e-5,
        high=10.0,
        shown=False,
    ),
    Key(
        'drive',
        'rail_mass',
        'kg',
        'of the carriage with what is fixed to it',
        {A: 3.5, T: 1.2},
        absent='0 by default',
        low=0.0,
        high=1e4,
    ),
    Key('drive', 'rail_mass', 'kg', 'm, of what hangs on the belt', {B: 0.948}, low=0, high=1e4),
    Key(
        'drive',
        'coulomb_regularisation',
        'm/s',
        'width v of the step in Coulomb friction, tanh(speed / v)',
        _both(5.0e-3),
        absent='0.005 by default',
        low=1e-5,
        high=0.1,
    ),
    Key('drive', 'axial_stiffness', 'N', 'EA of the belt', {B: 2.0e5}, low=1.0, high=1e9),
    Key('drive', 'driving_inertia', 'kg m^2', 'J_1', {B: 2.0e-5}, low=1e-9, high=10.0),
    Key('drive', 'driven_inertia', 'kg m^2', 'J_2', {B: 2.0e-5}, low=1e-9, high=10.0),
    Key(
        'controller',
        'law',
        '',
        'cascade_pi: P on position, PI on velocity; cascade_p: P and P, no PI',
        _both('cascade_pi'),
        absent='cascade_pi by default',
    ),
    Key(
        'controller',
        'cycle',
        's',
        'period of the velocity controller',
        {A: 1.0e-3, T: 5.0e-4},
        low=1e-6,
        high=0.05,
    ),
    Key(
        'controller',
        'position_gain',
        '1/s',
        'velocity per position error',
        _both(60.0),
        absent='needed where a set-point is recorded',
        low=1e-2,
        high=1e5,
    ),
    Key(
        'controller',
        'velocity_gain',
        'N m s/m',
        'effort per velocity error of the carriage',
        _both(4.5),
        absent='needed where a set-point is recorded',
        low=1e-6,
        high=1e7,
        force_unit='N s/m',
    ),
    Key(
        'controller',
        'integral_gain',
        'N m/m',
        'effort per integrated velocity error',
        _both(250.0),
        absent='0 by default',
        low=0.0,
        high=1e9,
        force_unit='N/m',
    ),
    Key(
        'controller',
        'velocity_feedforward',
        '1',
        "share of the set-point's velocity",
        _both(1.0),
        absent='0 by default',
        low=0.0,
        high=1.5,
    ),
    Key(
        'controller',
        'torque_limit',
        'N m',
        'the effort is clipped to plus and minus this',
        _both(6.0),
        absent='no limit by default',
        low=1e-4,
        high=1e6,
        force_unit='N',
    ),
    Key('controller', 'position_gain', 'N m/rad', 'P', {B: 45.0}, low=1e-6, high=1e6),
    Key(
        'parameters',
        'measurement_delay',
        's',
        'how late the effort is in the log',
        _both((0.0, 0.05)),
        low=0.0,
        high=1.0,
    ),
    Key(
        'parameters',
        'gear_stiffness',
        'N/m',
        'of gear or belt, at the carriage',
        _both((1e4, 3e5)),
        low=0.0,
        high=1e12,
    ),
    Key(
        'parameters',
        'gear_damping_ratio',
        '1',
        'of motor and carriage swinging against each other',
        _both((0.0, 2.0)),
        low=0.0,
        high=100.0,
    ),
    Key(
        'parameters',
        'tool_mass',
        'kg',
        'of platform and tool',
        {T: (0.5, 3.0)},
        low=0.0,
        high=1e3,
    ),
    Key(
        'parameters',
        'drive_inertia',
        'kg m^2',
        'of motor and gear, at the motor shaft',
        _both((2e-5, 3e-4)),
        low=0.0,
        high=1e3,
        force_unit='kg',
    ),
    Key(
        'parameters',
        'moving_mass',
        'kg',
        'rigid axis: motor and carriage as one, in place of gear_* and drive_inertia; stated in '
        'kg m^2 it says that the joint turns: then rad stands for m and N m for N everywhere',
        {A: (1.0, 20.0)},
        low=0.0,
        high=1e5,
        shown=False,
    ),
    Key(
        'parameters',
        'coulomb_torque',
        'N m',
        'Coulomb friction',
        _both((0.0, 0.5)),
        low=0.0,
        high=1e5,
        force_unit='N',
    ),
    Key(
        'parameters',
        'viscous_torque',
        'N m s/m',
        'viscous friction',
        _both((0.0, 0.5)),
        low=0.0,
        high=1e7,
        force_unit='N s/m',
    ),
    Key(
        'parameters',
        'coulomb_friction',
        'N',
        'the same where the effort is a force',
        _both((0.0, 60.0)),
        low=0.0,
        high=1e5,
        force_unit='N',
        shown=False,
    ),
    Key(
        'parameters',
        'viscous_friction',
        'N s/m',
        'the same where the effort is a force',
        _both((0.0, 500.0)),
        low=0.0,
        high=1e7,
        force_unit='N s/m',
        shown=False,
    ),
    Key(
        'parameters',
        'constant_force',
        'N m',
        'a constant in the logged effort',
        _both((-1.0, 1.0)),
        low=-1e6,
        high=1e6,
        force_unit='N',
        shown=False,
    ),
)


def _searched(key: Key) -> Key:
    """Return a constant of the belt drive as something to be identified: each of them can be."""
    value = key.examples[B]
    assert isinstance(value, float)
    return Key(
        'parameters',
        key.name,
        key.unit,
        key.meaning,
        {B: (0.75 * value, 1.25 * value)},
        low=key.low,
        high=key.high,
        shown=key.name in ('axial_stiffness', 'position_gain'),
    )


KEYS: tuple[Key, ...] = (*_KNOWN, *(_searched(k) for k in _KNOWN if k.section and B in k.examples))


def keys_of(kind: str) -> Mapping[tuple[str, ...], Key]:
    """Return the keys that a machine file of this kind can hold, by path, in a file's order."""
    return {key.path: key for key in KEYS if kind in key.examples}
