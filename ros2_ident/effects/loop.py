# SPDX-License-Identifier: Apache-2.0
"""Laws between set-point and torque: encoder, current loop, torque constant."""

from typing import Any

from ros2_ident.effects.effect import closed_loop, Effect, EffectParameter, Hook
from ros2_ident.lanes import exp, floor, inlined, maximum, spread, where


@inlined
def _current_loop_lag(value: Any, drive: Any, p: Any) -> Any:
    # The mean over the cycle: integration steps may be longer than the lag.
    tau = maximum(p[0], spread(1e-7))
    share = (1.0 - exp(-drive.elapsed / tau)) * tau / drive.elapsed
    return where(p[0] > spread(1e-7), value + (drive.memory - value) * share, value)


@inlined
def _current_loop_lag_keeps(value: Any, drive: Any, p: Any) -> Any:
    tau = maximum(p[0], spread(1e-7))
    return value + (drive.memory - value) * exp(-drive.elapsed / tau)


@inlined
def _encoder_quantisation(value: Any, drive: Any, p: Any) -> Any:
    step = maximum(p[0], spread(1e-12))
    return where(p[0] > spread(1e-9), step * floor(value / step + 0.5), value)


@inlined
def _torque_constant_error(value: Any, drive: Any, p: Any) -> Any:
    return value * p[1]


EFFECTS = (
    Effect(
        id='current_loop_lag',
        about='The motor makes the commanded torque with a first-order lag.',
        group='controller',
        title='current-loop lag',
        equation="M' = (M_commanded - M) / tau",
        source='Leonhard, Control of Electrical Drives',
        parameters=(
            EffectParameter('time_constant', 's', 0.0, 0.02, 0.0, starts=(1e-3,), symbol='tau'),
        ),
        hook=Hook.COMMAND,
        kernel=_current_loop_lag,
        keeps=_current_loop_lag_keeps,
        place='drive',
        family='loop timing',
        confusable=('command_delay', 'effort_filter', 'effort_delay', 'velocity_gain_error'),
        separated_by='excite {drive} with a chirp beyond the crossover of its velocity loop',
        needs=closed_loop,
    ),
    Effect(
        id='encoder_quantisation',
        about='The controller reads the position in steps.',
        group='controller',
        title='encoder quantisation',
        equation='position rounded to whole steps',
        source='least significant bit of an encoder',
        parameters=(
            EffectParameter('step', 'm', 0.0, 5e-4, 0.0, starts=(2e-5, 1e-4),
                            meaning='step of the encoder'),
        ),
        hook=Hook.READING,
        kernel=_encoder_quantisation,
        place='drive',
        family='reading',
        confusable=(),
        separated_by='creep with {drive} at less than ten steps a second',
        needs=closed_loop,
        shown_by='reading_steps',
    ),
    Effect(
        id='torque_constant_error',
        about='A wrong torque constant: the motor makes another torque than asked, or the '
        'log shows another.',
        group='measurement',
        title='torque constant error',
        equation='logged effort times g; motor torque a times the commanded one',
        source='MuJoCo dcmotor note; gap between current and torque',
        parameters=(
            EffectParameter('factor', '1', 0.7, 1.4, 1.0, target='log_gain', how='scale',
                            symbol='g', meaning='factor on the logged effort'),
            EffectParameter('actuator', '1', 0.7, 1.4, 1.0, symbol='a',
                            meaning='factor on the motor torque'),
        ),
        hook=Hook.COMMAND,
        kernel=_torque_constant_error,
        place='drive',
        family='scale of effort',
        confusable=('velocity_gain_error', 'load_dependent_friction'),
        separated_by='repeat the motion of {drive} with a weighed mass added',
    ),
)  # fmt: skip
