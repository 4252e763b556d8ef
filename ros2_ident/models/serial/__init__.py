# SPDX-License-Identifier: Apache-2.0
"""Arms: links and joints from a URDF, an MJCF or a table, driven by their recorded motion."""

from collections.abc import Iterator

from ros2_ident.machine.description import joints_in
from ros2_ident.machine.draft import Draft, Remark
from ros2_ident.machine.keys import keys_of
from ros2_ident.machine.kind import Kind, later

_TABLE = ('dh_a', 'dh_alpha', 'dh_d', 'dh_theta')


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
    pulls = [
        name for name in ('balance_force', 'balance_rate') if draft.states('parameters', name)
    ]
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
    keys=keys_of('serial'),
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
