# SPDX-License-Identifier: Apache-2.0
"""Servos on a pendulum: positions simulated here, beside those of the authors' own model.

The logs are those of Duclusaud, Passault, Padois, Ly, Extended Friction Models for the Physics
Simulation of Servo Actuators, ICRA 2025 (arXiv 2410.08650), as bags. Their models M1 to M6 run
with their published parameters by their scheme: friction that stops the motion if it can, Euler
steps of 5 ms, set-points in between linear. Ours is fitted on some of the bags and judged on the
others. What is compared is the mean absolute error of the position at the samples of the log.

    python checks/benchmarks/servo.py DIRECTORY_OF_BAGS --held-out kp400
    python checks/benchmarks/servo.py DIRECTORY_OF_BAGS --each    # each bag's own friction
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
import time

import numpy as np
import numpy.typing as npt

from ros2_ident.effects import CATALOGUE
from ros2_ident.gap.diagnose import diagnose
from ros2_ident.identify.run import identify, read_data
from ros2_ident.models import EffectAt, Machine, machine_from_mapping, make_model
from ros2_ident.models.protocol import FullModel
from ros2_ident.recording import Dataset

Array = npt.NDArray[np.float64]

GRAVITY = 9.80665
STEP = 5e-3
# Duty per position error [1/rad] and firmware gain: encoder counts, a divisor seen by the authors,
# and the PWM's limit in counts.
XL330_GAIN = 4096 / (2.0 * np.pi) / (256 * 885)

# github.com/Rhoban/bam, params/xl330 at 1b5a1ce.
PUBLISHED: Mapping[str, Mapping[str, float]] = {
    'M1': {'kt': 0.386696, 'R': 4.017129, 'armature': 0.00181417, 'offset': 0.030871,
           'base': 0.0128327, 'viscous': 0.00366167},
    'M2': {'kt': 0.385281, 'R': 4.000264, 'armature': 0.00181929, 'offset': 0.0328455,
           'stribeck': 0.0126512, 'speed': 4.166521, 'alpha': 1.363645, 'viscous': 0.00562085},
    'M3': {'kt': 0.380420, 'R': 3.380067, 'armature': 0.00191777, 'offset': 0.0294396,
           'base': 0.00888171, 'motor': 0.1216646, 'load': 0.1216646, 'viscous': 0.0043791},
    'M4': {'kt': 0.386171, 'R': 3.402573, 'armature': 0.00189546, 'offset': 0.0280725,
           'base': 0.00875863, 'motor': 0.0680336, 'load': 0.0680336,
           'motor_stribeck': 0.0738118, 'load_stribeck': 0.0738118,
           'speed': 2.557702, 'alpha': 0.760116, 'viscous': 0.00462103},
    'M5': {'kt': 0.362213, 'R': 2.751913, 'armature': 0.00184689, 'offset': 0.0291424,
           'base': 0.000365952, 'stribeck': 0.00867789, 'motor': 0.289652,
           'motor_stribeck': 3.05745e-05, 'load_stribeck': 0.0586825,
           'speed': 3.188912, 'alpha': 2.9904, 'viscous': 0.00634803},
    'M6': {'kt': 0.366013, 'R': 2.811392, 'armature': 0.00180774, 'offset': 0.0271133,
           'base': 0.00477118, 'stribeck': 0.00467635, 'motor': 0.266786, 'load': 8.51587e-06,
           'motor_stribeck': 1.07229e-05, 'load_stribeck': 0.0807793,
           'motor_square': 0.00997247, 'load_square': 0.00490257,
           'speed': 2.890372, 'alpha': 8.68326, 'viscous': 0.00535967},
}  # fmt: skip

# Rungs of the ladder: what each has beside Coulomb and viscous friction.
RUNGS: Mapping[str, tuple[str, ...]] = {
    'Coulomb, viscous': (),
    '+ Stribeck': ('stribeck',),
    '+ load': ('directional_load_friction',),
    '+ load, Stribeck': ('directional_load_friction', 'stribeck'),
    '+ load, Stribeck of both': ('directional_load_friction', 'stribeck_load_friction'),
    '+ Stribeck of load': ('stribeck_load_friction',),
    '+ quadratic': (
        'directional_load_friction',
        'stribeck_load_friction',
        'quadratic_load_friction',
    ),
}


@dataclass(frozen=True)
class Bench:
    """A pendulum on a servo, as its authors state it."""

    mass: float
    length: float
    supply: float
    gain: float
    limit: float = 1.0


XL330 = Bench(0.49, 0.1, 7.4, XL330_GAIN)
# Of the drive constant with which the parameters of the STS3250 were published.
STS3250 = Bench(1.13, 0.12, 12.0, 0.158)


def load(model: Mapping[str, float], suffix: str, external: float, motor: float) -> float:
    """Return the friction by what presses the gear, see M5 of the paper [N m]."""
    by_load = model.get(f'load{suffix}', 0.0)
    by_motor = model.get(f'motor{suffix}', 0.0)
    return abs(by_load * external - by_motor * motor)


def friction(model: Mapping[str, float], external: float, motor: float, speed: float) -> float:
    """Return the largest friction torque, M1 to M6 of the paper [N m]."""
    total = model.get('base', 0.0) + load(model, '', external, motor)
    if 'speed' in model:
        slow = np.exp(-(abs(speed / model['speed']) ** model['alpha']))
        more = model.get('stribeck', 0.0) + load(model, '_stribeck', external, motor)
        if np.sign(external) != np.sign(motor):
            side = ('load', external) if abs(external) < abs(motor) else ('motor', motor)
            more += model.get(f'{side[0]}_square', 0.0) * side[1] ** 2
        total += slow * more
    return float(total + model['viscous'] * abs(speed))


def theirs(model: Mapping[str, float], bench: Bench, kp: int, data: Dataset) -> Array:
    """Return (K,) the position that the authors' simulation has at every cycle [rad]."""
    assert data.command_position is not None and data.position is not None
    seen = data.position[0]
    there = np.isfinite(seen)
    every = data.time
    instants = np.arange(0.0, data.duration, STEP)
    goal = np.interp(instants, every, data.command_position[0])
    place = float(seen[there][0])
    speed = 0.0
    inertia = bench.mass * bench.length**2 + model['armature']
    released = np.inf if data.released is None else data.released * data.cycle
    out = np.empty(instants.size)
    for k, now in enumerate(instants):
        out[k] = place
        duty = np.clip(bench.gain * kp * (goal[k] - place), -bench.limit, bench.limit)
        motor = model['kt'] * (bench.supply * duty - model['kt'] * speed) / model['R']
        motor *= now < released
        angle = place + model['offset']
        external = -bench.mass * GRAVITY * bench.length * np.sin(angle)
        stop = inertia / STEP * speed + motor + external
        held = min(abs(stop), friction(model, external, motor, speed))
        rate = (motor + external - np.sign(stop) * held) / inertia
        speed += rate * STEP
        place += speed * STEP + 0.5 * rate * STEP**2
    return np.interp(every, instants, out)


