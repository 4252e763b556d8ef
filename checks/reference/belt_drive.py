# SPDX-License-Identifier: Apache-2.0
"""The belt drive as bodies and springs, integrated numerically; slow and plain.

Newton's law for each body with the forces of the three belt parts that pull on it; no mass or
stiffness matrix, no modes, no code in common with `ros2_ident.models.belt_drive.model`.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from checks.reference.plant import known_names, Log, Plant, Unmodelled
from checks.reference.twin import Twin
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.machine import Machine

Array = NDArray[np.float64]


def belt_forces(
    constants: Mapping[str, float], phi1: float, phi2: float, carriage: float
) -> tuple[float, float, float]:
    """Return the change of pull in the three belt parts.

    Args:
        phi1: Angle of the driving gear, rad.
        phi2: Angle of the driven gear, rad.
        carriage: Displacement of the rail mass, x - x0, m.

    Returns:
        Forces [N], positive where the part is longer than at the start: driving gear to rail mass,
        rail mass to driven gear, and between the gears.
    """
    x0 = constants['rail_position']
    arc1 = constants['radius'] * phi1
    arc2 = constants['radius'] * phi2
    # Strain times EA; the belt runs from gear 1 over the carriage to gear 2 and back. The sign of
    # x is eq. 10's: the carriage moves towards gear 1 as the gears turn forwards.
    pull1 = constants['axial_stiffness'] * (arc1 + carriage) / (constants['length_1'] + x0)
    pull2 = constants['axial_stiffness'] * (-carriage - arc2) / (constants['length_2'] - x0)
    pull3 = constants['axial_stiffness'] * (arc2 - arc1) / constants['length_3']
    return pull1, pull2, pull3


def simulate_belt(
    constants: Mapping[str, float], cycle: float, reference: Array, *, tolerance: float = 1e-12
) -> Array:
    """Simulate one belt drive.

    Args:
        reference: (K,) set-point phi1d, rad, constant over each sample.
        tolerance: Relative tolerance of the integrator (Dormand-Prince, order 8).

    Returns:
        (2, K): phi1 [rad] and M1 [Nm] at every sample; at rest at the first one.
    """
    gain = constants['position_gain']
    radius = constants['radius']

    def accelerate(_: float, state: Array, target: float) -> list[float]:
        phi1, phi2, carriage = state[:3]
        pull1, pull2, pull3 = belt_forces(constants, phi1, phi2, carriage)
        torque = gain * (target - phi1)
        return [
            state[3],
            state[4],
            state[5],
            (torque - radius * pull1 + radius * pull3) / constants['driving_inertia'],
            (radius * pull2 - radius * pull3) / constants['driven_inertia'],
            (pull2 - pull1) / constants['rail_mass'],
        ]

    out = np.empty((2, reference.size))
    start = float(reference[0])
    state = np.array([start, start, -radius * start, 0.0, 0.0, 0.0])
    # The integrator must not step over a jump of the set-point: one call for each level.
    edges = [0, *(np.flatnonzero(np.diff(reference)) + 1).tolist(), reference.size - 1]
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        target = float(reference[first])
        times = np.arange(last - first + 1) * cycle
        if last > first:
            solution = solve_ivp(
                accelerate,
                (0.0, times[-1]),
                state,
                method='DOP853',
                t_eval=times,
                args=(target,),
                rtol=tolerance,
                atol=tolerance * 1e-4,
            )
            angles = solution.y[0]
            state = solution.y[:, -1]
        else:
            angles = state[:1]
        out[0, first : last + 1] = angles
        out[1, first : last + 1] = gain * (target - angles)
    # The last sample of all may itself begin a new level.
    out[1, -1] = gain * (reference[-1] - out[0, -1])
    return out


def _no_plant(machine: Machine, parameters: Mapping[str, float]) -> Plant:
    raise IdentError(
        ErrorCode.INVALID_GOAL,
        'a belt drive has no drives that effects could be written into; leave them out',
    )


def simulate_log(
    machine: Machine,
    parameters: Mapping[str, float],
    position: Array,
    velocity: Array,
    effects: Sequence[Unmodelled] = (),
    rtol: float = 1e-12,
    atol: float = 0.0,
) -> Log:
    """Simulate a log of a belt drive: the driving gear's angle, and its moment as the effort.

    Args:
        position: (1, K) set-point at every sample [rad], held until the next.

    Returns:
        The log; its speed is the difference of the angles.

    Raises:
        IdentError: INVALID_GOAL where there are effects, UNKNOWN_PARAMETER for a name that is not
        the belt drive's.
    """
    if effects:
        _no_plant(machine, parameters)
    known_names(parameters, machine, ())
    true = machine.with_values(parameters)
    constants = {name: true.number(name) for name in true.constants}
    cycle = machine.number('cycle')
    phi1, torque = simulate_belt(constants, cycle, position[0], tolerance=rtol)[:, None]
    speed = np.gradient(phi1, cycle, axis=1)
    return Log(machine.drives, cycle, torque, phi1, speed, torque)


TWIN = Twin('belt_drive', _no_plant, simulate_log)
