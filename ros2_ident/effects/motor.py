# SPDX-License-Identifier: Apache-2.0
"""Motors and their controllers: what they make, read and are asked for."""

from typing import Any

from ros2_ident.effects.effect import closed_loop, Effect, EffectParameter, Hook
from ros2_ident.lanes import cosine, exp, floor, inlined, maximum, sine, spread, where


@inlined
def _current_loop_lag(value: Any, drive: Any, p: Any) -> Any:
    # The mean over the cycle: integration steps may be longer than the lag.
    tau = maximum(p[0], spread(1e-7))
    share = (1.0 - exp(-drive.elapsed / tau)) * tau / drive.elapsed
    return where(p[0] > spread(1e-7), value + (drive.memory - value) * share, value)


@inlined
def _current_loop_lag_kept(value: Any, drive: Any, p: Any) -> Any:
    tau = maximum(p[0], spread(1e-7))
    return value + (drive.memory - value) * exp(-drive.elapsed / tau)


CURRENT_LOOP_LAG = Effect(
    id='current_loop_lag',
    group='controller',
    about='The motor makes the commanded torque with a first-order lag.',
    title='current-loop lag',
    equation="M' = (M_commanded - M) / tau",
    source='Leonhard, Control of Electrical Drives',
    parameters=(
        EffectParameter('time_constant', 's', 0.0, 0.02, 0.0, starts=(1e-3,), symbol='tau'),
    ),
    hook=Hook.COMMAND,
    kernel=_current_loop_lag,
    keeps=_current_loop_lag_kept,
    family='loop timing',
    confusable=('command_delay', 'effort_filter', 'effort_delay', 'velocity_gain_error'),
    separated_by='excite {drive} with a chirp beyond the crossover of its velocity loop',
    needs=closed_loop,
)


@inlined
def _encoder_quantisation(value: Any, drive: Any, p: Any) -> Any:
    step = maximum(p[0], spread(1e-12))
    return where(p[0] > spread(1e-9), step * floor(value / step + 0.5), value)


ENCODER_QUANTISATION = Effect(
    id='encoder_quantisation',
    group='controller',
    about='The controller reads the position in steps.',
    title='encoder quantisation',
    equation='position rounded to whole steps',
    source='least significant bit of an encoder',
    parameters=(EffectParameter('step', 'm', 0.0, 0.01, 0.0, starts=(1e-4, 7e-4, 3e-3)),),
    hook=Hook.READING,
    kernel=_encoder_quantisation,
    family='reading',
    confusable=(),
    separated_by='creep with {drive} at less than ten steps a second',
    needs=closed_loop,
    shown_by='reading_steps',
)


@inlined
def _torque_constant_error(value: Any, drive: Any, p: Any) -> Any:
    return value * p[1]


TORQUE_CONSTANT_ERROR = Effect(
    id='torque_constant_error',
    group='measurement',
    about='A wrong torque constant: the motor makes another torque than asked, or the log shows '
    'another.',
    title='torque constant error',
    equation='logged effort times g; motor torque a times the commanded one',
    source='MuJoCo dcmotor note; gap between current and torque',
    parameters=(
        EffectParameter('factor', '1', 0.7, 1.4, 1.0, target='log_gain', how='scale', symbol='g',
                        meaning='factor on the logged effort'),
        EffectParameter(
            'actuator', '1', 0.7, 1.4, 1.0, symbol='a', meaning='factor on the motor torque'
        ),
    ),
    hook=Hook.COMMAND,
    kernel=_torque_constant_error,
    family='scale of effort',
    confusable=('velocity_gain_error', 'load_dependent_friction'),
    separated_by='repeat the motion of {drive} with a weighed mass added',
)  # fmt: skip


@inlined
def _torque_ripple(value: Any, drive: Any, p: Any) -> Any:
    angle = p[2] * drive.turn * drive.position
    return value + p[0] * sine(angle) + p[1] * cosine(angle)


TORQUE_RIPPLE = Effect(
    id='torque_ripple',
    about='Torque that ripples with the motor angle: cogging.',
    title='torque ripple',
    equation='A sin(n gear z) + B cos(n gear z) added to the motor torque',
    source='Holtz and Springob, IEEE TIE 43(2), 1996',
    parameters=(
        # The whole effort: it may be all that a motor without a load makes effort for.
        EffectParameter('sine', 'effort', -1.0, 1.0, 0.0, symbol='A'),
        EffectParameter('cosine', 'effort', -1.0, 1.0, 0.0, symbol='B'),
        EffectParameter('order', '1', 0.5, 24.5, 1.0,
                        starts=tuple(float(n) for n in (*range(1, 9), *range(10, 21, 2), 24)),
                        role='order', limit='cable_spring', symbol='n',
                        meaning='periods per motor turn; where no gear is stated, per turn of the '
                        'joint, as many as the log resolves'),
    ),
    hook=Hook.TORQUE,
    kernel=_torque_ripple,
    family='motor angle',
    confusable=('transmission_eccentricity',),
    separated_by='turn {drive} slowly at constant speed over many motor turns',
    bent=True,
    # Those of slots, of poles and of both together. By hand.
    most=3,
)  # fmt: skip