def machine_of(bench: Bench, kp: int) -> Machine:
    """Return the machine file's content for a firmware gain."""
    return machine_from_mapping(
        {
            'machine': 'servo',
            'drives': ['motor'],
            'geometry': {'gravity': GRAVITY},
            'drive': {
                'supply_voltage': bench.supply,
                'load_mass': bench.mass,
                'load_length': bench.length,
            },
            'controller': {
                'cycle': 2e-3,
                'position_gain': bench.gain * kp,
                'duty_limit': bench.limit,
            },
            'parameters': {
                'torque_constant': [0.1, 1.0, 'N m/A'],
                'resistance': [1.0, 10.0, 'Ohm'],
                'armature': [1e-4, 1e-2, 'kg m^2'],
                'load_angle': [-0.1, 0.1, 'rad'],
                'coulomb_torque': [0.0, 0.2, 'N m'],
                'viscous_torque': [0.0, 0.05, 'N m s/rad'],
            },
        }
    )


def model_of(bench: Bench, kp: int, data: Dataset, effects: Sequence[str]) -> FullModel:
    """Return the model of one bag with the effects of a rung."""
    at = [EffectAt(name, 'motor') for name in effects]
    return make_model(machine_of(bench, kp), data, effects=at)


def error(position: Array, data: Dataset) -> float:
    """Return the mean absolute error at the samples of a log [rad]."""
    assert data.position is not None
    return float(np.nanmean(np.abs(position - data.position[0])))


