# SPDX-License-Identifier: Apache-2.0
"""Laws of motor, gear and carriage, but friction: forces, and where a gear gives."""

from typing import Any

from ros2_ident.effects.effect import Effect, EffectParameter, elastic_gear, Hook
from ros2_ident.lanes import cosine, inlined, maximum, minimum, sine, spread


@inlined
def _backlash(value: Any, drive: Any, p: Any) -> Any:
    x, slope = value
    half = 0.5 * p[0]
    return maximum(x - half, minimum(x + half, spread(0.0))), slope


@inlined
def _cable_spring(value: Any, drive: Any, p: Any) -> Any:
    return value - p[0] * (drive.carriage - p[1])


@inlined
def _constant_force(value: Any, drive: Any, p: Any) -> Any:
    return value - p[0]


@inlined
def _position_dependent_stiffness(value: Any, drive: Any, p: Any) -> Any:
    return value * maximum(p[0] * (drive.carriage - p[1]) + 1.0, spread(0.05))


@inlined
def _torque_ripple(value: Any, drive: Any, p: Any) -> Any:
    angle = p[2] * drive.turn * drive.position
    return value + p[0] * sine(angle) + p[1] * cosine(angle)


@inlined
def _transmission_eccentricity(value: Any, drive: Any, p: Any) -> Any:
    x, slope = value
    sin, cos = sine(drive.turn * drive.position), cosine(drive.turn * drive.position)
    return x + p[0] * sin + p[1] * cos, slope + drive.turn * (p[0] * cos - p[1] * sin)


EFFECTS = (
    Effect(
        id='backlash',
        about='Play in the gear: no force while the teeth do not touch.',
        group='drive',
        title='backlash',
        equation='gear force from the deflection less its part within +-b/2',
        source='Nordin and Gutman, Automatica 38(10), 2002',
        parameters=(
            EffectParameter('gap', 'm', 0.0, 2e-3, 0.0, starts=(1e-4, 5e-4), symbol='b',
                            meaning='whole play'),
        ),
        hook=Hook.DEFLECTION,
        kernel=_backlash,
        place='drive',
        family='gear play',
        confusable=('stribeck', 'presliding'),
        separated_by='reverse the load of {drive} without its motion: brake hard against gravity',
        needs=elastic_gear,
    ),
    Effect(
        id='cable_spring',
        about='A cable or hose that pulls as a spring.',
        group='drive',
        title='cable spring',
        equation='-k (s - s_0) on the load side',
        source='Khatib/FloBaRoID catalogue of disturbance forces; Hooke',
        parameters=(
            EffectParameter('stiffness', 'N/m', -300.0, 300.0, 0.0, symbol='k'),
            EffectParameter('rest', 'm', -1.0, 2.0, 0.5, role='position', symbol='s_0',
                            meaning='position without force'),
        ),
        hook=Hook.CARRIAGE_FORCE,
        kernel=_cable_spring,
        place='drive',
        family='position',
        confusable=('position_dependent_friction', 'rail_radius_error', 'rod_length_error'),
        separated_by='sweep {drive} slowly both ways over its whole stroke',
    ),
    Effect(
        id='constant_force',
        about='A constant force or torque on the load side, a weight or a spring far from rest.',
        group='drive',
        title='constant force',
        equation='F on the load side, against the positive direction',
        source='Janot, Gautier, Brunot 2019, offset',
        parameters=(
            EffectParameter('force', 'N', -30.0, 30.0, 0.0, symbol='F',
                            meaning='force, or torque of a joint'),
        ),
        hook=Hook.CARRIAGE_FORCE,
        kernel=_constant_force,
        place='drive',
        family='offset',
        confusable=('effort_bias', 'asymmetric_friction'),
        separated_by='no motion can: turn the axis over, or log the effort with the motor off',
        needs=lambda context: not {'constant_load', 'log_bias'} & context.identified,
        twins=('effort_bias',),
    ),
    Effect(
        id='position_dependent_stiffness',
        about='A belt whose stiffness changes along the rail.',
        group='drive',
        title='position-dependent stiffness',
        equation='c_G (1 + a (s - s_0))',
        source='Ludwig and Gerstmayr 2011, eq. 11; belt length changes with position',
        parameters=(
            EffectParameter('slope', '1/m', -3.0, 3.0, 0.0, symbol='a',
                            meaning='change per length'),
            EffectParameter('middle', 'm', -1.0, 2.0, 0.5, role='position', symbol='s_0',
                            meaning='position without change'),
        ),
        hook=Hook.STIFFNESS,
        kernel=_position_dependent_stiffness,
        place='drive',
        family='elasticity',
        confusable=('payload_change', 'frame_resonance'),
        separated_by='excite {drive} with the same chirp at three positions',
        needs=elastic_gear,
    ),
    Effect(
        id='torque_ripple',
        about='Torque that ripples with the motor angle: cogging.',
        group='drive',
        title='torque ripple',
        equation='A sin(n gear z) + B cos(n gear z) added to the motor torque',
        source='Holtz and Springob, IEEE TIE 43(2), 1996',
        parameters=(
            EffectParameter('sine', 'effort', -0.25, 0.25, 0.0, symbol='A', meaning='sine part'),
            EffectParameter('cosine', 'effort', -0.25, 0.25, 0.0, symbol='B',
                            meaning='cosine part'),
            EffectParameter('order', '1', 0.5, 24.5, 1.0,
                            starts=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 10.0, 12.0, 14.0, 16.0,
                                    18.0, 20.0, 24.0),
                            role='order', symbol='n', meaning='periods per motor turn'),
        ),
        hook=Hook.TORQUE,
        kernel=_torque_ripple,
        place='drive',
        family='motor angle',
        confusable=('transmission_eccentricity',),
        separated_by='turn {drive} slowly at constant speed over many motor turns',
    ),
    Effect(
        id='transmission_eccentricity',
        about='A pulley or pinion off centre: travel that wavers once a motor turn.',
        group='drive',
        title='transmission eccentricity',
        equation='e = A sin(gear z) + B cos(gear z) added to the gear deflection; lever 1 + de/dz',
        source='Tuttle and Seering, IEEE T-RA 12(3), 1996',
        parameters=(
            EffectParameter('sine', 'm', -2e-3, 2e-3, 0.0, symbol='A', meaning='sine part'),
            EffectParameter('cosine', 'm', -2e-3, 2e-3, 0.0, symbol='B', meaning='cosine part'),
        ),
        hook=Hook.DEFLECTION,
        kernel=_transmission_eccentricity,
        place='drive',
        family='motor angle',
        confusable=('torque_ripple',),
        separated_by='turn {drive} at constant speeds that cross the resonance, both ways',
        needs=elastic_gear,
    ),
)  # fmt: skip
