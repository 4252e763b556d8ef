# SPDX-License-Identifier: Apache-2.0
"""The kinds of machines of this package, and their judgements of several keys together.

Models are imported when they are asked for.
"""

from collections.abc import Iterator
import math

import numpy as np

from ros2_ident.machine.description import joints_in
from ros2_ident.machine.keys import keys_of
from ros2_ident.machine.kind import Draft, Kind, later, Remark, Space
from ros2_ident.machine.machine import Machine


def _each(machine: Machine, centre: float, reach: float, *rates: float) -> Space:
    """Return a space that is the same for each drive."""
    count = len(machine.drives)
    return Space(np.full(count, centre), np.full(count, reach), *rates)


BELT_DRIVE = Kind(
    name='belt_drive',
    title='two gears, a belt and a mass on it',
    keys=keys_of('belt_drive'),
    model=later('ros2_ident.models.belt_drive.model:RecordedBelt'),
    drives=1,
    travel='rad',
    compares=('effort', 'position'),
    space=lambda machine: Space(np.zeros(1), np.full(1, np.pi / 180.0), 0.2, 20.0),
)


def _judge_linear_axis(draft: Draft) -> Iterator[Remark]:
    yield from _judge_drives(draft)
    moving = draft.states('parameters', 'moving_mass')
    massive = moving or draft.states('parameters', 'rail_mass')
    stated = draft.numbers('drive', 'rail_mass') or (0.0,)
    if not massive and min(stated) <= 0.0:
        yield Remark(
            ('drive', 'rail_mass'),
            'nothing has a mass: give drive.rail_mass in kg, or list moving_mass under parameters',
        )
    if moving and draft.states('parameters', 'rail_mass'):
        yield Remark(
            ('parameters', 'rail_mass'),
            'rail_mass and moving_mass are the same mass of a linear_axis; list one of them',
            'warn',
        )


def _space_of_linear_axis(machine: Machine) -> Space:
    if machine.known('gear_factor'):
        return _each(machine, 0.45, 0.12, 0.9, 20.0)
    return _each(machine, 0.125, 0.12, 0.12, 1.2)


LINEAR_AXIS = Kind(
    name='linear_axis',
    title='independent carriages; gear elastic or rigid',
    keys=keys_of('linear_axis'),
    model=later('ros2_ident.models.drives.separate:LinearAxis'),
    judge=_judge_linear_axis,
    starts_in_motion=True,
    space=_space_of_linear_axis,
)


MUJOCO = Kind(
    name='mujoco',
    title='an MJCF that MuJoCo simulates, its actuators following the set-points',
    keys=keys_of('mujoco'),
    model=later('ros2_ident.models.mujoco.model:Mujoco'),
    starts_in_motion=True,
    travel='rad',
    read=later('ros2_ident.models.mujoco.plant:Plant'),
    joints=later('ros2_ident.models.mujoco.plant:joints_of'),
    compares=('position',),
    space=later('ros2_ident.models.mujoco.model:space'),
    ends=later('ros2_ident.models.mujoco.model:ends'),
    described=('joint_zero', 'armature', 'damping', 'frictionloss', 'stiffness', 'kp', 'kv',
               'force_limit', 'actuator_gear', 'body_mass', 'body_place',
               'body_centre', 'body_inertia', 'free_fall'),
)  # fmt: skip


def _judge_platform(draft: Draft, of: str, name: str) -> Iterator[Remark]:
    """Judge three drives that carry a platform from the ends of rails, or of arms on shafts."""
    # Where three drives stand has no number for all of them.
    azimuth = f'{of}_azimuth'
    angles, box = (draft.present.get((part, azimuth)) for part in ('geometry', 'parameters'))
    if angles is not None and not isinstance(angles, list):
        yield Remark(('geometry', azimuth), f'geometry.{azimuth} needs three angles in rad')
    if isinstance(box, list) and box and not isinstance(box[0], list):
        yield Remark(
            ('parameters', azimuth),
            f'parameters.{azimuth} needs a list of three boxes, one for each {of}, as '
            f'`{draft.line("parameters", azimuth)}`',
        )
    rods, radii, arms = (
        draft.numbers('geometry', key) for key in ('rod_length', f'{of}_radius', 'arm_length')
    )
    if rods and radii and rods[0] <= radii[0] - sum(arms[:1]):
        less = f' less {arms[0]:g} m (arm_length)' if arms else ''
        yield Remark(
            ('geometry', 'rod_length'),
            f'rod_length {rods[0]:g} m does not reach the middle, {radii[0]:g} m away '
            f'({of}_radius){less}; correct one of them',
        )
    yield from _judge_drives(draft, f'a {name} has elastic gears')


