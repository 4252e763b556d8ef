# SPDX-License-Identifier: Apache-2.0
"""Three vertical linear drives that carry one platform on rods."""

from collections.abc import Iterator

from ros2_ident.machine.draft import Draft, Remark
from ros2_ident.machine.keys import keys_of
from ros2_ident.machine.kind import Kind, later
from ros2_ident.models.drives import keys


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
    keys=keys_of('tripod'),
    model=later('ros2_ident.models.tripod.model:Tripod'),
    drives=3,
    judge=_judge,
    check_motion=later('ros2_ident.models.tripod.reach:check_reach'),
    scene=later('ros2_ident.models.tripod.reach:figure'),
    space=later('ros2_ident.models.tripod.reach:space'),
    set_points=later('ros2_ident.models.tripod.reach:set_points'),
    alike=True,
)
