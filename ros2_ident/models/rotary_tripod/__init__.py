# SPDX-License-Identifier: Apache-2.0
"""Three arms on shafts that carry one platform on rods: a tripod with rotary drives."""

from collections.abc import Iterator

from ros2_ident.machine.draft import Draft, Remark
from ros2_ident.machine.keys import keys_of
from ros2_ident.machine.kind import Kind, later
from ros2_ident.models.drives import keys


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
    keys=keys_of('rotary_tripod'),
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
