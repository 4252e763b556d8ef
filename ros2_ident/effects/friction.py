# SPDX-License-Identifier: Apache-2.0
"""Laws of friction: at the motor, and with what presses the gear."""

from typing import Any

from ros2_ident.effects.effect import (
    along_rail,
    Effect,
    EffectParameter,
    fading,
    Hook,
    motor_torque,
    pressing,
)
from ros2_ident.lanes import absolute, exp, inlined, spread, tanh, where


@inlined
def _asymmetric_friction(value: Any, drive: Any, p: Any) -> Any:
    return value + (p[0] + p[1] * absolute(drive.velocity)) * absolute(drive.direction)


ASYMMETRIC_FRICTION = Effect(
    id='asymmetric_friction',
    about='Friction that differs between the two directions.',
    title='asymmetric friction',
    equation='M_a + V_a |v| added to friction in either direction',
    source='Janot et al. 2019; Elhami and Brookfield, Proc. IMechE C 210, 1996',
    parameters=(
        EffectParameter('coulomb', 'effort', -0.5, 0.5, 0.0, symbol='M_a',
                        meaning='half the difference in Coulomb friction'),
        EffectParameter('viscous', 'effort s/m', -0.5, 0.5, 0.0, symbol='V_a',
                        meaning='half the difference in viscous friction'),
    ),
    hook=Hook.FRICTION,
    kernel=_asymmetric_friction,
    family='direction',
    confusable=('constant_force', 'effort_bias'),
    separated_by='turn {drive} over: a force turns with it; go at several speeds both ways',
    # Its Coulomb part moves both ends of the friction, at rest too, as a force does.
    holds=('constant_force',),
)  # fmt: skip


@inlined
def _degressive_friction(value: Any, drive: Any, p: Any) -> Any:
    return value + p[0] * tanh(drive.velocity / p[1])


DEGRESSIVE_FRICTION = Effect(
    id='degressive_friction',
    about='Friction that rises with speed and levels off, as of a lubricant that thins.',
    title='degressive friction',
    equation='M_D tanh(v/v_D) added to friction, v_D well above the regularisation',
    source='Weigand, Ulmen, Janot, Ruskowski 2021, friction model of the KR 300',
    parameters=(
        EffectParameter('torque', 'effort', 0.0, 0.5, 0.0, symbol='M_D',
                        meaning='friction once it has levelled off'),
        EffectParameter('velocity', 'm/s', 0.01, 1.0, 0.1, starts=(0.03, 0.1, 0.3), role='shape',
                        symbol='v_D', meaning='speed at which it levels off'),
    ),
    hook=Hook.FRICTION,
    kernel=_degressive_friction,
    family='speed-dependent friction',
    confusable=('quadratic_drag', 'viscous_friction', 'stribeck'),
    separated_by='run {drive} at five constant speeds over its whole range, both ways',
)  # fmt: skip


@inlined
def _directional_load_friction(value: Any, drive: Any, p: Any) -> Any:
    pressed = absolute(p[0] * drive.torque + p[1] * drive.load / drive.gear)
    return value + pressed * drive.direction


DIRECTIONAL_LOAD_FRICTION = Effect(
    id='directional_load_friction',
    about='Friction of a gear that motor and load press together, each by a share of its own.',
    title='directional load friction',
    equation='|mu_M M + mu_F F / gear| sgn v added to friction',
    source='Duclusaud et al., ICRA 2025, models M3 (mu_M = mu_F) and M5',
    parameters=pressing('1', 0.95, 'mu'),
    hook=Hook.FRICTION,
    kernel=_directional_load_friction,
    family='load friction',
    confusable=('load_dependent_friction', 'coulomb_friction', 'stribeck_load_friction'),
    separated_by='lift and lower a weight slowly with {drive}, then another of half the size',
    needs=motor_torque,
)


@inlined
def _factor(time: Any, warmth: Any, p: Any) -> Any:
    return (1.0 + p[0] * (1.0 - exp(-time / p[2]))) * exp(p[1] * warmth)


@inlined
def _friction_drift(value: Any, drive: Any, p: Any) -> Any:
    return value * _factor(drive.time, drive.memory, p)


