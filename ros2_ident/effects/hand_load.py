# SPDX-License-Identifier: Apache-2.0
"""A load that an arm carries and its description does not know of."""

from ros2_ident.effects.effect import Context, Effect, EffectParameter


def _moment(axis: str) -> EffectParameter:
    name = f'moment_{axis}'
    return EffectParameter(
        name, 'load m', -1.0, 1.0, 0.0, target=f'hand_{name}', symbol=f'm_L {axis}',
        meaning=f"mass times its place along {axis} of the last joint's frame",
    )  # fmt: skip


def _arm(context: Context) -> bool:
    return 'hand' in context.features


EFFECT = Effect(
    id='hand_load',
    group='structure',
    title='load in the hand',
    equation='last link plus a point mass m_L at (x, y, z)',
    source='Newton; a point mass in the frame of the last joint',
    parameters=(
        EffectParameter('mass', 'load', -1.0, 1.0, 0.0, target='hand_mass', symbol='m_L'),
        *map(_moment, 'xyz'),
    ),
    place='all',
    family='mass',
    confusable=('torque_constant_error',),
    separated_by='hold the hand in several directions, and repeat with a load that is known',
    needs=_arm,
)
