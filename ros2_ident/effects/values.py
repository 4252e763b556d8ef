# SPDX-License-Identifier: Apache-2.0
"""Effects that change a number which the step or the log has anyway: a row each."""

from collections.abc import Callable

from ros2_ident.effects.effect import (
    closed_loop,
    Context,
    Effect,
    EffectParameter,
    platform,
    turns,
)


def _moment(axis: str) -> EffectParameter:
    name = f'moment_{axis}'
    return EffectParameter(
        name, 'load m', -1.0, 1.0, 0.0, target=f'hand_{name}', symbol=f'm_L {axis}',
        meaning=f'mass times {axis}',
    )  # fmt: skip


def _gain_error(
    gain: str, symbol: str, low: float, high: float, viscous: tuple[str, ...] = (),
    needs: Callable[[Context], bool] = closed_loop,
) -> Effect:  # fmt: skip
    """Return the effect of a gain that differs from the machine file's."""
    others = (x for x in ('velocity', 'position', 'integral') if x != gain)
    return Effect(
        id=f'{gain}_gain_error',
        group='controller',
        about=f"The {gain} gain differs from the machine file's.",
        title=f'{gain}-gain error',
        equation=f'{symbol} times g',
        source='controller law against log',
        parameters=(
            EffectParameter(
                'factor', '1', low, high, 1.0, target=f'{gain}_gain', how='scale', symbol='g'
            ),
        ),
        family='loop gains',
        confusable=(*(f'{other}_gain_error' for other in others), *viscous),
        separated_by='compare the logged effort of {drive} with the law: no motion needed',
        needs=needs,
    )


def _length_error(part: str, length: str, other: str) -> Effect:
    """Return the effect of a length of the rods or rails that differs from the machine file's."""
    return Effect(
        id=f'{part}_{length}_error',
        group='structure',
        about=f"The {part}s' {length} differs from the machine file's.",
        title=f'{part}-{length} error',
        equation=f'{part} {length} plus d',
        source='kinematic calibration',
        parameters=(
            EffectParameter('error', 'm', -0.05, 0.05, 0.0, target=f'{part}_{length}', symbol='d'),
        ),
        place='all',
        family='geometry',
        confusable=(other, 'cable_spring', 'rod_mass'),
        separated_by='hold still at many places of the workspace',
        needs=platform,
    )