@inlined
def _friction_drift_kept(value: Any, drive: Any, p: Any) -> Any:
    friction = value * _factor(drive.time, drive.memory, p)
    power = absolute(friction * drive.velocity) * drive.gear
    return power + (drive.memory - power) * exp(-drive.elapsed / p[2])


FRICTION_DRIFT = Effect(
    id='friction_drift',
    about='Friction that changes while the machine warms up.',
    title='drifting friction',
    equation='friction times (1 + a (1 - exp(-t/T))) exp(b w); T dw/dt = friction power - w',
    source='Bittencourt and Gunnarsson, J. Dyn. Syst. Meas. Control 134(5), 2012',
    parameters=(
        EffectParameter('share', '1', -0.9, 1.0, 0.0, symbol='a',
                        meaning='share by which friction ends up changed'),
        EffectParameter('heating', '1/W', -300.0, 100.0, 0.0, symbol='b',
                        meaning='change per power of friction'),
        EffectParameter('time_constant', 's', 2.0, 1000.0, 10.0, starts=(3.0, 8.0, 100.0),
                        role='shape', symbol='T'),
    ),
    hook=Hook.FRICTION,
    kernel=_friction_drift,
    keeps=_friction_drift_kept,
    family='time',
    confusable=('stribeck',),
    separated_by='repeat one motion of {drive} at the start and after ten minutes',
)  # fmt: skip


@inlined
def _load_dependent_friction(value: Any, drive: Any, p: Any) -> Any:
    return value + p[0] * absolute(drive.load) / drive.gear * drive.direction


LOAD_DEPENDENT_FRICTION = Effect(
    id='load_dependent_friction',
    about='Friction that grows with the force the gear carries.',
    title='load-dependent friction',
    equation='mu |F| / gear sgn v added to friction',
    source='Hamon, Gautier, Garrec, Janot, IROS 2010; Duclusaud et al., ICRA 2025, model M3',
    parameters=(EffectParameter('coefficient', '1', 0.0, 0.4, 0.0, symbol='mu'),),
    hook=Hook.FRICTION,
    kernel=_load_dependent_friction,
    family='load friction',
    confusable=('coulomb_friction', 'asymmetric_friction'),
    separated_by='repeat the motion of {drive} with two payloads',
)


@inlined
def _position_dependent_friction(value: Any, drive: Any, p: Any) -> Any:
    return value + drive.coulomb * drive.direction * p[0] * (drive.position - p[1])


POSITION_DEPENDENT_FRICTION = Effect(
    id='position_dependent_friction',
    about='Dry friction that changes along the rail.',
    title='position-dependent friction',
    equation='Coulomb torque times 1 + a (z - z_0) added',
    source='Armstrong-Helouvry et al., Automatica 30(7), 1994',
    parameters=(
        EffectParameter('slope', '1/m', -2.0, 2.0, 0.0, symbol='a'),
        along_rail('middle', 'z_0', 'position without change', 'coulomb_friction'),
    ),
    hook=Hook.FRICTION,
    kernel=_position_dependent_friction,
    family='position',
    confusable=('cable_spring', 'load_dependent_friction'),
    separated_by='sweep {drive} slowly both ways over its whole stroke',
)


@inlined
def _presliding(value: Any, drive: Any, p: Any) -> Any:
    # Dahl's equation dh/dx = (1 - h sgn x')/delta has a closed form while the direction stays.
    end = where(drive.travel > spread(0.0), spread(1.0), spread(-1.0))
    return end + (drive.memory - end) * exp(-absolute(drive.travel) / p[0])


PRESLIDING = Effect(
    id='presliding',
    about='Presliding: friction builds up over a way, as of bristles, not at once.',
    title='presliding hysteresis',
    equation='friction direction h instead of sgn v: dh/dx = (1 - h sgn v)/delta',
    source='Dahl, A solid friction model, 1968',
    parameters=(
        EffectParameter('way', 'm', 1e-5, 0.03, 1e-5, starts=(3e-4, 2e-3, 0.01), symbol='delta',
                        meaning='distance over which friction builds up'),
    ),
    hook=Hook.SIGN,
    kernel=_presliding,
    keeps=_presliding,
    family='friction at reversals',
    confusable=('stribeck', 'backlash'),
    separated_by='reverse {drive} over strokes growing from 20 um to 2 mm',
)  # fmt: skip


