# SPDX-License-Identifier: Apache-2.0
"""The effects of the catalogue as the reference simulates them, in the catalogue's form and in another.

Symbols: z motor, v its speed, s carriage, F gear force, M torque, sigma(v) the regularised sign.
"""

from collections.abc import Mapping

import numpy as np

from ros2_ident.reference import layout as at
from ros2_ident.reference.effects import column_writer, Kind, Quantity, set_columns
from ros2_ident.reference.plant import Array, Plant

Values = Mapping[str, float]
PHASE = Quantity('phase', 'rad', 0.0, 2.0 * np.pi)


def _coulomb(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    set_columns(
        plant, i, {at.EXTRA_COULOMB: values['torque'], at.EXTRA_COULOMB_FORM: float(other)}
    )


def _viscous(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    exponent = 0.85 if other else 1.0
    set_columns(plant, i, {at.EXTRA_VISCOUS: values['slope'], at.EXTRA_VISCOUS_EXPONENT: exponent})


def _stribeck(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    set_columns(
        plant,
        i,
        {
            at.STRIBECK_TORQUE: values['torque'],
            at.STRIBECK_SPEED: values['speed'],
            at.STRIBECK_FORM: float(other),
        },
    )


def _load(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    set_columns(plant, i, {at.LOAD_FRICTION: values['share'], at.LOAD_FRICTION_FORM: float(other)})


def _asymmetry(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    width = 0.03 if other else 0.0
    set_columns(plant, i, {at.ASYMMETRY: values['share'], at.ASYMMETRY_WIDTH: width})


def _presliding(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    form = values['kind'] if other else 0.0
    columns = {at.PRESLIDE_LENGTH: values['length'], at.PRESLIDE_FORM: form}
    set_columns(plant, i, columns, internal=True)


def _drag(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    set_columns(plant, i, {at.DRAG: values['slope'], at.DRAG_EXPONENT: 1.75 if other else 2.0})


def _backlash(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    set_columns(plant, i, {at.BACKLASH: values['width'], at.BACKLASH_FORM: float(other)})


def _ripple(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    set_columns(
        plant,
        i,
        {
            at.RIPPLE_TORQUE: values['torque'],
            at.RIPPLE_ORDER: values['order'],
            at.RIPPLE_PHASE: values['phase'],
            at.RIPPLE_SECOND: 0.3 * other,
            at.RIPPLE_THIRD: 0.15 * other,
            at.RIPPLE_CURRENT: 0.1
            * values['torque']
            / plant.drive[i, at.TORQUE_LIMIT]
            * 6.0
            * other,
        },
    )


def _eccentricity(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    set_columns(
        plant,
        i,
        {
            at.ECCENTRICITY: values['amplitude'],
            at.ECCENTRICITY_PHASE: values['phase'],
            at.ECCENTRICITY_SECOND: 0.25 * other,
        },
    )


def _torque_constant(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    if other:
        # The motor makes more of a current than its data sheet says; the log keeps the data sheet's torque.
        plant.drive[i, at.ACTUATOR_GAIN] = -values['share']
        return

    def scaled(torque: Array, cycle: float) -> Array:
        out = torque.copy()
        out[i] *= 1.0 + values['share']
        return out

    plant.effort_filters.append(scaled)


def _saturation(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    set_columns(plant, i, {at.TORQUE_LIMIT: values['limit'], at.TORQUE_KNEE: 12.0 * other})


def _current_lag(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    columns = {at.CURRENT_LAG: values['time'], at.CURRENT_LAG_FORM: float(other)}
    set_columns(plant, i, columns, internal=True)


def _cable(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    stiffness = values['stiffness']
    columns = {at.CABLE_STIFFNESS: stiffness, at.CABLE_PLACE: values['place']}
    if other:
        columns |= {
            at.CABLE_CUBIC: 40.0,
            at.CABLE_HYSTERESIS: 0.008 * stiffness,
            at.CABLE_LENGTH: 0.01,
        }
    set_columns(plant, i, columns, internal=other)


def _constant(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    plant.drive[i, at.CONSTANT_FORCE] += values['force']
    if other:
        # A spring balancer pulls almost evenly: a tenth less force per metre of its stroke.
        plant.drive[i, at.CONSTANT_SLOPE] += -0.1 * values['force']


def _bias(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    def biased(torque: Array, cycle: float) -> Array:
        out = torque.copy()
        time = np.arange(torque.shape[1]) * cycle
        out[i] += values['torque'] * (1.0 + (0.1 * np.sin(0.4 * time) if other else 0.0))
        return out

    plant.effort_filters.append(biased)


def _drift(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    if not other:
        set_columns(plant, i, {at.DRIFT_RATE: -values['share'] / 10.0})
        return
    power = 0.4 * plant.drive[i, at.TORQUE_LIMIT] * plant.drive[i, at.GEAR] / (6.0 * 25.0 * np.pi)
    columns = {
        at.DRIFT_SHARE: -values['share'],
        at.DRIFT_TIME: values['time'],
        at.DRIFT_POWER: power * 6.0,
    }
    set_columns(plant, i, columns, internal=True)


def _velocity_gain(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    plant.drive[i, at.VELOCITY_GAIN] *= 1.0 + values['share']
    if other:
        # A controller that is set by gain and reset time keeps the integral gain in step, partly.
        plant.drive[i, at.INTEGRAL_GAIN] *= 1.0 + 0.3 * values['share']


def _position_gain(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    plant.drive[i, at.POSITION_GAIN] *= 1.0 + values['share']


def _command_delay(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    def delayed(target: Array, speed: Array, cycle: float) -> tuple[Array, Array]:
        instants = np.arange(target.shape[1]) * cycle
        when = instants - values['time']
        if other:
            # Set-points arrive as frames of a millisecond: whole frames late, now and then one more.
            frame = 2 * max(1, round(0.5e-3 / cycle)) * cycle
            late = np.random.default_rng(seed).random(instants.size) < 0.1
            when = np.floor((when - frame * late) / cycle + 0.5) * cycle
        out, out_speed = target.copy(), speed.copy()
        out[i] = np.interp(when, instants, target[i])
        out_speed[i] = np.interp(when, instants, speed[i], left=0.0)
        return out, out_speed

    plant.command_filters.append(delayed)


def _stiffness(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    columns = {
        at.STIFFNESS_SLOPE: values['slope'],
        at.STIFFNESS_PLACE: values['place'],
        at.STIFFNESS_FORM: float(other),
    }
    set_columns(plant, i, columns)


def _quantisation(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    set_columns(plant, i, {at.ENCODER_STEP: values['step'], at.ENCODER_VELOCITY: 2e-3 * other})


def _frame(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    mass = values['mass']
    rate = 2.0 * np.pi * values['frequency']
    damping = 2.0 * values['damping'] * mass * rate
    plant.shared[at.FRAME_MASS] = mass
    plant.shared[at.FRAME_STIFFNESS] = mass * rate**2
    plant.shared[at.FRAME_DAMPING] = damping * (0.5 if other else 1.0)
    # Joints damp with the square of the speed: as strong as the linear part at 4 mm/s.
    plant.shared[at.FRAME_QUADRATIC] = 0.5 * damping / 4e-3 * other


def _payload(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    plant.shared[at.PAYLOAD] = values['mass']
    plant.shared[at.PAYLOAD_FROM] = values['time']
    plant.shared[at.PAYLOAD_UNTIL] = values['time'] + (2.5 if other else 1e6)
    plant.shared[at.PAYLOAD_RAMP] = 0.12 if other else 1e-3


def _rods(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    # Other: half the mass in a uniform tube, a quarter in the joint at each end.
    plant.shared[at.ROD_MASS] = values['mass']
    plant.shared[at.ROD_AT_CARRIAGE] = 0.5 / 3.0 + 0.25 if other else 1.0 / 3.0
    plant.shared[at.ROD_BETWEEN] = 0.5 / 6.0 if other else 1.0 / 6.0
    plant.shared[at.ROD_AT_PLATFORM] = 0.5 / 3.0 + 0.25 if other else 1.0 / 3.0
    plant.shared[at.ROD_CENTRE] = 0.5


def _radius(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    uneven = np.array([0.85, 1.05, 1.1]) if other else np.ones(3)
    radius = np.hypot(plant.drive[:, at.RAIL_X], plant.drive[:, at.RAIL_Y])
    plant.drive[:, at.RAIL_X] *= 1.0 + values['length'] * uneven / radius
    plant.drive[:, at.RAIL_Y] *= 1.0 + values['length'] * uneven / radius


def _rod_length(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    uneven = np.array([1.1, 0.85, 1.05]) if other else np.ones(3)
    plant.drive[:, at.ROD_LENGTH] += values['length'] * uneven


def _crosstalk(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    def mixed(torque: Array, cycle: float) -> Array:
        others = [j for j in range(torque.shape[0]) if j != i]
        weights = (
            np.linspace(1.3, 0.7, len(others))
            if other and len(others) > 1
            else np.ones(len(others))
        )
        leak = weights @ torque[others]
        if other:
            share = 1.0 - np.exp(-cycle / 1.5e-3)
            slow = np.empty_like(leak)
            level = leak[0]
            for k, now in enumerate(leak):
                level += share * (now - level)
                slow[k] = level
            leak = slow
        out = torque.copy()
        out[i] += values['share'] * leak
        return out

    plant.effort_filters.append(mixed)


def _sign(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    set_columns(plant, i, {at.SIGN_FORM: 1.0, at.SIGN_WIDTH: values['width']})


def _share(low: float, high: float) -> Quantity:
    return Quantity('share', '1', low, high, signed=True)


KINDS = (
    Kind('coulomb_friction', 'drive', Quantity('torque', 'N m', 0.008, 0.12), (),
         'torque tanh(v / width)', '2/pi torque arctan(pi v / (2 width))', _coulomb),
    Kind('viscous_friction', 'drive', Quantity('slope', 'N m s/m', 0.02, 0.25), (),
         'slope v', 'slope |v|^0.85 sgn(v)', _viscous),
    Kind('stribeck', 'drive', Quantity('torque', 'N m', 0.01, 0.15), (Quantity('speed', 'm/s', 0.012, 0.06),),
         'torque exp(-(v / speed)^2) sigma(v)', 'torque / (1 + (v / speed)^2) sigma(v)', _stribeck),
    Kind('load_dependent_friction', 'drive', Quantity('share', '1', 0.01, 0.15), (),
         'share |F / gear| sigma(v)', 'share |F / gear + M| / 2 sigma(v)', _load, needs='gear'),
    Kind('asymmetric_friction', 'drive', _share(0.04, 0.7), (),
         'friction (1 + share sigma(v))', 'friction (1 + share 2/pi arctan(pi v / 0.06 m/s))', _asymmetry),
    Kind('presliding', 'drive', Quantity('length', 'm', 2e-5, 5e-4), (Quantity('kind', '1', choices=(1.0, 2.0)),),
         "Dahl: M_C a, a' = (v - |v| a) / length",
         "LuGre: M_C (a + 1 ms exp(-(v / 10 mm/s)^2) a'), or three parallel elements of 0.3, 1 and 3 length "
         'with weights 0.4, 0.35 and 0.25', _presliding),
    Kind('quadratic_drag', 'drive', Quantity('slope', 'N m s^2/m^2', 0.02, 0.3), (),
         'slope |v| v', 'slope |v|^1.75 sgn(v)', _drag),
    Kind('backlash', 'drive', Quantity('width', 'm', 2e-5, 6e-4), (),
         "F = c (|z - s| - width/2) + d (z' - s') outside the gap, pushing only",
         'soft flanks: stiffness up to 1.5 c with depth, damping grown over 20 um, 0.4 of it on the lower flank',
         _backlash, needs='gear'),
    Kind('torque_ripple', 'drive', Quantity('torque', 'N m', 0.008, 0.12),
         (Quantity('order', '1', choices=(1.0, 2.0, 4.0, 6.0)), PHASE),
         'torque sin(order gear z + phase)',
         'with 0.3 of the second and 0.15 of the third harmonic, and a part proportional to the torque', _ripple),
    Kind('transmission_eccentricity', 'drive', Quantity('amplitude', 'm', 2e-5, 5e-4), (PHASE,),
         'gear stretch + amplitude sin(gear z + phase), lever by virtual work',
         'with 0.25 of the second harmonic', _eccentricity, needs='gear'),
    Kind('torque_constant_error', 'drive', _share(0.01, 0.12), (),
         'logged torque (1 + share)', 'torque on the rotor (1 - share), log as commanded', _torque_constant),
    Kind('torque_saturation', 'drive', Quantity('limit', 'N m', 2.0, 0.5), (),
         'clip(M, +-limit)', 'M / (1 + |M / limit|^12)^(1/12)', _saturation),
    Kind('current_loop_lag', 'drive', Quantity('time', 's', 2e-4, 4e-3), (),
         "tau' = (M - tau) / time", 'two lags of time / 2 in a row', _current_lag),
    Kind('cable_spring', 'drive', Quantity('stiffness', 'N/m', 4.0, 150.0), (Quantity('place', 'm', 0.42, 0.53),),
         '-stiffness (s - place)',
         "-stiffness (x + 40/m^2 x^3) - 8 mm stiffness h, h' = (s' - |s'| h) / 10 mm", _cable),
    Kind('constant_force', 'drive', Quantity('force', 'N', 0.4, 12.0, signed=True), (),
         'load of `force` against the positive direction', 'load falling by a tenth per metre', _constant),
    Kind('effort_bias', 'measurement', Quantity('torque', 'N m', 0.005, 0.12, signed=True), (),
         'logged torque + torque', 'logged torque + torque (1 + 0.1 sin(0.4 t))', _bias),
    Kind('friction_drift', 'drive', Quantity('share', '1', 0.05, 0.6), (Quantity('time', 's', 3.0, 8.0),),
         'friction (1 - share t / 10 s)', "friction (1 - share w), w' = (power / rated - w) / time", _drift),
    Kind('velocity_gain_error', 'controller', _share(0.02, 0.4), (),
         'k_v (1 + share)', 'k_v (1 + share), k_I (1 + 0.3 share)', _velocity_gain),
    Kind('position_gain_error', 'controller', _share(0.02, 0.4), (),
         'k_p (1 + share)', 'k_p (1 + share)', _position_gain),
    Kind('command_delay', 'controller', Quantity('time', 's', 3e-4, 6e-3), (),
         'set-point of t - time', 'whole cycles late, one frame of 1 ms more in a tenth of the cycles',
         _command_delay),
    Kind('position_dependent_stiffness', 'drive', Quantity('slope', '1/m', 0.5, 6.0, signed=True),
         (Quantity('place', 'm', 0.44, 0.50),),
         'c (1 + slope (s - place))', 'c / (1 - slope (s - place))', _stiffness, needs='gear'),
    Kind('encoder_quantisation', 'controller', Quantity('step', 'm', 3e-6, 1e-4), (),
         'controller sees z rounded to step', 'and its speed from the rounded z through a lag of 2 ms',
         _quantisation),
    Kind('frame_resonance', 'structure', Quantity('mass', 'kg', 300.0, 20.0),
         (Quantity('frequency', 'Hz', 8.0, 35.0), Quantity('damping', '1', 0.02, 0.10)),
         "mass y'' + d y' + k y = -sum of the drives' forces", "half of d y' grows with |y'| / 4 mm/s",
         _frame, place='all', needs='platform'),
    Kind('payload_change', 'structure', Quantity('mass', 'kg', 0.02, 0.5, signed=True),
         (Quantity('time', 's', 1.0, 4.0),),
         'tool mass + mass from `time` on', 'gripped within 0.12 s, put down after 2.5 s', _payload,
         place='all', needs='platform'),
    Kind('rod_mass', 'structure', Quantity('mass', 'kg', 0.005, 0.12), (),
         'uniform rods: T = m/6 (v_c^2 + v_c v_p + v_p^2)', 'half uniform, a quarter in each end joint', _rods,
         place='all', needs='platform'),
    Kind('rail_radius_error', 'structure', Quantity('length', 'm', 3e-4, 1e-2, signed=True), (),
         'rail radius + length', 'by 0.85, 1.05 and 1.1 of it on the three rails', _radius,
         place='all', needs='platform'),
    Kind('rod_length_error', 'structure', Quantity('length', 'm', 4e-4, 1.5e-2, signed=True), (),
         'rod length + length', 'by 1.1, 0.85 and 1.05 of it on the three rods', _rod_length,
         place='all', needs='platform'),
    Kind('effort_crosstalk', 'measurement', _share(0.01, 0.15), (),
         'logged torque + share (sum of the others)', 'with weights 1.3 and 0.7, through a lag of 1.5 ms',
         _crosstalk, needs='drives'),
    Kind('gear_hardening', 'nuisance', Quantity('cubic', '1/m^2', 1e4, 5e6), (),
         'c x (1 + cubic x^2)', 'c x (1 + cubic x^2)', column_writer(at.HARDENING, 'cubic'), needs='gear'),
    Kind('arctan_sign', 'nuisance', Quantity('width', 'm/s', 2e-3, 5e-3), (),
         '2/pi arctan(pi v / (2 width)) in place of tanh', '2/pi arctan(pi v / (2 width)) in place of tanh', _sign),
)  # fmt: skip
