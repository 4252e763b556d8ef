# SPDX-License-Identifier: Apache-2.0
"""Joints of an SO-101 as servos: following error, droop and lag, simulated beside measured.

Each joint is identified on the bag in which it moves alone, by its positions, and judged on
others. Supply and gain are known: 12 V, P = 16, which is 16 times 0.166 duty a radian by the drive
constant of github.com/Rhoban/bam for an STS3215. Nothing tells the scale of the torque, so the
resistance is held at 4 Ohm.

    python checks/benchmarks/servo_arm.py DIRECTORY_OF_BAGS
"""

import argparse
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ros2_ident.identify.run import identify, read_data
from ros2_ident.models import Machine, machine_from_mapping, make_model
from ros2_ident.recording import Dataset

Array = npt.NDArray[np.float64]

LOADED = {'Rotation': False, 'Elbow': True, 'Wrist_Pitch': True}
BAGS = ('friction_gravity', 'step_response', 'chirp_sweep', 'backlash_detection')


def machine_of(joint: str) -> Machine:
    """Return the machine file's content of a joint; one that turns about a vertical is level."""
    load = {'load_mass': [0.0, 1.5, 'kg'], 'load_angle': [-3.2, 3.2, 'rad']}
    drive = {'supply_voltage': 12.0, 'resistance': 4.0, 'armature': 0.02}
    return machine_from_mapping(
        {
            'machine': 'servo',
            'drives': [joint],
            'geometry': {'gravity': 9.81 if LOADED[joint] else 0.0},
            'drive': drive | ({'load_length': 0.15} if LOADED[joint] else {}),
            'controller': {
                'cycle': 4e-3,
                'position_gain': 16 * 0.166,
                'velocity_feedforward': 1.0,
                'duty_limit': 0.97,
            },
            'parameters': {
                'torque_constant': [0.3, 4.0, 'N m/A'],
                'load_inertia': [1e-3, 0.5, 'kg m^2'],
                'velocity_gain': [0.0, 0.3, 's/rad'],
                'coulomb_torque': [0.0, 2.0, 'N m'],
                'viscous_torque': [0.0, 4.0, 'N m s/rad'],
                **(load if LOADED[joint] else {}),
            },
        }
    )


def lag(goal: Array, position: Array, cycle: float) -> float:
    """Return by how much a position is best seen later than its goal [s]."""
    shifts = np.arange(0, round(0.25 / cycle))
    left = [np.nanstd(position[k:] - goal[: goal.size - k]) for k in shifts]
    return float(shifts[int(np.argmin(left))] * cycle)


def droop(goal: Array, position: Array, cycle: float) -> float:
    """Return the mean error where the goal has stood for half a second [rad]; NaN for nowhere."""
    count = round(0.5 / cycle)
    moved = np.concatenate([np.ones(count), goal[count:] - goal[:-count]])
    still = np.abs(moved) < 1e-4
    return float(np.nanmean((goal - position)[still])) if still.any() else float('nan')


def compared(data: Dataset, simulated: Array) -> str:
    """Return a row's figures: following error, what the model misses, droop and lag."""
    assert data.position is not None and data.command_position is not None
    goal, seen = data.command_position[0], data.position[0]
    there = np.isfinite(seen)
    every = np.interp(data.time, data.time[there], seen[there])
    follows = np.sqrt(np.mean((goal - seen)[there] ** 2))
    misses = np.sqrt(np.mean((simulated - seen)[there] ** 2))
    droops = [1e3 * droop(goal, row, data.cycle) for row in (every, simulated)]
    lags = [1e3 * lag(goal, row, data.cycle) for row in (every, simulated)]
    return (
        f'{1e3 * follows:.1f} | {1e3 * misses:.1f} | {droops[0]:.1f}, {droops[1]:.1f} | '
        f'{lags[0]:.0f}, {lags[1]:.0f}'
    )


def main() -> None:
    """Identify, judge, print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('data', type=Path)
    args = parser.parse_args()
    print('| joint | bag | following error / mrad | model misses / mrad | droop, simulated / mrad '
          '| lag, simulated / ms |')  # fmt: skip
    print('| --- | --- | --- | --- | --- | --- |')
    for joint in LOADED:
        machine = machine_of(joint)
        own = f'single_joint_{joint.lower()}'
        first = read_data(args.data / f'so101_{own}', machine)
        found = identify(machine, first, seed=1)
        for bag in (own, *BAGS):
            (data,) = read_data(args.data / f'so101_{bag}', machine).datasets
            simulated = make_model(machine, data).simulate(found.theta[None])[0, 0]
            print(f'| {joint} | {bag} | {compared(data, simulated)} |', flush=True)
        values = ', '.join(f'{p.name.partition(".")[2]} {p.value:.3g}' for p in found.parameters)
        print(f'<!-- {values} -->', flush=True)


if __name__ == '__main__':
    main()
