# SPDX-License-Identifier: Apache-2.0
"""Play in the gear: no force while the teeth do not touch."""

from typing import Any

from ros2_ident.effects.effect import Effect, EffectParameter, elastic_gear, Hook
from ros2_ident.lanes import inlined, maximum, minimum, spread


@inlined
def _kernel(value: Any, drive: Any, p: Any) -> Any:
    x, slope = value
    half = 0.5 * p[0]
    return maximum(x - half, minimum(x + half, spread(0.0))), slope


EFFECT = Effect(
    id='backlash',
    group='drive',
    title='backlash',
    equation='gear force from the deflection less its part within +-b/2',
    source='Nordin and Gutman, Automatica 38(10), 2002',
    parameters=(
        EffectParameter(
            'gap', 'm', 0.0, 0.05, 0.0, starts=(7e-4, 3e-3, 0.02), symbol='b', meaning='whole play'
        ),
    ),
    hook=Hook.DEFLECTION,
    kernel=_kernel,
    family='gear play',
    confusable=('stribeck', 'presliding'),
    separated_by='reverse the load of {drive} without its motion: brake hard against gravity',
    needs=elastic_gear,
)