ROTARY_TRIPOD = Kind(
    name='rotary_tripod',
    title='a delta: three arms on shafts, three rods, one platform',
    keys=keys_of('rotary_tripod'),
    model=later('ros2_ident.models.tripod.model:Delta'),
    drives=3,
    judge=lambda draft: _judge_platform(draft, 'shaft', 'delta'),
    travel='rad',
    check_motion=later('ros2_ident.models.tripod.reach:check_reach'),
    scene=later('ros2_ident.models.tripod.reach:figure'),
    space=later('ros2_ident.models.tripod.reach:space_of_delta'),
    set_points=later('ros2_ident.models.tripod.reach:set_points_of_delta'),
    alike=True,
)


_TABLE = ('dh_a', 'dh_alpha', 'dh_d', 'dh_theta')


def _judge_serial(draft: Draft) -> Iterator[Remark]:
    table = [name for name in _TABLE if draft.states('geometry', name)]
    described = draft.states('geometry', 'description')
    missing = next((name for name in _TABLE if name not in table), None)
    if not described and missing is not None:
        yield Remark(
            ('geometry',),
            f'geometry has neither a description nor {missing}; add `description: arm.urdf`, or '
            f'the table of {", ".join(_TABLE)}',
        )
    pulls = [
        name for name in ('balance_force', 'balance_rate') if draft.states('parameters', name)
    ]
    if pulls and not all(draft.states('drive', f'balance_{x}') for x in ('base', 'arm')):
        yield Remark(
            ('parameters', pulls[0]),
            f'{pulls[0]} is to be found, and nothing says where it pulls; add balance_base and '
            'balance_arm to drive, 0 for joints without a counterbalance',
        )
    if described and table:
        yield Remark(
            ('geometry', table[0]),
            f'{table[0]} is not looked at beside geometry.description; leave one of them out',
            'warn',
        )


def _compared_freely(machine: Machine) -> tuple[str, ...]:
    """Return the position; the effort, too, where only it tells damping from the controller's."""
    both = {'velocity_gain', 'viscous_torque'} <= set(machine.bounds)
    return ('position', 'effort') if both else ('position',)


SERIAL = Kind(
    name='serial',
    title='an arm of links and joints, under PID on position or driven by its recorded motion',
    keys=keys_of('serial'),
    model=later('ros2_ident.models.serial.model:Serial'),
    judge=_judge_serial,
    check_motion=later('ros2_ident.models.serial.arm:check_reach'),
    asked=later('ros2_ident.models.serial.parameters:asked'),
    tilt=later('ros2_ident.models.serial.arm:base_tilt'),
    travel='rad',
    starts_in_motion=True,
    follows=lambda machine: machine.known('position_gain'),
    freely=_compared_freely,
    scene=later('ros2_ident.models.serial.arm:figure'),
    read=later('ros2_ident.models.serial.arm:arm_of'),
    joints=joints_in,
    extent=later('ros2_ident.models.serial.arm:extent_of'),
    space=later('ros2_ident.models.serial.arm:space'),
    ends=later('ros2_ident.models.serial.arm:ends'),
    described=('link_mass', 'link_moment', 'link_inertia'),
)


# What a servo logs beside a torque: the share of its supply, the motor's voltage or its current.
DUTY, VOLTAGE, CURRENT = 'duty', 'V', 'A'


def _judge_servo(draft: Draft) -> Iterator[Remark]:
    def known(name: str) -> bool:
        return draft.states('drive', name) or draft.states('parameters', name)

    if not (known('load_inertia') or known('load_length') or known('armature')):
        yield Remark(
            ('drive',),
            'nothing has an inertia: give armature, load_inertia, or load_mass and load_length',
        )
    if (known('load_mass') or known('arm_mass')) and not known('load_length'):
        yield Remark(
            ('drive', 'load_length'),
            'a mass without load_length neither weighs nor has inertia; add the length of the arm',
            'warn',
        )
    if draft.states('parameters', 'gear_damping_ratio') and not draft.states(
        'parameters', 'gear_stiffness'
    ):
        yield Remark(
            ('parameters', 'gear_damping_ratio'),
            'a gear that is damped has to give: list gear_stiffness, too, or remove the line',
        )


