# SPDX-License-Identifier: Apache-2.0
"""The motor makes the commanded torque with a first-order lag."""

from typing import Any

from ros2_ident.effects.effect import closed_loop, Effect, EffectParameter, Hook
from ros2_ident.lanes import exp, inlined, maximum, spread, where


@inlined
def _kernel(value: Any, drive: Any, p: Any) -> Any:
    # The mean over the cycle: integration steps may be longer than the lag.
    tau = maximum(p[0], spread(1e-7))
    share = (1.0 - exp(-drive.elapsed / tau)) * tau / drive.elapsed
    return where(p[0] > spread(1e-7), value + (drive.memory - value) * share, value)


@inlined
def _keeps(value: Any, drive: Any, p: Any) -> Any:
    tau = maximum(p[0], spread(1e-7))
    return value + (drive.memory - value) * exp(-drive.elapsed / tau)


EFFECT = Effect(
    id='current_loop_lag',
    group='controller',
    title='current-loop lag',
    equation="M' = (M_commanded - M) / tau",
    source='Leonhard, Control of Electrical Drives',
    parameters=(
        EffectParameter('time_constant', 's', 0.0, 0.02, 0.0, starts=(1e-3,), symbol='tau'),
    ),
    hook=Hook.COMMAND,
    kernel=_kernel,
    keeps=_keeps,
    family='loop timing',
    confusable=('command_delay', 'effort_filter', 'effort_delay', 'velocity_gain_error'),
    separated_by='excite {drive} with a chirp beyond the crossover of its velocity loop',
    needs=closed_loop,
)
