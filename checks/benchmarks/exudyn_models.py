# SPDX-License-Identifier: Apache-2.0
"""The belt drive and the tripod in Exudyn, as fast as we could make them there.

Several formulations were tried: what is quickest is the first-order system
as one object under an explicit solver. The belt drive is linear, so its matrix is all that Exudyn
needs; the set-point changes between two calls of the solver, so no Python runs within a step. The
tripod's right-hand side is compiled by numba, and the discrete controllers run before each step.
"""

from collections.abc import Mapping
import sys
from typing import Any
import warnings

from numba import njit
import numpy as np

sys.exudynFast = True  # type: ignore[attr-defined]  # its build without range checks
warnings.simplefilter('ignore', DeprecationWarning)
import exudyn as exu  # noqa: E402
import exudyn.itemInterface as items  # noqa: E402

exu.SetWriteToConsole(False)
SOLVERS = exu.DynamicSolverType


def _settings(start: float, end: float, steps: int, period: float) -> Any:
    s = exu.SimulationSettings()
    s.timeIntegration.startTime = start
    s.timeIntegration.endTime = end
    s.timeIntegration.numberOfSteps = steps
    s.timeIntegration.automaticStepSize = False
    s.timeIntegration.verboseMode = 0
    s.timeIntegration.explicitIntegration.computeEndOfStepAccelerations = False
    s.solutionSettings.writeSolutionToFile = False
    s.solutionSettings.sensorsWritePeriod = period
    return s