SERVO = Kind(
    name='servo',
    title='motors fed with a voltage by P or PD on position, arms or inertias as load',
    keys=keys_of('servo'),
    model=later('ros2_ident.models.drives.separate:Servo'),
    judge=_judge_servo,
    starts_in_motion=True,
    travel='rad',
    compares=('position',),
    logs=(DUTY, VOLTAGE, CURRENT),
    released=True,
    efforts=later('ros2_ident.models.drives.separate:stall_torque'),
    space=lambda machine: _each(machine, 0.0, 1.2, 4.0, 30.0),
)


TRIPOD = Kind(
    name='tripod',
    title='three vertical drives, three rods, one platform',
    keys=keys_of('tripod'),
    model=later('ros2_ident.models.tripod.model:Tripod'),
    drives=3,
    judge=lambda draft: _judge_platform(draft, 'rail', 'tripod'),
    check_motion=later('ros2_ident.models.tripod.reach:check_reach'),
    scene=later('ros2_ident.models.tripod.reach:figure'),
    space=later('ros2_ident.models.tripod.reach:space'),
    set_points=later('ros2_ident.models.tripod.reach:set_points'),
    alike=True,
)

OWN = (BELT_DRIVE, LINEAR_AXIS, MUJOCO, ROTARY_TRIPOD, SERIAL, SERVO, TRIPOD)


# ---------------------------------------------------------------------- controlled drives


def _judge_drives(draft: Draft, elastic: str = '') -> Iterator[Remark]:
    """Judge controlled drives; `elastic` says why their gears have to give, where they have to."""
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
                ('parameters',),
                f'parameters lacks {name}: {why}; add the line '
                f'`{draft.line("parameters", name)}`, and hold a known value '
                f'with --fix {name}=VALUE',
            )


def _units(draft: Draft) -> Iterator[Remark]:
    gears = draft.numbers('drive', 'gear_factor')
    geared = bool(gears) or draft.states('parameters', 'gear_factor')
    unit = draft.effort_unit
    if unit == 'N' and any(gear != 1.0 for gear in gears):
        gear = next(gear for gear in gears if gear != 1.0)
        yield Remark(
            ('drive', 'gear_factor'),
            f'gear_factor is {gear:g} but effort_unit is N: a force needs none; leave it out, or '
            'state the unit of a torque',
            'warn',
        )
    if draft.turns and (unit == 'N' or geared):
        other = 'effort_unit N' if unit == 'N' else 'gear_factor'
        yield Remark(
            ('parameters', 'moving_mass'),
            f'moving_mass in kg m^2 says that the joint turns, {other} that it travels; state the '
            'mass in kg, or correct the other',
        )
    if unit == 'N m' and not geared and not draft.turns:
        yield Remark(
            ('effort_unit',) if ('effort_unit',) in draft.present else ('drive',),
            'the effort is a torque but drive.gear_factor is missing; add it in rad/m, or write '
            '`effort_unit: N`, or `moving_mass` in kg m^2 where a joint turns',
            'warn',
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
            ('controller', 'integral_gain'),
            'integral_gain has no meaning under `law: cascade_p`, which has no integral part; '
            'write 0, or `law: cascade_pi`',
            'warn',
        )


def _travel(draft: Draft) -> Iterator[Remark]:
    pairs = draft.each(('drive', 'gear_factor'), ('drive', 'travel_per_turn'))
    for gear, turn in pairs if draft.effort_unit != 'N' else ():
        if gear and turn and not 0.98 < turn * gear / (2.0 * math.pi) < 1.02:
            yield Remark(
                ('drive', 'travel_per_turn'),
                f'travel_per_turn {turn:g} m and gear_factor {gear:g} rad/m contradict each '
                f'other; one turn is {2.0 * math.pi / gear:.4g} m by the gear_factor',
                'warn',
            )
            return