EFFECTS = (
    Effect(
        id='command_delay',
        group='controller',
        about='The set-point reaches the controller late.',
        title='command delay',
        equation='z_cmd(t - T)',
        source='Ludwig and Gerstmayr 2011; PACE delay model',
        parameters=(
            EffectParameter('delay', 's', 0.0, 0.03, 0.0, target='set_point_delay',
                            starts=(3e-3,), symbol='T'),
        ),
        family='loop timing',
        confusable=('current_loop_lag', 'effort_delay'),
        separated_by='compare set-point and measured position of {drive} in a chirp',
        needs=closed_loop,
        shown_by='late_set_point',
    ),
    Effect(
        id='coulomb_friction',
        about='Coulomb friction, where the nominal model has none.',
        title='Coulomb friction',
        equation='M_C sgn v',
        source='Armstrong-Helouvry et al., Automatica 30(7), 1994',
        parameters=(
            EffectParameter('torque', 'effort', 0.0, 1.0, 0.0, target='coulomb', symbol='M_C'),
        ),
        family='dry friction',
        confusable=('stribeck', 'presliding'),
        separated_by='move {drive} both ways at three speeds or more, with equal dwell',
    ),
    Effect(
        id='effort_bias',
        group='measurement',
        about='The logged effort is off by a constant.',
        title='effort bias',
        equation='logged effort plus b',
        source='offset of a current sensor',
        parameters=(
            EffectParameter('bias', 'effort', -0.5, 0.5, 0.0, target='log_bias', symbol='b'),
        ),
        family='offset',
        confusable=('constant_force', 'asymmetric_friction'),
        separated_by='no motion can: turn the axis over, or log the effort with the motor off',
        twins=('constant_force',),
        needs=lambda context: 'constant_load' not in context.identified,
    ),
    Effect(
        id='effort_crosstalk',
        group='measurement',
        about='The effort of the other drives leaks into the logged one.',
        title='effort cross-talk',
        equation='logged effort plus c times the sum of the others',
        source='shared supply or shunt',
        parameters=(
            EffectParameter('coefficient', '1', -0.3, 0.3, 0.0, target='log_crosstalk',
                            symbol='c'),
        ),
        family='coupling',
        confusable=('payload_change', 'rod_mass'),
        separated_by='move the other drives while {drive} rests',
        needs=lambda context: context.drives > 1,
    ),
    Effect(
        id='effort_delay',
        group='measurement',
        about='The effort is logged late.',
        title='effort delay',
        equation='M_log(t) = M(t - T)',
        source='Ludwig and Gerstmayr 2011, section 4',
        parameters=(
            EffectParameter('delay', 's', 0.0, 0.05, 0.0, target='log_delay', starts=(2e-3,),
                            symbol='T'),
        ),
        family='log timing',
        confusable=('effort_filter', 'current_loop_lag'),
        separated_by='excite {drive} with a chirp: a delay turns the phase linearly',
    ),
    Effect(
        id='effort_filter',
        group='measurement',
        about='The effort is low-pass filtered before it is logged.',
        title='effort filter',
        equation="tau M_log' = M - M_log",
        source='first-order low-pass',
        parameters=(
            EffectParameter('time_constant', 's', 0.0, 0.02, 0.0, target='log_lag',
                            starts=(2e-3,), symbol='tau'),
        ),
        family='log timing',
        confusable=('effort_delay', 'current_loop_lag'),
        separated_by='excite {drive} with a chirp: a filter loses gain',
    ),
    Effect(
        id='effort_smoothing',
        group='measurement',
        about='The efforts were smoothed before they came into the log.',
        title='smoothed effort',
        equation='M_log = M through a Butterworth low-pass of order 2 and 1/T, forwards and '
        'backwards',
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
    ),
    Effect(
        id='frame_resonance',
        group='structure',
        about='The frame swings on its feet.',
        title='frame resonance',
        equation=(
            "(1/q) (u'' + 2 zeta omega u' + omega^2 u) = - vertical force of the machine; "
            'omega = 2 pi f'
        ),
        source='structural dynamics, one mode',
        parameters=(
            EffectParameter('inverse_mass', '1/kg', 0.0, 0.2, 0.0, target='frame_inverse_mass',
                            symbol='q', meaning="inverse of the frame's modal mass"),
            EffectParameter('frequency', 'Hz', 3.0, 80.0, 20.0, target='frame_frequency',
                            how='set', role='shape', symbol='f',
                            starts=(6.0, 9.0, 13.0, 18.0, 25.0, 35.0, 50.0)),
            EffectParameter('damping', '1', 0.005, 0.3, 0.05, target='frame_damping', how='set',
                            role='shape', symbol='zeta'),
        ),
        place='all',
        family='elasticity',
        confusable=('position_dependent_stiffness',),
        separated_by='strike the frame at rest; clamp it and repeat the motion',
        needs=platform,
    ),
    Effect(
        id='gear_flexibility',
        about='A gear, screw or belt that gives, where the nominal model moves motor and load as '
        'one mass.',
        title='gear flexibility',
        equation='a share of the moved mass hangs on a spring-damper behind the motor',
        source='Spong, J. Dyn. Syst. Meas. Control 109(4), 1987',
        parameters=(
            EffectParameter('share', '1', 0.0, 0.95, 0.0, target='load_share',
                            meaning='share of the mass behind the spring'),
            EffectParameter('frequency', 'Hz', 3.0, 150.0, 30.0,
                            starts=(8.0, 13.0, 20.0, 30.0, 45.0, 70.0), role='shape',
                            target='load_frequency', how='set',
                            meaning='frequency with the motor held'),
            EffectParameter('damping', '1', 0.001, 1.0, 0.05, role='shape', target='load_damping',
                            how='set', meaning='damping ratio'),
        ),
        family='elasticity',
        confusable=('current_loop_lag', 'command_delay'),
        separated_by='excite {drive} with a chirp to three times the resonance, with two payloads',
        # What hangs behind a flexible gear would carry the weight alone.
        needs=lambda context: not context.elastic and not context.lifted,
    ),
    Effect(
        id='hand_load',
        group='structure',
        about='A load that an arm carries and its description does not know of.',
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
        needs=lambda context: 'links' in context.features,
    ),
    Effect(
        id='joint_zero_error',
        group='measurement',
        about="A joint's position is 0 in the log elsewhere than in the description.",
        title='joint zero',
        equation='logged position less q_0; along a recorded motion to first order',
        source='kinematic calibration',
        parameters=(
            # Of the stroke. By hand: beyond it a recorded motion's is no longer of first order.
            EffectParameter('zero', 'm', -0.1, 0.1, 0.0, target='log_zero', symbol='q_0',
                            meaning="the log's position where the joint's is 0"),
        ),
        family='position',
        confusable=('cable_spring', 'constant_force', 'torque_ripple'),
        separated_by='move {drive} to a mark whose position is known, or its end stop',
        needs=lambda context: 'links' in context.features,
    ),
    _gain_error('integral', 'k_I', 0.1, 5.0, needs=lambda x: x.closed_loop and x.integral),
    Effect(
        id='payload_change',
        group='structure',
        about='A tool that changes its mass during the log.',
        title='payload change',
        equation='m_t plus dm from t_0 to t_0 + T',
        source='gripping and dropping',
        parameters=(
            EffectParameter('mass', 'kg', -1.0, 1.0, 0.0, target='payload_step', symbol='dm'),
            EffectParameter('time', 's', 0.0, 3600.0, 0.0, role='time', target='payload_time',
                            symbol='t_0', meaning='when it is taken up'),
            EffectParameter('duration', 's', 0.05, 3600.0, 3600.0, starts=(1.0, 2.5, 3600.0),
                            role='shape', target='payload_duration', how='set', symbol='T',
                            meaning='how long it is carried'),
        ),
        place='all',
        family='mass',
        confusable=('rod_mass', 'torque_constant_error'),
        separated_by='hold still before and after the change of payload',
        needs=platform,
    ),
    Effect(
        id='payload_turns',
        group='structure',
        about='A load taken up and put down repeatedly, at instants found in the log.',
        title='payload taken up and put down',
        equation='m_t plus dm whenever the log shows a load',
        source='pick and place',
        parameters=(
            EffectParameter('mass', 'kg', -1.0, 1.0, 0.0, target='payload_turned', symbol='dm'),
        ),
        place='all',
        family='mass',
        confusable=('payload_change', 'rod_mass', 'torque_constant_error'),
        separated_by='hold still before and after each change of payload',
        needs=turns,
        shown_by='load',
        variant_of='payload_change',
    ),
    _gain_error('position', 'k_p', 0.3, 3.0),
    _length_error('rail', 'radius', 'rod_length_error'),
    _length_error('rod', 'length', 'rail_radius_error'),
    Effect(
        id='rod_mass',
        group='structure',
        about='Rods with a mass of their own.',
        title='rod mass',
        equation='half of each rod at the carriage, half at the platform',
        source='Codourey, IJRR 17(12), 1998',
        parameters=(EffectParameter('mass', 'kg', 0.0, 0.5, 0.0, target='mass_per_rod'),),
        place='all',
        family='mass',
        confusable=('payload_change', 'torque_constant_error'),
        separated_by='make the same acceleration at the rim and in the middle of the workspace',
        needs=platform,
    ),
    Effect(
        id='torque_saturation',
        group='controller',
        about='The drive cannot make the torque its controller may ask for.',
        title='torque saturation',
        equation='commanded torque clipped at a share of its limit',
        source='Rhoban BAM; MuJoCo dcmotor note',
        parameters=(
            EffectParameter('share', '1', 0.02, 1.0, 1.0, target='torque_limit', how='scale',
                            starts=(0.04, 0.06, 0.09, 0.13, 0.2, 0.3, 0.45),
                            meaning='share of the torque limit'),
        ),
        family='saturation',
        confusable=('current_loop_lag',),
        separated_by='accelerate {drive} harder, until the torque has flat tops',
        needs=closed_loop,
        shown_by='flat_top',
    ),
    _gain_error('velocity', 'k_v', 0.3, 3.0, ('viscous_friction',)),
    Effect(
        id='viscous_friction',
        about='Viscous friction, where the nominal model has none.',
        title='viscous friction',
        equation='M_V v',
        source='Armstrong-Helouvry et al., Automatica 30(7), 1994',
        parameters=(
            EffectParameter('torque', 'effort s/m', 0.0, 1.0, 0.0, target='viscous', symbol='M_V'),
        ),
        family='speed-dependent friction',
        confusable=('quadratic_drag', 'velocity_gain_error'),
        separated_by='run {drive} at five constant speeds over its whole range, both ways',
    ),
)  # fmt: skip
