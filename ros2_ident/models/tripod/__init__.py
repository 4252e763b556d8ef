# SPDX-License-Identifier: Apache-2.0
"""Three vertical linear drives that carry one platform on rods."""

from collections.abc import Iterator
import math

from ros2_ident.machine.draft import Draft, Remark
from ros2_ident.machine.keys import head, Key, of_geometry
from ros2_ident.machine.kind import Kind, later
from ros2_ident.models.drives import keys

_DRIVES = ('drive_1', 'drive_2', 'drive_3')
_GEOMETRY = (
    of_geometry('rail_azimuth', 'rad', 'where the three rails stand, about the vertical',
                (0.0, 2.0943951, 4.1887902), low=-2.0 * math.pi, high=2.0 * math.pi, each=True,
                remedy='write the angles in rad'),
    of_geometry('rail_radius', 'm',
                'circle of the joints on the carriages less that on the platform', 0.30,
                low=1e-3, high=10.0),
    of_geometry('rod_length', 'm', 'from joint to joint, all rods alike', 0.60,
                low=1e-3, high=20.0),
    of_geometry('gravity', 'm/s^2', 'downwards, against positive positions', 9.81,
                low=-9.9, high=9.9),
)
_TOOL = Key('parameters', 'tool_mass', 'kg', 'of platform and tool', (0.5, 3.0),
            low=0.0, high=1e3)
_DRIVE = keys.drive_keys(1.2)
_CONTROLLER = keys.controller_keys(5.0e-4)


def _judge(draft: Draft) -> Iterator[Remark]:
    yield from keys.judge_azimuth(draft, 'rail_azimuth')
    for rods, rails in draft.each(('geometry', 'rod_length'), ('geometry', 'rail_radius')):
        if rods <= rails:
            yield Remark(
                'error',
                ('geometry', 'rod_length'),
                f'rod_length {rods:g} m does not reach the middle, {rails:g} m away '
                '(rail_radius); correct one of the two',
            )
    yield from keys.judge_drives(draft, 'a tripod has elastic gears')


KIND = Kind(
    name='tripod',
    title='three vertical drives, three rods, one platform',
    keys=(
        *head('tripod', _DRIVES, 'joint names in the bag, three, in the order of rail_azimuth'),
        *_GEOMETRY,
        *_DRIVE,
        *_CONTROLLER,
        keys.DELAY,
        *keys.GEAR,
        _TOOL,
        keys.INERTIA,
        *keys.FRICTION,
        _GEOMETRY[0].searched(-0.05, 0.05),
        *keys.free_constants(*_GEOMETRY[1:], *_DRIVE, *_CONTROLLER),
    ),
    model=later('ros2_ident.models.tripod.model:Tripod'),
    drives=3,
    judge=_judge,
    check_motion=later('ros2_ident.models.tripod.reach:check_reach'),
    scene=later('ros2_ident.models.tripod.reach:figure'),
    space=later('ros2_ident.models.tripod.reach:space'),
    set_points=later('ros2_ident.models.tripod.reach:set_points'),
    alike=True,
)
