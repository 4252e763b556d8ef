# SPDX-License-Identifier: Apache-2.0
"""Arms: links and joints from a URDF, an MJCF or a table, driven by their recorded motion."""

from collections.abc import Iterator
from functools import partial
import math

from ros2_ident.machine.description import joints_in
from ros2_ident.machine.draft import Draft, Remark
from ros2_ident.machine.keys import head, Key, of_drive, of_geometry, sought
from ros2_ident.machine.kind import Kind, later
from ros2_ident.models.drives import keys

_TABLE = ('dh_a', 'dh_alpha', 'dh_d', 'dh_theta')


# A column of the table of modified Denavit-Hartenberg parameters.
_row = partial(
    of_geometry, absent='needed where there is no description', low=-20.0, high=20.0, each=True
)
_of_payload = partial(Key, 'parameters', low=-1e3, high=1e3, shown=False)


def _of_balance(
    name: str, unit: str, meaning: str, example: float, default: float, low: float = 0.0,
    high: float = math.inf, absent: str = '0 by default',
) -> Key:
    """Return a constant of a counterbalance; where both distances are 0 there is none."""
    return of_drive(f'balance_{name}', unit, meaning, example, absent=absent, default=default,
                    low=low, high=high, shown=False)  # fmt: skip


_GEOMETRY = (
    of_geometry('description', '',
                "URDF or MJCF, its way from this file's folder; instead of the table", 'arm.urdf',
                absent='the table below by default', default='', shown=False, file=True),
    _row('dh_a', 'm', 'modified Denavit-Hartenberg: a of the link before', (0.0, 0.0, 0.4)),
    _row('dh_alpha', 'rad', 'alpha of the link before', (0.0, -0.5 * math.pi, 0.0)),
    _row('dh_d', 'm', 'd along the joint', (0.3, 0.0, 0.0)),
    _row('dh_theta', 'rad', 'theta where the position is 0', (0.0, 0.0, 0.0)),
    of_geometry('joint', '', 'revolute (also continuous) or prismatic, in a table',
                ('revolute', 'revolute', 'revolute'), absent='revolute by default',
                default='revolute', each=True, choices=('revolute', 'prismatic'),
                aliases=(('continuous', 'revolute'),)),
    of_geometry('free_fall', 'm/s^2', 'acceleration of free fall', 9.81, absent='9.81 by default',
                default=9.81, low=0.0, high=25.0),
    of_geometry('base_roll', 'rad', 'tilt of the base about x', 0.0, absent='0 by default',
                default=0.0, low=-math.pi, high=math.pi),
    of_geometry('base_pitch', 'rad', 'tilt of the base about y, after roll', 0.0,
                absent='0 by default', default=0.0, low=-math.pi, high=math.pi),
)  # fmt: skip
_DRIVE = (
    of_drive('gear_factor', '1',
             'motor angle per joint angle, where the effort is that of the motor', 100.0,
             absent='1 by default: the effort is that of the joint', low=0.1, high=1e4,
             force_unit='rad/m', shown=False),
    of_drive('travel_per_turn', 'rad', 'joint angle per motor turn, for effects that follow it',
             0.0628, absent='2 pi / gear_factor by default', default=keys.turn_of_gear,
             low=1e-5, high=10.0, force_unit='m', shown=False),
    of_drive('coulomb_regularisation', 'rad/s',
             'width v of the step in Coulomb friction, tanh(speed / v)', 0.02,
             absent='error of its speeds by default', default=0.02, low=1e-5, high=1.0,
             force_unit='m/s', shown=False),
)
_COUPLING = (
    of_drive('coupled_to', '',
             'joint with which the motor turns, too: a belt or a hollow wrist passes it',
             ('none', 'none', 'joint_2'), absent='none by default', default='none', shown=False),
    of_drive('coupling', 'rad/rad', 'how far it turns with that joint', 1.0, absent='1 by default',
             default=1.0, low=-10.0, high=10.0, shown=False),
)
_BALANCE = (
    _of_balance('base', 'm', "a counterbalance's anchor before the joint, from its axis", 0.8,
                0.0, high=10.0),
    _of_balance('arm', 'm', 'its anchor behind the joint, from the axis', 0.2, 0.0, high=10.0),
    _of_balance('angle', 'rad', 'position where it is shortest', -1.57, 0.0, low=-10.0, high=10.0),
    _of_balance('stroke', 'm', "way from there that would leave its gas no room, of a gas's force "
                'F/(1 - way/stroke)', 0.6, math.inf, low=1e-3, absent='a spring by default'),
    _of_balance('force', 'N', 'force with which it pulls where it is shortest', 1e4, 0.0, low=-1e6,
                high=1e6),
    _of_balance('rate', 'N/m', 'by which its force grows with its length', 1e4, 0.0, low=-1e8,
                high=1e8),
)
_LINKS = (
    sought('link_mass', 'kg', "of the links, as far from the description's", (-20.0, 20.0),
           low=-1e4, high=1e4, shown=False),
    sought('link_moment', 'kg m', "first moments, as far from the description's", (-20.0, 20.0),
           low=-1e4, high=1e4),
    sought('link_inertia', 'kg m^2', "inertias, as far from the description's", (-20.0, 20.0),
           low=-1e4, high=1e4),
)  # fmt: skip
_PAYLOAD = (
    _of_payload('payload_mass', 'kg', 'point mass at the last link', (0.0, 10.0)),
    _of_payload('payload_x', 'm', 'its place, in the frame of the last joint', (-0.3, 0.3)),
    _of_payload('payload_y', 'm', 'the same along y', (-0.3, 0.3)),
    _of_payload('payload_z', 'm', 'the same along z', (-0.3, 0.3)),
)
_OF_DRIVES = (
    keys.turning(keys.INERTIA, (0.0, 5.0)),
    keys.turning(keys.FRICTION[0], (0.0, 50.0)),
    keys.turning(keys.FRICTION[1], (0.0, 100.0)),
    keys.turning(keys.FRICTION[-1], (-20.0, 20.0)),
)


