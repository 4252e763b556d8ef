# SPDX-License-Identifier: Apache-2.0
"""Gears that give, and forces on what they move."""

from typing import Any

from ros2_ident.effects.effect import along_rail, Effect, EffectParameter, elastic_gear, Hook
from ros2_ident.lanes import cosine, inlined, maximum, minimum, sine, spread


@inlined
def _backlash(value: Any, drive: Any, p: Any) -> Any:
    x, slope = value
    half = 0.5 * p[0]
    return maximum(x - half, minimum(x + half, spread(0.0))), slope


BACKLASH = Effect(
    id='backlash',
    about='Play in the gear: no force while the teeth do not touch.',
    title='backlash',
    equation='gear force from the deflection less its part within +-b/2',
    source='Nordin and Gutman, Automatica 38(10), 2002',
    parameters=(
        EffectParameter(
            'gap', 'm', 0.0, 0.05, 0.0, starts=(7e-4, 3e-3, 0.02), symbol='b', meaning='whole play'
        ),
    ),
    hook=Hook.DEFLECTION,
    kernel=_backlash,
    family='gear play',
    confusable=('stribeck', 'presliding'),
    separated_by='reverse the load of {drive} without its motion: brake hard against gravity',
    needs=elastic_gear,
)


@inlined
def _position_dependent_stiffness(value: Any, drive: Any, p: Any) -> Any:
    return value * maximum(p[0] * (drive.carriage - p[1]) + 1.0, spread(0.05))


POSITION_DEPENDENT_STIFFNESS = Effect(
    id='position_dependent_stiffness',
    about='A belt whose stiffness changes along the rail.',
    title='position-dependent stiffness',
    equation='c_G (1 + a (s - s_0))',
    source='Ludwig and Gerstmayr 2011, eq. 11; belt length changes with position',
    parameters=(
        EffectParameter('slope', '1/m', -0.5, 0.5, 0.0, symbol='a'),
        along_rail('middle', 's_0', 'position without change'),
    ),
    hook=Hook.STIFFNESS,
    kernel=_position_dependent_stiffness,
    family='elasticity',
    confusable=('payload_change', 'frame_resonance'),
    separated_by='excite {drive} with the same chirp at three positions',
    needs=elastic_gear,
)


@inlined
def _transmission_eccentricity(value: Any, drive: Any, p: Any) -> Any:
    x, slope = value
    sin, cos = sine(drive.turn * drive.position), cosine(drive.turn * drive.position)
    return x + p[0] * sin + p[1] * cos, slope + drive.turn * (p[0] * cos - p[1] * sin)


TRANSMISSION_ECCENTRICITY = Effect(
    id='transmission_eccentricity',
    about='A pulley or pinion off centre: travel that wavers once a motor turn.',
    title='transmission eccentricity',
    equation='e = A sin(gear z) + B cos(gear z) added to the gear deflection; lever 1 + de/dz',
    source='Tuttle and Seering, IEEE T-RA 12(3), 1996',
    parameters=(
        EffectParameter('sine', 'm', -0.02, 0.02, 0.0, symbol='A'),
        EffectParameter('cosine', 'm', -0.02, 0.02, 0.0, symbol='B'),
    ),
    hook=Hook.DEFLECTION,
    kernel=_transmission_eccentricity,
    family='motor angle',
    confusable=('torque_ripple',),
    separated_by='turn {drive} at constant speeds that cross the resonance, both ways',
    needs=elastic_gear,
)


@inlined
def _cable_spring(value: Any, drive: Any, p: Any) -> Any:
    return value - p[0] * (drive.carriage - p[1])


CABLE_SPRING = Effect(
    id='cable_spring',
    about='A cable or hose that pulls as a spring.',
    title='cable spring',
    equation='-k (s - s_0) on the load side',
    source='Khatib/FloBaRoID catalogue of disturbance forces; Hooke',
    parameters=(
        # One that pushes away is none.
        EffectParameter('stiffness', 'force/m', 0.0, 1.0, 0.0, symbol='k'),
        along_rail('rest', 's_0', 'position without force', 'constant_force'),
    ),
    hook=Hook.CARRIAGE_FORCE,
    kernel=_cable_spring,
    family='position',
    confusable=('position_dependent_friction', 'rail_radius_error', 'rod_length_error'),
    separated_by='sweep {drive} slowly both ways over its whole stroke',
)


@inlined
def _constant_force(value: Any, drive: Any, p: Any) -> Any:
    return value - p[0]


CONSTANT_FORCE = Effect(
    id='constant_force',
    about='A constant force or torque on the load side, a weight or a spring far from rest.',
    title='constant force',
    equation='F on the load side, against the positive direction',
    source='Janot et al. 2019, offset',
    parameters=(
        EffectParameter(
            'force', 'force', -1.0, 1.0, 0.0, symbol='F', meaning='force, or torque of a joint'
        ),
    ),
    hook=Hook.CARRIAGE_FORCE,
    kernel=_constant_force,
    family='offset',
    confusable=('effort_bias', 'asymmetric_friction'),
    separated_by='no motion can: turn the axis over, or log the effort with the motor off',
    needs=lambda context: not {'constant_load', 'log_bias'} & context.identified,
    twins=('effort_bias',),
)


@inlined
def _end_stop(value: Any, drive: Any, p: Any) -> Any:
    below, above = p[1] - drive.carriage, drive.carriage - p[2]
    zero = spread(0.0)
    return value + p[0] * (maximum(below, zero) - maximum(above, zero))


def _end(name: str, symbol: str, *starts: float) -> EffectParameter:
    """Return a stop that is looked for from beyond one end of the motion to its middle."""
    far = starts[0]
    return EffectParameter(
        name, 'm', min(far, 0.5), max(far, 0.5), far, starts, 'position',
        limit='cable_spring', symbol=symbol, meaning=f'where the {name} stop begins',
    )  # fmt: skip


END_STOP = Effect(
    id='end_stop',
    about='An end stop that a drive runs into, at one end of its way or at both.',
    title='end stop',
    equation='k (max(0, s_1 - s) - max(0, s - s_2)) on the load side',
    source='Hooke; Gilardi and Sharf, Mechanism and Machine Theory 37(10), 2002',
    parameters=(
        # A drive's effort presses its stop in by its stroke over this, at the upper end by less
        # than shows beside an encoder's steps. By hand.
        EffectParameter('stiffness', 'force/m', 0.0, 1e4, 0.0, (10.0, 100.0, 1000.0), symbol='k'),
        _end('lower', 's_1', -0.25, 0.02, 0.2),
        _end('upper', 's_2', 1.25, 0.98, 0.8),
    ),
    hook=Hook.CARRIAGE_FORCE,
    kernel=_end_stop,
    family='position',
    confusable=('cable_spring', 'torque_saturation', 'position_dependent_friction'),
    separated_by='move {drive} over the middle of its way only, then a little into either stop',
    bent=True,
)