def read_bags(where: Path, bench: Bench = XL330) -> dict[str, tuple[int, Dataset]]:
    """Return gain and data of every bag of a servo, by name."""
    servo = 'xl330' if bench is XL330 else 'sts3250'
    out = {}
    for path in sorted(where.glob(f'bam_{servo}_*')):
        name = path.name.removeprefix(f'bam_{servo}_')
        kp = int(name.split('_')[0].removeprefix('kp')) if bench is XL330 else 32
        (data,) = read_data(path, machine_of(bench, kp)).datasets
        out[name] = (kp, data)
    return out


def supported(bench: Bench, kp: int, data: Dataset) -> str:
    """Return what of the catalogue's friction a diagnosis of one bag names, and what it closes."""
    friction_of_gears = {name for effects in RUNGS.values() for name in effects}
    others = [name for name in CATALOGUE if name not in friction_of_gears]
    found = diagnose(model=model_of(bench, kp, data, ()), without=others, seed=1)
    named = [found.effect, *(at.effect for at in found.also)]
    best = found.ranking[0].at.effect if found.ranking else ''
    before, after = found.steps[0].gap.value, found.steps[-1].gap.value
    gaps = f'{1e3 * before:.1f} | {1e3 * after:.1f} | {found.share_closed.value:.2f}'
    return f'{", ".join(named)} | {best} | {gaps}'


def row(name: str, errors: Sequence[float], more: str = '') -> None:
    """Print errors in mrad."""
    cells = ' | '.join(f'{1e3 * e:.1f}' for e in errors)
    print(f'| {name} | {cells} | {more} |', flush=True)


def main() -> None:
    """Fit, judge, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('data', type=Path)
    parser.add_argument('--held-out', default='kp400', help='bags whose name holds this')
    parser.add_argument('--rungs', nargs='*', default=list(RUNGS))
    parser.add_argument('--each', action='store_true', help='which friction each bag supports')
    args = parser.parse_args()
    if args.each:
        print('| bag | named | best | nominal / mrad | with it / mrad | share closed |')
        print('| --- | --- | --- | --- | --- | --- |')
        for bench in (XL330, STS3250):
            for name, (kp, data) in read_bags(args.data, bench).items():
                print(f'| {name} | {supported(bench, kp, data)} |', flush=True)
        return
    bags = read_bags(args.data)
    names = list(bags)
    away = [name for name in names if args.held_out in name]
    print('| MAE / mrad | ' + ' | '.join(names) + ' | held out |')
    print('| --- ' * (len(names) + 2) + '|')
    for name, published in PUBLISHED.items():
        errors = [error(theirs(published, XL330, kp, data), data) for kp, data in bags.values()]
        left = np.mean([e for e, bag in zip(errors, names, strict=True) if bag in away])
        row(f'{name}, published', errors, f'{1e3 * left:.1f}')
    for rung in args.rungs:
        begin = time.monotonic()
        models = {n: model_of(XL330, *bags[n], RUNGS[rung]) for n in names}
        fitted = [models[n] for n in names if n not in away]
        found = identify(model=fitted, seed=1)
        theta = found.theta[None]
        errors = [error(models[n].simulate(theta)[0, 0], bags[n][1]) for n in names]
        left = np.mean([e for e, bag in zip(errors, names, strict=True) if bag in away])
        row(rung, errors, f'{1e3 * left:.1f}')
        values = ', '.join(f'{p.name.partition(".")[2]} {p.value:.4g}' for p in found.parameters)
        print(f'<!-- {time.monotonic() - begin:.0f} s; {values} -->')


if __name__ == '__main__':
    main()
