# SPDX-License-Identifier: Apache-2.0
"""The efforts were smoothed forwards and backwards before they came into the log."""

from ros2_ident.effects.effect import Effect, EffectParameter

EFFECT = Effect(
    id='effort_smoothing',
    group='measurement',
    title='smoothed effort',
    equation='M_log = M through a Butterworth low-pass of order 2 and 1/T, forwards and backwards',
    source='Gustafsson, IEEE TSP 44(4), 1996; usual for published identification data',
    parameters=(
        EffectParameter('period', 's', 0.0, 1.5, 0.0, target='log_smoothing',
                        starts=(0.05, 0.2, 0.6), symbol='T', meaning='period of the cut-off'),
    ),
    place='all',
    family='log timing',
    confusable=('effort_filter', 'presliding'),
    separated_by='log the efforts as the drives report them',
    # What a controller asks for shows as it is; a file is smoothed after the run.
    needs=lambda context: not context.closed_loop,
)  # fmt: skip