def belt_matrices(c: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return inertias (3,) and stiffness matrix (3, 3), eq. 21, controller included."""
    k1 = c['axial_stiffness'] / (c['length_1'] + c['rail_position'])
    k2 = c['axial_stiffness'] / (c['length_2'] - c['rail_position'])
    k3 = c['axial_stiffness'] / c['length_3']
    r = c['radius']
    stiffness = np.array(
        [
            [r * r * (k1 + k3) + c['position_gain'], -r * r * k3, -r * k1],
            [-r * r * k3, r * r * (k2 + k3), -r * k2],
            [-r * k1, -r * k2, k1 + k2],
        ]
    )
    inertia = np.array([c['driving_inertia'], c['driven_inertia'], c['rail_mass']])
    return inertia, stiffness


def belt_torque(
    c: Mapping[str, float],
    cycle: float,
    reference: np.ndarray,
    *,
    solver: str = 'RK67',
    substeps: int = 1,
) -> np.ndarray:
    """Return phi1 and M1, (2, K), of one belt drive.

    Args:
        c: Constants by name, as in `config/belt_drive.yaml`.
        reference: (K,) set-point, rad.
    """
    inertia, stiffness = belt_matrices(c)
    gain = c['position_gain']
    container = exu.SystemContainer()
    mbs = container.AddSystem()
    matrix = np.zeros((6, 6))
    matrix[:3, 3:] = np.eye(3)
    matrix[3:, :3] = -stiffness / inertia[:, None]
    node = mbs.AddNode(
        items.NodeGenericODE1(
            referenceCoordinates=[0.0] * 6, initialCoordinates=[0.0] * 6, numberOfODE1Coordinates=6
        )
    )
    body = mbs.AddObject(
        items.ObjectGenericODE1(nodeNumbers=[node], systemMatrix=matrix, rhsVector=np.zeros(6))
    )
    sensor = mbs.AddSensor(
        items.SensorNode(
            nodeNumber=node,
            storeInternal=True,
            outputVariableType=exu.OutputVariableType.Coordinates,
        )
    )
    mbs.Assemble()
    last = reference.size - 1
    edges = [0, *(np.flatnonzero(np.diff(reference)) + 1).tolist(), last]
    phi1 = np.empty(reference.size)
    for first, end in zip(edges[:-1], edges[1:], strict=True):
        push = gain * float(reference[first])
        mbs.SetObjectParameter(body, 'rhsVector', [0.0] * 3 + [push / inertia[0], 0.0, 0.0])
        settings = _settings(first * cycle, end * cycle, (end - first) * substeps, cycle)
        mbs.SolveDynamic(settings, solverType=getattr(SOLVERS, solver), updateInitialValues=True)
        phi1[first : end + 1] = mbs.GetSensorStoredData(sensor)[:, 1]
    return np.stack([phi1, gain * (reference - phi1)])


@njit(cache=True)
def tripod_rates(q, torque, par, rail, rates):
    """Write the derivative of motors, carriages and their speeds (12,).

    Args:
        q: (12,) state.
        torque: (3,) of the motors, N m.
        par: (11,) stiffness, damping, tool mass, motor mass, Coulomb and viscous torque, width of
            the Coulomb step, gear factor, carriage mass, gravity, rod length.
        rail: (3, 2) where the rails stand, m.
        rates: (12,) written.
    """
    stiffness, damping, tool, motor, coulomb, viscous, width, gear, mass, gravity, rod = par
    s, w = q[3:6], q[9:12]
    # The platform: the lower point at a rod's length from all three carriages. Differences of the
    # spheres are planes, along whose line x, y are linear in z.
    a11, a12 = rail[1, 0] - rail[0, 0], rail[1, 1] - rail[0, 1]
    a21, a22 = rail[2, 0] - rail[0, 0], rail[2, 1] - rail[0, 1]
    n0 = rail[0, 0] ** 2 + rail[0, 1] ** 2 + s[0] ** 2
    b1 = 0.5 * (rail[1, 0] ** 2 + rail[1, 1] ** 2 + s[1] ** 2 - n0)
    b2 = 0.5 * (rail[2, 0] ** 2 + rail[2, 1] ** 2 + s[2] ** 2 - n0)
    d1, d2 = s[0] - s[1], s[0] - s[2]
    over = 1.0 / (a11 * a22 - a12 * a21)
    x0, x1 = (a22 * b1 - a12 * b2) * over, (a22 * d1 - a12 * d2) * over
    y0, y1 = (a11 * b2 - a21 * b1) * over, (a11 * d2 - a21 * d1) * over
    dx, dy = x0 - rail[0, 0], y0 - rail[0, 1]
    a = x1 * x1 + y1 * y1 + 1.0
    b = x1 * dx + y1 * dy - s[0]
    z = (-b - np.sqrt(b * b - a * (dx * dx + dy * dy + s[0] * s[0] - rod * rod))) / a
    x, y = x0 + x1 * z, y0 + y1 * z
    normal, push = np.empty((3, 3)), np.empty(3)
    for i in range(3):
        normal[i, 0], normal[i, 1], normal[i, 2] = x - rail[i, 0], y - rail[i, 1], z - s[i]
        push[i] = stiffness * (q[i] - s[i]) + damping * (q[6 + i] - w[i])
        rates[i], rates[3 + i] = q[6 + i], w[i]
        friction = coulomb * np.tanh(q[6 + i] / width) + viscous * q[6 + i]
        rates[6 + i] = (gear * (torque[i] - friction) - push[i]) / motor
    inverse = inverse3(normal)
    jacobian, v = np.empty((3, 3)), np.zeros(3)
    for i in range(3):
        for j in range(3):
            jacobian[i, j] = inverse[i, j] * normal[j, 2]
            v[i] += jacobian[i, j] * w[j]
    bias = np.zeros(3)
    for j in range(3):
        bend = v[0] ** 2 + v[1] ** 2 + (v[2] - w[j]) ** 2
        for i in range(3):
            bias[i] -= inverse[i, j] * bend
    bias[2] += gravity
    inertia = np.empty((3, 3))
    for i in range(3):
        push[i] -= mass * gravity
        for k in range(3):
            push[i] -= tool * jacobian[k, i] * bias[k]
        for j in range(3):
            total = mass if i == j else 0.0
            for k in range(3):
                total += tool * jacobian[k, i] * jacobian[k, j]
            inertia[i, j] = total
    inverse = inverse3(inertia)
    for i in range(3):
        total = 0.0
        for j in range(3):
            total += inverse[i, j] * push[j]
        rates[9 + i] = total


@njit(cache=True)
def inverse3(m):
    """Return the inverse of a (3, 3) matrix by its cofactors."""
    out = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            out[j, i] = m[a, c] * m[b, d] - m[a, d] * m[b, c]
    return out / (m[0, 0] * out[0, 0] + m[0, 1] * out[1, 0] + m[0, 2] * out[2, 0])


@njit(cache=True)
def _control(q, target, speed, gains, cycle, limit, integral, torque):
    for i in range(3):
        error = gains[0] * (target[i] - q[i]) + speed[i] - q[6 + i]
        integral[i] += gains[2] * error * cycle
        torque[i] = min(limit, max(-limit, gains[1] * error + integral[i]))


class TripodDrive:
    """The tripod under its controllers.

    Args:
        values: Gear stiffness, damping ratio and so on, the same for all drives.
        position: (3, K) set-points at every controller cycle, m.
        velocity: (3, K) their derivatives, m/s.
    """

    def __init__(
        self, machine: Any, values: Mapping[str, float], position: np.ndarray, velocity: np.ndarray
    ) -> None:
        number = machine.number
        gear, mass = number('gear_factor'), number('rail_mass')
        motor = values['drive_inertia'] * gear**2
        stiffness = values['gear_stiffness']
        reduced = np.sqrt(stiffness * motor * mass / (motor + mass))
        azimuth = machine.numbers('rail_azimuth')
        radius = number('rail_radius')
        self.rail = radius * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
        self.par = np.array(
            [
                stiffness,
                2.0 * values['gear_damping_ratio'] * reduced,
                values['tool_mass'],
                motor,
                values['coulomb_torque'],
                values['viscous_torque'],
                number('coulomb_regularisation'),
                gear,
                mass,
                number('gravity'),
                number('rod_length'),
            ]
        )
        self.gains = np.array([number(f'{k}_gain') for k in ('position', 'velocity', 'integral')])
        self.cycle = number('cycle')
        self.limit = number('torque_limit')
        self.target = np.ascontiguousarray(position.T)
        self.speed = np.ascontiguousarray(velocity.T)

    def rest(self) -> tuple[np.ndarray, np.ndarray]:
        """Return state (12,) and torque (3,) of the static equilibrium at the first set-point."""
        state = np.concatenate([self.target[0], self.target[0], np.zeros(6)])
        rates = np.empty(12)
        load = np.zeros(3)
        for _ in range(3):  # linear in the stretch: converged after the first
            state[:3] = state[3:6] + load / self.par[0]
            tripod_rates(state, np.zeros(3), self.par, self.rail, rates)
            columns = []
            for i in range(3):
                moved, other = state.copy(), np.empty(12)
                moved[i] += 1.0 / self.par[0]
                tripod_rates(moved, np.zeros(3), self.par, self.rail, other)
                columns.append(other[9:] - rates[9:])
            load -= np.linalg.solve(np.array(columns).T, rates[9:])
        state[:3] = state[3:6] + load / self.par[0]
        return state, load / self.par[7]

    def torque(self, solver: str = 'RK44', substeps: int = 1) -> np.ndarray:
        """Return the controllers' torque (3, K), N m."""
        state, integral = self.rest()
        container = exu.SystemContainer()
        mbs = container.AddSystem()
        node = mbs.AddNode(
            items.NodeGenericODE1(
                referenceCoordinates=[0.0] * 12,
                initialCoordinates=state.tolist(),
                numberOfODE1Coordinates=12,
            )
        )
        torque, rates = np.zeros(3), np.zeros(12)
        cycles = len(self.target)
        found = np.empty((cycles, 3))
        count = 0

        def right_hand_side(_mbs: Any, _t: float, _item: int, q: Any) -> np.ndarray:
            tripod_rates(np.array(q), torque, self.par, self.rail, rates)
            return rates

        def before_step(_mbs: Any, _t: float) -> bool:
            nonlocal count
            cycle, within = divmod(count, substeps)
            count += 1
            if within == 0:
                control(cycle)
            return True

        def control(cycle: int) -> None:
            q = mbs.systemData.GetODE1Coordinates()
            _control(
                q,
                self.target[cycle],
                self.speed[cycle],
                self.gains,
                self.cycle,
                self.limit,
                integral,
                torque,
            )
            found[cycle] = torque

        mbs.AddObject(
            items.ObjectGenericODE1(
                nodeNumbers=[node], rhsVector=[0.0] * 12, rhsUserFunction=right_hand_side
            )
        )
        mbs.SetPreStepUserFunction(before_step)
        mbs.Assemble()
        settings = _settings(0.0, (cycles - 1) * self.cycle, (cycles - 1) * substeps, 1e9)
        mbs.SolveDynamic(settings, solverType=getattr(SOLVERS, solver))
        control(cycles - 1)
        return found.T


def genetic_optimization(
    objective: Any, bounds: Mapping[str, tuple[float, float]], seed: int, processes: int
) -> tuple[dict[str, float], list[float]]:
    """Run Exudyn's genetic algorithm with the paper's settings, 2760 simulations."""
    import exudyn.processing as processing

    best, _, _, costs = processing.GeneticOptimization(
        objectiveFunction=objective,
        parameters=dict(bounds),
        initialPopulationSize=1000,
        populationSize=160,
        elitistRatio=0.125,
        numberOfGenerations=12,
        crossoverProbability=0.0,
        rangeReductionFactor=0.5,
        distanceFactor=0.0,
        randomizerInitialization=seed,
        useMultiProcessing=processes > 1,
        numberOfThreads=processes,
        showProgress=False,
    )
    return best, [float(x) for x in costs]
