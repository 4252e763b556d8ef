# SPDX-License-Identifier: Apache-2.0
"""Laws of friction: at reversals, at speed, under load, along the way and over time."""

from typing import Any

from ros2_ident.effects.effect import Effect, EffectParameter, fading, Hook, motor_torque, pressing
from ros2_ident.lanes import absolute, exp, inlined, spread, tanh, where


@inlined
def _asymmetric_friction(value: Any, drive: Any, p: Any) -> Any:
    return value + (p[0] + p[1] * absolute(drive.velocity)) * absolute(drive.direction)


@inlined
def _degressive_friction(value: Any, drive: Any, p: Any) -> Any:
    return value + p[0] * tanh(drive.velocity / p[1])


@inlined
def _directional_load_friction(value: Any, drive: Any, p: Any) -> Any:
    pressed = absolute(p[0] * drive.torque + p[1] * drive.load / drive.gear)
    return value + pressed * drive.direction


@inlined
def _friction_drift_factor(time: Any, warmth: Any, p: Any) -> Any:
    return (1.0 + p[0] * (1.0 - exp(-time / p[2]))) * exp(p[1] * warmth)


@inlined
def _friction_drift(value: Any, drive: Any, p: Any) -> Any:
    return value * _friction_drift_factor(drive.time, drive.memory, p)


@inlined
def _friction_drift_keeps(value: Any, drive: Any, p: Any) -> Any:
    friction = value * _friction_drift_factor(drive.time, drive.memory, p)
    power = absolute(friction * drive.velocity) * drive.gear
    return power + (drive.memory - power) * exp(-drive.elapsed / p[2])


@inlined
def _load_dependent_friction(value: Any, drive: Any, p: Any) -> Any:
    return value + p[0] * absolute(drive.load) / drive.gear * drive.direction


@inlined
def _position_dependent_friction(value: Any, drive: Any, p: Any) -> Any:
    return value + drive.coulomb * drive.direction * p[0] * (drive.position - p[1])


@inlined
def _presliding(value: Any, drive: Any, p: Any) -> Any:
    # Dahl's equation dh/dx = (1 - h sgn x')/delta has a closed form while the direction stays.
    end = where(drive.travel > spread(0.0), spread(1.0), spread(-1.0))
    return end + (drive.memory - end) * exp(-absolute(drive.travel) / p[0])


@inlined
def _quadratic_drag(value: Any, drive: Any, p: Any) -> Any:
    return value + p[0] * drive.velocity * absolute(drive.velocity)


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


@inlined
def _stribeck(value: Any, drive: Any, p: Any) -> Any:
    ratio = drive.velocity / p[1]
    return value + p[0] * exp(-ratio * ratio) * drive.direction


@inlined
def _stribeck_load_friction(value: Any, drive: Any, p: Any) -> Any:
    ratio = drive.velocity / p[2]
    pressed = absolute(p[0] * drive.torque + p[1] * drive.load / drive.gear)
    return value + pressed * exp(-ratio * ratio) * drive.direction


