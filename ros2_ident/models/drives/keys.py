# SPDX-License-Identifier: Apache-2.0
"""Common keys of machine files of controlled drives, and how they belong together."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
import math

from ros2_ident.machine.draft import Draft, Remark
from ros2_ident.machine.keys import Key, of_controller, of_drive, sought, Value
from ros2_ident.machine.units import angular


def turn_of_gear(drive: Mapping[str, Value]) -> float:
    """Return the travel per motor turn of a drive's constants."""
    return 2.0 * math.pi / float(drive['gear_factor'])


def drive_keys(rail_mass: float) -> tuple[Key, ...]:
    """Return the keys of a drive.

    Args:
        rail_mass: Example of the carriage's mass, kg.
    """
    return (
        of_drive('gear_factor', 'rad/m', 'motor angle per travel of the carriage', 78.54,
                 absent='left out where the effort is a force', low=0.1, high=1e5),
        of_drive('travel_per_turn', 'm',
                 'travel per motor turn, for effects that follow it; beside a force only', 0.08,
                 absent='2 pi / gear_factor by default', default=turn_of_gear, low=1e-5, high=10.0,
                 shown=False),
        of_drive('rail_mass', 'kg', 'of the carriage with what is fixed to it', rail_mass,
                 absent='0 by default', low=0.0, high=1e4),
        of_drive('coulomb_regularisation', 'm/s',
                 'width v of the step in Coulomb friction, tanh(speed / v)', 5.0e-3,
                 absent='0.005 by default', low=1e-5, high=0.1),
    )


def controller_keys(cycle: float) -> tuple[Key, ...]:
    """Return the keys of the drives' controllers.

    Args:
        cycle: Example of their period, s.
    """
    return (
        of_controller('law', '',
                      'cascade_pi: P on position, PI on velocity; cascade_p: P and P, no PI',
                      'cascade_pi', absent='cascade_pi by default',
                      choices=('cascade_pi', 'cascade_p'), aliases=(('pi', 'cascade_pi'),)),
        Key('controller', 'cycle', 's', 'period of the velocity controller', cycle,
            low=1e-6, high=0.05),
        of_controller('position_gain', '1/s', 'velocity per position error', 60.0,
                      absent='needed where a set-point is recorded', low=1e-2, high=1e5),
        of_controller('velocity_gain', 'N m s/m', 'effort per velocity error of the carriage', 4.5,
                      absent='needed where a set-point is recorded', low=1e-6, high=1e7,
                      force_unit='N s/m'),
        of_controller('integral_gain', 'N m/m', 'effort per integrated velocity error', 250.0,
                      absent='0 by default', low=0.0, high=1e9, force_unit='N/m'),
        of_controller('velocity_feedforward', '1', "share of the set-point's velocity", 1.0,
                      absent='0 by default', low=0.0, high=1.5),
        of_controller('torque_limit', 'N m', 'the effort is clipped to plus and minus this', 6.0,
                      absent='no limit by default', low=1e-4, high=1e6, force_unit='N'),
    )


DELAY = Key('parameters', 'measurement_delay', 's', 'how late the effort is in the log',
            (0.0, 0.05), low=0.0, high=1.0)
GEAR = (
    sought('gear_stiffness', 'N/m', 'of gear or belt, at the carriage', (1e4, 3e5),
           low=0.0, high=1e12),
    sought('gear_damping_ratio', '1', 'of motor and carriage swinging against each other',
           (0.0, 2.0), low=0.0, high=100.0),
)
INERTIA = sought('drive_inertia', 'kg m^2', 'of motor and gear, at the motor shaft', (2e-5, 3e-4),
                 low=0.0, high=1e4, force_unit='kg')
FRICTION = (
    sought('coulomb_torque', 'N m', 'Coulomb friction', (0.0, 0.5), low=0.0, high=1e5,
           force_unit='N'),
    sought('viscous_torque', 'N m s/m', 'viscous friction', (0.0, 0.5), low=0.0, high=1e7,
           force_unit='N s/m'),
    sought('coulomb_friction', 'N', 'the same where the effort is a force', (0.0, 60.0),
           low=0.0, high=1e5, force_unit='N', shown=False),
    sought('viscous_friction', 'N s/m', 'the same where the effort is a force', (0.0, 500.0),
           low=0.0, high=1e7, force_unit='N s/m', shown=False),
    sought('constant_force', 'N m',
           'effort that holds a constant pull against the positive direction', (-1.0, 1.0),
           low=-1e6, high=1e6, force_unit='N', shown=False),
)  # fmt: skip