def _judge(draft: Draft) -> Iterator[Remark]:
    table = [name for name in _TABLE if draft.states('geometry', name)]
    described = draft.states('geometry', 'description')
    missing = next((name for name in _TABLE if name not in table), None)
    if not described and missing is not None:
        yield Remark(
            'error',
            ('geometry',),
            f'geometry has neither a description nor {missing}; add `description: arm.urdf`, or '
            f'the table of {", ".join(_TABLE)}',
        )
    pulls = [key.name for key in _BALANCE if draft.states('parameters', key.name)]
    if pulls and not all(draft.states('drive', f'balance_{x}') for x in ('base', 'arm')):
        yield Remark(
            'error',
            ('parameters', pulls[0]),
            f'{pulls[0]} is to be found, and nothing says where it pulls; add balance_base and '
            'balance_arm to drive, 0 for joints without a counterbalance',
        )
    if described and table:
        yield Remark(
            'warn',
            ('geometry', table[0]),
            f'{table[0]} is not looked at beside geometry.description; leave one of them out',
        )


KIND = Kind(
    name='serial',
    title='an arm of links and joints, driven by its recorded motion',
    keys=(
        *head('serial', ('joint_1', 'joint_2', 'joint_3'), noise=0.1),
        *_GEOMETRY,
        *_DRIVE,
        *_COUPLING,
        *_BALANCE,
        Key('controller', 'cycle', 's', 'period of the log', 0.008, low=1e-6, high=0.05),
        Key('controller', 'bandwidth', 'Hz', 'efforts are compared below it; above it links and '
            'gears, rigid here, swing', 10.0, absent='by the log by default',
            default=math.inf, low=0.1, high=1e4, shown=False),
        Key('controller', 'least_speed', 'rad/s', 'a joint is compared where it is faster', 0.05,
            absent='by its readings by default', default=0.0, force_unit='m/s', low=0.0, high=10.0,
            shown=False, each=True),
        keys.DELAY.at(
            (0.0, 0.05),
            shown=False,
            absent='none by default',
            low=-0.2,
            meaning='how late the effort is in the log; below 0 where it is a command',
        ),
        *_LINKS,
        *_PAYLOAD,
        *_OF_DRIVES,
        *(key.searched() for key in _DRIVE if key.name == 'coulomb_regularisation'),
        *(key.searched(0.0) for key in _BALANCE if key.name in ('balance_force', 'balance_rate')),
    ),
    model=later('ros2_ident.models.serial.model:Serial'),
    judge=_judge,
    check_motion=later('ros2_ident.models.serial.reach:check_reach'),
    travel='rad',
    follows=False,
    scene=later('ros2_ident.models.serial.reach:figure'),
    read=later('ros2_ident.models.serial.arm:arm_of'),
    joints=joints_in,
    extent=later('ros2_ident.models.serial.arm:extent_of'),
    space=later('ros2_ident.models.serial.reach:space'),
    ends=later('ros2_ident.models.serial.reach:ends'),
    described=('link_mass', 'link_moment', 'link_inertia'),
)
