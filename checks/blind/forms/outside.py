# SPDX-License-Identifier: Apache-2.0
"""Effects that no catalogue here lists: a diagnosis has to say that something else is missing."""

import numpy as np

from checks.blind.forms import columns as at
from checks.blind.forms.form import Form, Range, setter, Values, Write
from checks.reference import layout as nominal
from checks.reference.plant import Array, Plant

_PHASE = Range('phase', 'rad', 0.0, 2.0 * np.pi)


def hung(plant: Plant, i: int, values: Values, seed: int) -> None:
    """Write a part of the carriage that swings on a spring."""
    plant.drive[i, nominal.CARRIAGE_MASS] -= values['mass']
    plant.drive[i, at.HUNG_MASS] = values['mass']
    plant.drive[i, at.HUNG_RATE] = 2.0 * np.pi * values['frequency']
    plant.drive[i, at.HUNG_DAMPING] = values['damping']


def lossy(plant: Plant, i: int, values: Values, seed: int) -> None:
    """Write a network that loses set-points while it is in its bad state, the last one held."""

    def thinned(target: Array, speed: Array, cycle: float) -> tuple[Array, Array]:
        frame = max(1, round(1e-3 / cycle))
        frames = -(-target.shape[1] // frame)
        rng = np.random.default_rng(seed)
        lost = bad_state(rng, frames, values['share'], values['burst'])
        # A lost frame repeats the last one that came.
        source = np.maximum.accumulate(np.where(lost, 0, np.arange(frames)))
        cycles = np.arange(target.shape[1])
        missed = lost[cycles // frame]
        taken = np.where(missed, source[cycles // frame] * frame + frame - 1, cycles)
        out, out_speed = target.copy(), speed.copy()
        out[i], out_speed[i] = target[i, taken], speed[i, taken]
        return out, out_speed

    plant.command_filters.append(thinned)


def bad_state(
    rng: np.random.Generator, frames: int, share: float, burst: float
) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return whether each frame is lost: Gilbert's two states, never at the first.

    Args:
        burst: Mean length of a loss, in frames.
    """
    leave = 1.0 / burst
    enter = leave * share / (1.0 - share)
    lost = np.zeros(frames, dtype=bool)
    dice = rng.random(frames)
    for n in range(1, frames):
        lost[n] = dice[n] >= leave if lost[n - 1] else dice[n] < enter
    return lost


def sag(plant: Plant, i: int, values: Values, seed: int) -> None:
    """Write a supply that gives way under the drives' power."""
    plant.shared[nominal.SAG] = values['share']


def _outside(
    name: str,
    law: str,
    source: str,
    numbers: tuple[Range, ...],
    write: Write,
    needs: str = '',
    whole: bool = False,
) -> Form:
    place = 'all' if whole else 'drive'
    size, *others = numbers
    return Form(name, '', law, source, size, tuple(others), write, place, needs)  # type: ignore[arg-type]


FORMS = (
    _outside(
        'friction_memory',
        'torque exp(-|w| / speed) sgn v, w the speed behind two lags of time / 2',
        'Hess and Soom 1990, J. Tribology 112(1): friction follows the speed with a delay',
        (
            Range('torque', 'N m', 0.02, 0.22),
            Range('speed', 'm/s', 0.017, 0.06),
            Range('time', 's', 0.025, 0.08),
        ),
        setter(torque=at.MEMORY_TORQUE, speed=at.MEMORY_SPEED, time=at.MEMORY_TIME),
    ),
    _outside(
        'rest_stiction',
        'torque (1 - exp(-(rest / time)^0.6)) sgn v, worn off over a way',
        'Kato, Sato, Matsubayashi 1972, J. Lubrication Technology 94(2), eq. 3',
        (
            Range('torque', 'N m', 0.03, 0.4),
            Range('time', 's', 0.12, 0.7),
            Range('way', 'm', 6e-4, 2.5e-3),
        ),
        setter(torque=at.REST_TORQUE, time=at.REST_TIME, way=at.REST_WAY),
    ),
    _outside(
        'ball_passing',
        'M_C (1 + share sin(2 pi z / pitch + phase)) sgn v',
        'Ohta and Hayashi 2000, J. Sound Vib. 235(5): balls of a linear guide come and go',
        (Range('share', '1', 0.08, 0.95), Range('pitch', 'm', 3.7e-3, 1.5e-2), _PHASE),
        setter(share=at.BALL_SHARE, pitch=at.BALL_PITCH, phase=at.BALL_PHASE),
    ),
    _outside(
        'loose_part',
        "a part of the carriage on a spring: u'' + 2 D w u' + w^2 u = -s''",
        'Den Hartog 1934, Mechanical Vibrations, sect. 3.2',
        (
            Range('mass', 'kg', 0.012, 0.4),
            Range('frequency', 'Hz', 5.5, 24.0),
            Range('damping', '1', 0.015, 0.08),
        ),
        hung,
        needs='gear',
    ),
    _outside(
        'tooth_mesh',
        'c (1 + share sin(2 pi z / pitch + phase))',
        'Kahraman and Singh 1991, J. Sound Vib. 146(1): stiffness over the mesh',
        (Range('share', '1', 0.06, 0.6), Range('pitch', 'm', 2.6e-3, 9e-3), _PHASE),
        setter(share=at.MESH_SHARE, pitch=at.MESH_PITCH, phase=at.MESH_PHASE),
        needs='gear',
    ),
    _outside(
        'warm_winding',
        "M (1 - share w), w' = ((M_c / rated)^2 - w) / time",
        'Mellor, Roberts, Turner 1991, IEE Proc. B 138(5): one node of the thermal network',
        (
            Range('share', '1', 0.01, 0.4),
            Range('time', 's', 0.7, 5.0),
            Range('rated', 'N m', 0.5, 1.3),
        ),
        setter(share=at.COPPER_SHARE, time=at.COPPER_TIME, rated=at.COPPER_TORQUE),
    ),
    _outside(
        'neighbour',
        'force sin(2 pi f t + phase) on the carriage',
        'Gordon 1991, Proc. SPIE 1619: floors carry what other machines shake',
        (
            Range('force', 'N', 0.4, 9.0),
            Range('rate', 'rad/s', 2.0 * np.pi * 3.3, 2.0 * np.pi * 31.0),
            _PHASE,
        ),
        setter(force=at.SHAKE_FORCE, rate=at.SHAKE_RATE, phase=at.SHAKE_PHASE),
    ),
    _outside(
        'lossy_network',
        'frames of the set-point lost in bursts, the last one held',
        'Gilbert 1960, Bell Syst. Tech. J. 39(5): a channel with a good and a bad state',
        (Range('share', '1', 0.004, 0.15), Range('burst', '1', 2.2, 6.5)),
        lossy,
    ),
    _outside(
        'supply_sag',
        'torque / (1 + share sum of max(0, M gear v))',
        'Mohan, Undeland, Robbins 1995, Power Electronics, ch. 5: a supply with its impedance',
        (Range('share', '1/W', 2e-4, 4e-3),),
        sag,
        whole=True,
    ),
)
