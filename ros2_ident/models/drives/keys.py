# SPDX-License-Identifier: Apache-2.0
"""What is wrong with keys of controlled drives together."""

from collections.abc import Iterator
import math

from ros2_ident.machine.draft import Draft, Remark


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
