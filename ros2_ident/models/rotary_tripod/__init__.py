# SPDX-License-Identifier: Apache-2.0
"""Three arms on shafts that carry one platform on rods: a tripod with rotary drives."""

from collections.abc import Iterator
import math

from ros2_ident.machine.draft import Draft, Remark
from ros2_ident.machine.keys import head, Key, of_drive, of_geometry
from ros2_ident.machine.kind import Kind, later
from ros2_ident.machine.units import angular
from ros2_ident.models.drives import keys

_DRIVES = ('drive_1', 'drive_2', 'drive_3')
_GEOMETRY = (
    of_geometry('shaft_azimuth', 'rad', 'where the three arms point, about the vertical',
                (0.0, 2.0943951, 4.1887902), low=-2.0 * math.pi, high=2.0 * math.pi, each=True,
                remedy='write the angles in rad'),
    of_geometry('shaft_radius', 'm',
                'circle of the shafts less that of the joints on the platform', 0.15,
                low=1e-4, high=10.0),
    of_geometry('arm_length', 'm', 'from shaft to joint, all arms alike', 0.25,
                low=1e-3, high=20.0),
    of_geometry('rod_length', 'm', 'from joint to joint, all rods alike', 0.55,
                low=1e-3, high=20.0),
    of_geometry('gravity', 'm/s^2', 'downwards, towards the platform', 9.81, low=-9.9, high=9.9),
    of_geometry('positive', '', 'where positive angles turn the arms: down or up', 'down',
                absent='down by default', default='down', choices=('down', 'up')),
    of_geometry('arm_zero', 'rad', 'position at which an arm lies level', 0.0,
                absent='0 by default', default=0.0, low=-2.0 * math.pi, high=2.0 * math.pi,
                each=True),
)
_ARM = (
    of_drive('arm_inertia', 'kg m^2', 'of an arm about its shaft', 0.02, low=0.0, high=1e3),
    of_drive('arm_moment', 'kg m',
             'mass of an arm times the distance of its centre from the shaft', 0.07,
             absent='0 by default', default=0.0, low=-1e3, high=1e3),
)
# Examples of numbers that are others for a joint than for a carriage.
_EXAMPLES: dict[str, object] = {
    'gear_factor': 30.0,
    'travel_per_turn': 0.2094395,
    'coulomb_regularisation': 0.02,
    'velocity_gain': 0.5,
    'integral_gain': 25.0,
    'torque_limit': 3.0,
    'gear_stiffness': (1e2, 2e4),
    'coulomb_torque': (0.0, 0.1),
    'viscous_torque': (0.0, 0.02),
}
# Widest plausible values where metres have become radians.
_HIGH = {'coulomb_regularisation': 1.0, 'travel_per_turn': 10.0}
_CHANGED: dict[str, dict[str, object]] = {
    'coulomb_regularisation': {'default': 0.02, 'absent': '0.02 by default'},
    'travel_per_turn': {'meaning': 'angle per motor turn, for effects that follow it'},
}


def _turning(key: Key) -> Key:
    """Return a key of a drive that moves a carriage as it is for one that turns an arm."""
    if key.name == 'gear_factor':
        return key.at(30.0, unit='1', meaning='motor angle per angle of the arm',
                      absent='1 by default: the effort is that of the arm')  # fmt: skip
    example = _EXAMPLES.get(key.name, key.example)
    unit = key.force_unit or key.unit.replace('N m', 'N')
    unit = key.unit if key.unit in ('s', '1/s', '1', '', 'kg m^2') else angular(unit)
    meaning = key.meaning.replace('of the carriage', 'of the arm').replace('carriage', 'arm')
    changed = key.at(example, unit=unit, meaning=meaning, high=_HIGH.get(key.name, key.high))
    return changed.at(example, **_CHANGED.get(key.name, {}))


_DRIVE = tuple(_turning(key) for key in keys.drive_keys(0.0) if key.name != 'rail_mass')
_CONTROLLER = tuple(_turning(key) for key in keys.controller_keys(5.0e-4))
_GEAR = tuple(_turning(key) for key in keys.GEAR)
_FRICTION = tuple(_turning(key) for key in keys.FRICTION[:2])
_TOOL = Key('parameters', 'tool_mass', 'kg', 'of platform and tool', (0.2, 2.0),
            low=0.0, high=1e3)


def _judge(draft: Draft) -> Iterator[Remark]:
    yield from keys.judge_azimuth(draft, 'shaft_azimuth')
    lengths = [draft.numbers('geometry', name) for name in ('rod_length', 'shaft_radius')]
    arms = draft.numbers('geometry', 'arm_length')
    if all(lengths) and arms and lengths[0][0] <= lengths[1][0] - arms[0]:
        yield Remark(
            'error',
            ('geometry', 'rod_length'),
            f'rod_length {lengths[0][0]:g} m does not reach the middle, {lengths[1][0]:g} m away '
            f'(shaft_radius) less {arms[0]:g} m (arm_length); correct one of them',
        )
    yield from keys.judge_drives(draft, 'a delta has elastic gears')


KIND = Kind(
    name='rotary_tripod',
    title='a delta: three arms on shafts, three rods, one platform',
    keys=(
        *head(
            'rotary_tripod', _DRIVES, 'joint names in the bag, in the order of shaft_azimuth'
        ),
        *_GEOMETRY,
        *_DRIVE,
        *_ARM,
        *_CONTROLLER,
        keys.DELAY,
        *_GEAR,
        _TOOL,
        keys.INERTIA.at((1e-5, 1e-4)),
        _ARM[0].searched(0.005, 0.05, shown=True),
        *_FRICTION,
        _GEOMETRY[0].searched(-0.05, 0.05),
        *(key.searched() for key in _GEOMETRY[1:5]),
        _GEOMETRY[-1].searched(-0.05, 0.05),
        _ARM[1].searched(),
        *keys.free_constants(*_DRIVE, *_CONTROLLER),
    ),
    model=later('ros2_ident.models.tripod.model:Delta'),
    drives=3,
    judge=_judge,
    travel='rad',
    check_motion=later('ros2_ident.models.tripod.reach:check_reach'),
    scene=later('ros2_ident.models.tripod.reach:figure'),
    space=later('ros2_ident.models.tripod.reach:space_of_delta'),
    set_points=later('ros2_ident.models.tripod.reach:set_points_of_delta'),
    alike=True,
)