def turning(key: Key, example: tuple[float, float]) -> Key:
    """Return a parameter of straight motion as that of a joint; what slides has its force unit."""
    return replace(key, unit=angular(key.force_unit), example=example)


# Constants that no candidate has a number of.
_FIXED = ('cycle', 'travel_per_turn')


def free_constants(*keys: Key) -> tuple[Key, ...]:
    """Return the constants that can also be identified, as parameters."""
    return tuple(key.searched() for key in keys if key.unit and key.name not in _FIXED)


# ---------------------------------------------------------------------- together


def judge_drives(draft: Draft, elastic: str = '') -> Iterator[Remark]:
    """Judge units, gear, travel and elasticity of controlled drives.

    Args:
        draft: A machine file's content.
        elastic: Why the gears have to be elastic; empty where they may be rigid.
    """
    yield from _units(draft)
    yield from _travel(draft)
    yield from _law(draft)
    if not elastic and not draft.states('parameters', 'gear_stiffness'):
        return
    for name, why in (
        ('gear_stiffness', elastic),
        ('drive_inertia', 'the motor of an elastic drive needs a mass'),
    ):
        if not draft.states('parameters', name):
            yield Remark(
                'error',
                ('parameters',),
                f'parameters lacks {name}: {why}; add the line '
                f'`{draft.line("parameters", name)}`, and hold a known value '
                f'with --fix {name}=VALUE',
            )


def judge_azimuth(draft: Draft, name: str) -> Iterator[Remark]:
    """Judge where a platform's three drives stand, which has no number for all of them."""
    azimuth = draft.present.get(('geometry', name))
    if azimuth is not None and not isinstance(azimuth, list):
        yield Remark('error', ('geometry', name), f'geometry.{name} needs three angles in rad')
    box = draft.present.get(('parameters', name))
    if isinstance(box, list) and box and not isinstance(box[0], list):
        yield Remark(
            'error',
            ('parameters', name),
            f'parameters.{name} needs a list of three boxes, one for each '
            f'{name.partition("_")[0]}, as `{draft.line("parameters", name)}`',
        )


def _units(draft: Draft) -> Iterator[Remark]:
    gears = draft.numbers('drive', 'gear_factor')
    geared = bool(gears) or draft.states('parameters', 'gear_factor')
    unit = draft.effort_unit
    if unit == 'N' and any(gear != 1.0 for gear in gears):
        gear = next(gear for gear in gears if gear != 1.0)
        yield Remark(
            'warn',
            ('drive', 'gear_factor'),
            f'gear_factor is {gear:g} but effort_unit is N: a force needs none; leave it out, or '
            'state the unit of a torque',
        )
    if draft.turns and (unit == 'N' or geared):
        other = 'effort_unit N' if unit == 'N' else 'gear_factor'
        yield Remark(
            'error',
            ('parameters', 'moving_mass'),
            f'moving_mass in kg m^2 says that the joint turns, {other} that it travels; state the '
            'mass in kg, or correct the other',
        )
    if unit == 'N m' and not geared and not draft.turns:
        yield Remark(
            'warn',
            ('effort_unit',) if ('effort_unit',) in draft.present else ('drive',),
            'the effort is a torque but drive.gear_factor is missing; add it in rad/m, or write '
            '`effort_unit: N`, or `moving_mass` in kg m^2 where a joint turns',
        )


def _law(draft: Draft) -> Iterator[Remark]:
    law = draft.present.get(('controller', 'law'))
    laws = law if isinstance(law, list) else [law]
    if 'cascade_p' not in laws:
        return
    gains = draft.numbers('controller', 'integral_gain')
    each = [gains[d % len(gains)] for d, one in enumerate(laws) if gains and one == 'cascade_p']
    if len(laws) == 1 < len(gains):
        each = list(gains)
    if any(each):
        yield Remark(
            'warn',
            ('controller', 'integral_gain'),
            'integral_gain has no meaning under `law: cascade_p`, which has no integral part; '
            'write 0, or `law: cascade_pi`',
        )


def _travel(draft: Draft) -> Iterator[Remark]:
    pairs = draft.each(('drive', 'gear_factor'), ('drive', 'travel_per_turn'))
    for gear, turn in pairs if draft.effort_unit != 'N' else ():
        if gear and turn and not 0.98 < turn * gear / (2.0 * math.pi) < 1.02:
            yield Remark(
                'warn',
                ('drive', 'travel_per_turn'),
                f'travel_per_turn {turn:g} m and gear_factor {gear:g} rad/m contradict each '
                f'other; one turn is {2.0 * math.pi / gear:.4g} m by the gear_factor',
            )
            return