@inlined
def _quadratic_drag(value: Any, drive: Any, p: Any) -> Any:
    return value + p[0] * drive.velocity * absolute(drive.velocity)


QUADRATIC_DRAG = Effect(
    id='quadratic_drag',
    about='Drag that grows with the square of speed.',
    title='quadratic drag',
    equation='Q v |v| added to friction',
    source='MuJoCo dcmotor note; nonlinear viscous friction',
    parameters=(EffectParameter('torque', 'effort s^2/m^2', 0.0, 0.5, 0.0, symbol='Q'),),
    hook=Hook.FRICTION,
    kernel=_quadratic_drag,
    family='speed-dependent friction',
    confusable=('viscous_friction', 'velocity_gain_error'),
    separated_by='run {drive} at five constant speeds over its whole range, both ways',
)


@inlined
def _quadratic_load_friction(value: Any, drive: Any, p: Any) -> Any:
    ratio = drive.velocity / p[2]
    load = drive.load / drive.gear
    # The weaker side is the one that is carried along; both have to press against each other.
    square = where(
        absolute(load) < absolute(drive.torque),
        p[1] * load * load,
        p[0] * drive.torque * drive.torque,
    )
    pressed = where(load * drive.torque > spread(0.0), square, spread(0.0))
    return value + pressed * exp(-ratio * ratio) * drive.direction


QUADRATIC_LOAD_FRICTION = Effect(
    id='quadratic_load_friction',
    about='Friction of a gear that grows with the square of what presses it, while it hardly '
    'turns.',
    title='quadratic load friction',
    equation='c_F F^2 where |F| < |M|, else c_M M^2, times exp(-(v/v_S)^2) sgn v, M against F',
    source='Duclusaud et al., ICRA 2025, model M6',
    parameters=(*pressing('1/(effort)', 1.0, 'c'), fading()),
    hook=Hook.FRICTION,
    kernel=_quadratic_load_friction,
    family='load friction',
    confusable=('stribeck_load_friction', 'directional_load_friction', 'stribeck'),
    separated_by='lift and lower three weights slowly with {drive}, the largest it can hold',
    needs=motor_torque,
)


@inlined
def _stribeck(value: Any, drive: Any, p: Any) -> Any:
    ratio = drive.velocity / p[1]
    return value + p[0] * exp(-ratio * ratio) * drive.direction


STRIBECK = Effect(
    id='stribeck',
    about='Stribeck friction: more friction near standstill than at speed.',
    title='Stribeck friction',
    equation='M_S exp(-(v/v_S)^2) sgn v added to friction',
    source='Armstrong-Helouvry et al., Automatica 30(7), 1994',
    parameters=(
        EffectParameter(
            'torque', 'effort', 0.0, 0.25, 0.0, symbol='M_S', meaning='friction added at rest'
        ),
        fading(),
    ),
    hook=Hook.FRICTION,
    kernel=_stribeck,
    family='friction at reversals',
    confusable=('presliding', 'backlash', 'coulomb_friction'),
    separated_by='creep {drive} both ways at 5 to 30 mm/s, with at least five speeds',
)


@inlined
def _stribeck_load_friction(value: Any, drive: Any, p: Any) -> Any:
    ratio = drive.velocity / p[2]
    pressed = absolute(p[0] * drive.torque + p[1] * drive.load / drive.gear)
    return value + pressed * exp(-ratio * ratio) * drive.direction


STRIBECK_LOAD_FRICTION = Effect(
    id='stribeck_load_friction',
    about='Friction of a loaded gear that falls off as it turns faster.',
    title='Stribeck load friction',
    equation='|mu_M M + mu_F F / gear| exp(-(v/v_S)^2) sgn v added to friction',
    source='Duclusaud et al., ICRA 2025, models M4 (mu_M = mu_F) and M5',
    parameters=(*pressing('1', 1.0, 'mu'), fading()),
    hook=Hook.FRICTION,
    kernel=_stribeck_load_friction,
    family='load friction',
    confusable=('directional_load_friction', 'load_dependent_friction', 'stribeck'),
    separated_by='lift and lower a weight with {drive} at five speeds, the slowest at creep',
    needs=motor_torque,
)
