# SPDX-License-Identifier: Apache-2.0
"""Effects that no catalogue lists: a diagnosis has to say that something else is missing.

Symbols: z motor, v its speed, s carriage, F gear force, M torque, sigma(v) the regularised sign.
"""

from collections.abc import Mapping

import numpy as np

from checks.reference import layout as at
from checks.reference.effect_kind import column_writer, Kind, Quantity
from checks.reference.plant import Array, Plant, set_columns

Values = Mapping[str, float]


def _sag(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    plant.shared[at.SAG] = values['share']


def _bump(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    columns = {
        at.BUMP_TORQUE: values['torque'],
        at.BUMP_PLACE: values['place'],
        at.BUMP_WIDTH: values['width'],
    }
    set_columns(plant, i, columns)


def _lost(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    def thinned(target: Array, speed: Array, cycle: float) -> tuple[Array, Array]:
        frame = max(1, round(1e-3 / cycle))
        rng = np.random.default_rng(seed)
        frames = -(-target.shape[1] // frame)
        lost = np.zeros(frames, dtype=bool)
        for begin in np.flatnonzero(rng.random(frames) < values['share'] / values['burst']):
            lost[begin : begin + int(values['burst'])] = True
        lost[0] = False
        source = np.maximum.accumulate(np.where(lost, 0, np.arange(frames)))
        # A lost frame repeats the last cycle of the last frame that came.
        cycles = np.arange(target.shape[1])
        taken = np.where(
            lost[cycles // frame], source[cycles // frame] * frame + frame - 1, cycles
        )
        out, out_speed = target.copy(), speed.copy()
        out[i] = target[i, taken]
        out_speed[i] = speed[i, taken]
        return out, out_speed

    plant.command_filters.append(thinned)


def _lag(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    columns = {
        at.LAG_TORQUE: values['torque'],
        at.LAG_SPEED: values['speed'],
        at.LAG_TIME: values['time'],
    }
    set_columns(plant, i, columns, internal=True)


def _slip(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    set_columns(
        plant, i, {at.SLIP_FORCE: values['force'], at.SLIP_SPEED: values['speed']}, internal=True
    )


def _brake(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    columns = {
        at.BRAKE_TORQUE: values['torque'],
        at.BRAKE_FROM: values['begin'],
        at.BRAKE_UNTIL: values['begin'] + values['duration'],
    }
    set_columns(plant, i, columns)


def _magnetic(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    set_columns(
        plant, i, {at.MAGNETIC_TORQUE: values['torque'], at.MAGNETIC_WIDTH: values['width']}
    )


def _dwell(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    columns = {
        at.DWELL_TORQUE: values['torque'],
        at.DWELL_TIME: values['time'],
        at.DWELL_SPEED: 2e-3,
    }
    set_columns(plant, i, columns, internal=True)


def _cushion(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    set_columns(
        plant, i, {at.BUMPER_STIFFNESS: values['stiffness'], at.BUMPER_PLACE: values['place']}
    )


def _kind(
    name: str, size: Quantity, others: tuple[Quantity, ...], law: str, write: object, **more: str
) -> Kind:
    return Kind(name, 'outside', size, others, law, law, write, **more)  # type: ignore[arg-type]


KINDS = (
    _kind(
        'supply_sag',
        Quantity('share', '1/W', 2e-4, 4e-3),
        (),
        'torque / (1 + share sum of max(0, M gear v))',
        _sag,
        place='all',
    ),
    _kind(
        'friction_bump',
        Quantity('torque', 'N m', 0.02, 0.3),
        (Quantity('place', 'm', 0.45, 0.51), Quantity('width', 'm', 0.004, 0.015)),
        'torque exp(-((z - place) / width)^2) sigma(v)',
        _bump,
    ),
    _kind(
        'lost_packets',
        Quantity('share', '1', 0.004, 0.15),
        (Quantity('burst', '1', choices=(2.0, 4.0, 6.0)),),
        'frames of the set-point lost in bursts, the last one held',
        _lost,
    ),
    _kind(
        'frictional_lag',
        Quantity('torque', 'N m', 0.02, 0.2),
        (Quantity('speed', 'm/s', 0.02, 0.05), Quantity('time', 's', 0.015, 0.06)),
        "torque / (1 + (w / speed)^2) sigma(v), w' = (v - w) / time",
        _lag,
    ),
    _kind(
        'speed_dependent_inertia',
        Quantity('share', 's^2/m^2', 0.1, 3.0),
        (),
        'm_e (1 + share v^2)',
        column_writer(at.SPEED_INERTIA, 'share'),
        needs='gear',
    ),
    _kind(
        'slip',
        Quantity('speed', 'm/s', 5e-4, 5e-2),
        (Quantity('force', 'N', 22.0, 40.0),),
        'z - s creeps with speed max(0, |F| / force - 1) sgn(F)',
        _slip,
        needs='gear',
    ),
    _kind(
        'brake_drag',
        Quantity('torque', 'N m', 0.02, 0.3),
        (Quantity('begin', 's', 0.5, 3.0), Quantity('duration', 's', 0.7, 2.5)),
        'torque sigma(v) between begin and begin + duration, flanks of 0.15 s',
        _brake,
    ),
    _kind(
        'magnetic_hysteresis',
        Quantity('torque', 'N m', 0.01, 0.2),
        (Quantity('width', 'N m', 0.1, 0.5),),
        'M - torque h, dh = dM / width - |dM| / width h',
        _magnetic,
    ),
    _kind(
        'dwell_stiction',
        Quantity('torque', 'N m', 0.03, 0.4),
        (Quantity('time', 's', 0.1, 0.5),),
        'torque r sigma(v), r grows in `time` at rest and wears off over 1 mm',
        _dwell,
    ),
    _kind(
        'end_cushion',
        Quantity('stiffness', 'N/m^2', 1e3, 8e4),
        (Quantity('place', 'm', 0.49, 0.53),),
        '-stiffness max(0, s - place)^2',
        _cushion,
    ),
    _kind(
        'integrator_leak',
        Quantity('rate', '1/s', 0.5, 20.0),
        (),
        'I -> I (1 - rate T) every cycle',
        column_writer(at.INTEGRATOR_LEAK, 'rate'),
        needs='integral',
    ),
)