EFFECTS = (
    Effect(
        id='asymmetric_friction',
        about='Friction that differs between the two directions.',
        group='drive',
        title='asymmetric friction',
        equation='M_a + V_a |v| added to the friction torque in either direction, nothing at rest',
        source='Janot, Gautier, Brunot 2019; Elhami and Brookfield, Proc. IMechE C 210, 1996',
        parameters=(
            EffectParameter('coulomb', 'effort', -0.5, 0.5, 0.0, symbol='M_a',
                            meaning='half the difference in Coulomb friction'),
            EffectParameter('viscous', 'effort s/m', -5.0, 5.0, 0.0, symbol='V_a',
                            meaning='half the difference in viscous friction'),
        ),
        hook=Hook.FRICTION,
        kernel=_asymmetric_friction,
        place='drive',
        family='direction',
        confusable=('constant_force', 'effort_bias'),
        separated_by='mirror the motion of {drive}, at several speeds, and dwell at both ends',
    ),
    Effect(
        id='degressive_friction',
        about='Friction that rises with speed and levels off, as of a lubricant that thins.',
        group='drive',
        title='degressive friction',
        equation='M_D tanh(v/v_D) added to the friction torque, v_D well above the regularisation',
        source='Weigand, Ulmen, Janot, Ruskowski 2021, friction model of the KR 300',
        parameters=(
            EffectParameter('torque', 'effort', 0.0, 0.5, 0.0, symbol='M_D',
                            meaning='friction once it has levelled off'),
            EffectParameter('velocity', 'm/s', 0.01, 1.0, 0.1, starts=(0.03, 0.1, 0.3),
                            role='shape', symbol='v_D', meaning='speed at which it levels off'),
        ),
        hook=Hook.FRICTION,
        kernel=_degressive_friction,
        place='drive',
        family='speed-dependent friction',
        confusable=('quadratic_drag', 'viscous_friction', 'stribeck'),
        separated_by='run {drive} at five constant speeds over its whole range, both ways',
    ),
    Effect(
        id='directional_load_friction',
        about='Friction of a gear that motor and load press together, each by a share of its '
        'own.',
        group='drive',
        title='directional load friction',
        equation='|mu_M M + mu_F F / gear| sgn v added to the friction torque',
        source='Duclusaud, Passault, Padois, Ly, ICRA 2025, models M3 (mu_M = mu_F) and M5',
        parameters=pressing('1', 0.95, 'mu'),
        hook=Hook.FRICTION,
        kernel=_directional_load_friction,
        place='drive',
        family='load friction',
        confusable=('load_dependent_friction', 'coulomb_friction', 'stribeck_load_friction'),
        separated_by='lift and lower a weight slowly with {drive}, then another of half the size',
        needs=motor_torque,
    ),
    Effect(
        id='friction_drift',
        about='Friction that changes while the machine warms up.',
        group='drive',
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
        keeps=_friction_drift_keeps,
        place='drive',
        family='time',
        confusable=('stribeck',),
        separated_by='repeat one motion of {drive} at the start and after ten minutes',
    ),
    Effect(
        id='load_dependent_friction',
        about='Friction that grows with the force the gear carries.',
        group='drive',
        title='load-dependent friction',
        equation='mu |F| / gear sgn v added to the friction torque',
        source='Hamon, Gautier, Garrec, Janot, IROS 2010; Duclusaud et al., ICRA 2025, model M3',
        parameters=(EffectParameter('coefficient', '1', 0.0, 0.4, 0.0, symbol='mu'),),
        hook=Hook.FRICTION,
        kernel=_load_dependent_friction,
        place='drive',
        family='load friction',
        confusable=('coulomb_friction', 'asymmetric_friction'),
        separated_by='repeat the motion of {drive} with two payloads',
    ),
    Effect(
        id='position_dependent_friction',
        about='Dry friction that changes along the rail.',
        group='drive',
        title='position-dependent friction',
        equation='Coulomb torque times 1 + a (z - z_0) added',
        source='Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994',
        parameters=(
            EffectParameter('slope', '1/m', -10.0, 10.0, 0.0, symbol='a',
                            meaning='change per length'),
            EffectParameter('middle', 'm', -1.0, 2.0, 0.5, role='position', symbol='z_0',
                            meaning='position without change'),
        ),
        hook=Hook.FRICTION,
        kernel=_position_dependent_friction,
        place='drive',
        family='position',
        confusable=('cable_spring', 'load_dependent_friction'),
        separated_by='sweep {drive} slowly both ways over its whole stroke',
    ),
    Effect(
        id='presliding',
        about='Presliding: friction builds up over a way, as in a brush of bristles, not at '
        'once.',
        group='drive',
        title='presliding hysteresis',
        equation='friction direction h instead of sgn v: dh/dx = (1 - h sgn v)/delta',
        source='Dahl, A solid friction model, 1968',
        parameters=(
            EffectParameter('way', 'm', 2e-6, 2e-3, 2e-6, starts=(5e-5, 3e-4), symbol='delta',
                            meaning='distance over which friction builds up'),
        ),
        hook=Hook.SIGN,
        kernel=_presliding,
        keeps=_presliding,
        place='drive',
        family='friction at reversals',
        confusable=('stribeck', 'backlash'),
        separated_by='reverse {drive} over strokes growing from 20 um to 2 mm',
    ),
    Effect(
        id='quadratic_drag',
        about='Drag that grows with the square of speed.',
        group='drive',
        title='quadratic drag',
        equation='Q v |v| added to the friction torque',
        source='MuJoCo dcmotor note; nonlinear viscous friction',
        parameters=(
            EffectParameter('torque', 'effort s^2/m^2', 0.0, 5.0, 0.0, symbol='Q',
                            meaning='coefficient'),
        ),
        hook=Hook.FRICTION,
        kernel=_quadratic_drag,
        place='drive',
        family='speed-dependent friction',
        confusable=('viscous_friction', 'velocity_gain_error'),
        separated_by='run {drive} at five constant speeds over its whole range, both ways',
    ),
    Effect(
        id='quadratic_load_friction',
        about='Friction of a gear that grows with the square of what presses it, while it '
        'hardly turns.',
        group='drive',
        title='quadratic load friction',
        equation='c_F F^2 where |F| < |M|, else c_M M^2, times exp(-(v/v_S)^2) sgn v, M against F',
        source='Duclusaud, Passault, Padois, Ly, ICRA 2025, model M6',
        parameters=(*pressing('1/(effort)', 1.0, 'c'), fading()),
        hook=Hook.FRICTION,
        kernel=_quadratic_load_friction,
        place='drive',
        family='load friction',
        confusable=('stribeck_load_friction', 'directional_load_friction', 'stribeck'),
        separated_by='lift and lower three weights slowly with {drive}, the largest it can hold',
        needs=motor_torque,
    ),
    Effect(
        id='stribeck',
        about='Stribeck friction: more friction near standstill than at speed.',
        group='drive',
        title='Stribeck friction',
        equation='M_S exp(-(v/v_S)^2) sgn v added to the friction torque',
        source='Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994',
        parameters=(
            EffectParameter('torque', 'effort', 0.0, 0.25, 0.0, symbol='M_S',
                            meaning='friction added at rest'),
            fading((0.01, 0.03, 0.08)),
        ),
        hook=Hook.FRICTION,
        kernel=_stribeck,
        place='drive',
        family='friction at reversals',
        confusable=('presliding', 'backlash', 'coulomb_friction'),
        separated_by='creep {drive} both ways at 5 to 30 mm/s, with at least five speeds',
    ),
    Effect(
        id='stribeck_load_friction',
        about='Friction of a loaded gear that falls off as it turns faster.',
        group='drive',
        title='Stribeck load friction',
        equation='|mu_M M + mu_F F / gear| exp(-(v/v_S)^2) sgn v added to the friction torque',
        source='Duclusaud, Passault, Padois, Ly, ICRA 2025, models M4 (mu_M = mu_F) and M5',
        parameters=(*pressing('1', 1.0, 'mu'), fading()),
        hook=Hook.FRICTION,
        kernel=_stribeck_load_friction,
        place='drive',
        family='load friction',
        confusable=('directional_load_friction', 'load_dependent_friction', 'stribeck'),
        separated_by='lift and lower a weight with {drive} at five speeds, the slowest at creep',
        needs=motor_torque,
    ),
)  # fmt: skip
