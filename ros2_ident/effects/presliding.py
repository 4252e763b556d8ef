# SPDX-License-Identifier: Apache-2.0
"""Presliding: friction builds up over a way, as in a brush of bristles, not at once."""

from typing import Any

from ros2_ident.effects.effect import Effect, EffectParameter, Hook
from ros2_ident.lanes import absolute, exp, inlined, spread, where


@inlined
def _kernel(value: Any, drive: Any, p: Any) -> Any:
    # Dahl's equation dh/dx = (1 - h sgn x')/delta has a closed form while the direction stays.
    end = where(drive.travel > spread(0.0), spread(1.0), spread(-1.0))
    return end + (drive.memory - end) * exp(-absolute(drive.travel) / p[0])


EFFECT = Effect(
    id='presliding',
    group='drive',
    title='presliding hysteresis',
    equation='friction direction h instead of sgn v: dh/dx = (1 - h sgn v)/delta',
    source='Dahl, A solid friction model, 1968',
    parameters=(
        EffectParameter('way', 'm', 1e-5, 0.03, 1e-5, starts=(3e-4, 2e-3, 0.01), symbol='delta',
                        meaning='distance over which friction builds up'),
    ),
    hook=Hook.SIGN,
    kernel=_kernel,
    keeps=_kernel,
    family='friction at reversals',
    confusable=('stribeck', 'backlash'),
    separated_by='reverse {drive} over strokes growing from 20 um to 2 mm',
)  # fmt: skip
