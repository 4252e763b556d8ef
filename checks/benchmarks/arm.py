# SPDX-License-Identifier: Apache-2.0
"""Arms under their controllers: steps of ours beside `mujoco.rollout`, and their errors.

UR10, Panda and Z1 of `example-robot-data`, 64 candidates, one core, processor time, the least of
the rounds, all in turn. Errors are those of position (RMS over joints) in 2 s of sines, of each
program against its own run in fine steps, and of ours against MuJoCo's: there dry friction of
MuJoCo is as firm as its steps let it. Needs MuJoCo.

    python checks/benchmarks/arm.py [--robots FOLDER] [--rounds 5]
"""

import argparse
from pathlib import Path
import sys
import tempfile
import xml.etree.ElementTree as ET

import mujoco
import mujoco.rollout
import numpy as np

from checks.benchmarks.measure import interleaved
from checks.simulators.peers import robots
from ros2_ident.machine.description import joints_in, judged_tree
from ros2_ident.models import EffectAt, machine_from_mapping, make_model
from ros2_ident.recording import Dataset

CYCLE, CYCLES, CANDIDATES, FINE = 0.002, 1000, 64, 64
# Description, and position gains; those of velocity are a twentieth.
ARMS = {
    'UR10': ('ur_description/urdf/ur10_robot.urdf', (4000, 4000, 2000, 500, 500, 300)),
    'Panda': ('panda_description/urdf/panda.urdf', (600, 600, 600, 600, 250, 150, 50)),
    'Z1': ('z1_description/urdf/z1.urdf', (300, 300, 300, 200, 200, 100)),
}
# Of every joint.
ROTOR, VISCOUS, COULOMB = 0.5, 1.0, 2.0
EFFECTS = 'stribeck', 'torque_ripple', 'position_dependent_friction'
FIRST_ORDER = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
FOURTH_ORDER = mujoco.mjtIntegrator.mjINT_RK4


class Case:
    """One arm, by ours and by MuJoCo."""

    def __init__(self, urdf: Path, gains: tuple[float, ...]) -> None:
        text = urdf.read_text(encoding='utf-8')
        self.names = joints_in(judged_tree(text))[: len(gains)]
        self.gains = np.array(gains, dtype=float)
        joints = len(gains)
        time = CYCLE * np.arange(CYCLES)
        rng = np.random.default_rng(0)
        self.command = np.linspace(-0.8, 0.4, joints)[:, None] + sum(
            0.08 * (1.0 - np.cos(2.0 * np.pi * rng.uniform(0.2, 1.5, (joints, 1)) * time))
            for _ in range(4)
        )
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / 'arm.urdf').write_text(text, encoding='utf-8')
            self.machine = machine_from_mapping(
                {
                    'machine': 'serial',
                    'drives': list(self.names),
                    'geometry': {'description': str(Path(folder) / 'arm.urdf')},
                    'controller': {
                        'cycle': CYCLE,
                        'position_gain': list(gains),
                        'velocity_gain': [g / 20.0 for g in gains],
                    },
                    'parameters': {
                        'drive_inertia': [0.0, 5.0, 'kg m^2'],
                        'coulomb_torque': [0.0, 50.0, 'N m'],
                        'viscous_torque': [0.0, 50.0, 'N m s/rad'],
                    },
                },
            ).with_constants(description=text)
        self.description = text

    def ours(self, friction: float, effects: tuple[str, ...] = (), steps: int | None = None):
        """Return the model, and candidates (S, N), all the same arm."""
        nothing = np.full_like(self.command, np.nan)
        start = np.repeat(self.command[:, :1], CYCLES, axis=1)
        data = Dataset(
            self.names, CYCLE, 0, self.command, np.zeros_like(nothing), start, None, nothing
        )
        found = [EffectAt(effect, name) for effect in effects for name in self.names[1:2]]
        model = make_model(self.machine, data, effects=found, quantities=('position',))
        model.substeps = steps
        own = {'drive_inertia': ROTOR, 'coulomb_torque': friction, 'viscous_torque': VISCOUS}
        values = [
            own.get(p.name.rpartition('.')[2], 0.25 * p.low + 0.75 * p.high)
            for p in model.parameters
        ]
        return model, np.repeat([values], CANDIDATES, axis=0)

    def mujoco(self, friction: float, integrator, steps: int):
        """Return MuJoCo's model with position actuators."""
        root = judged_tree(self.description, shapes=False)
        for joint in root.iterfind('joint'):
            if joint.get('name') not in self.names:
                joint.set('type', 'fixed')
        spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding='unicode'))
        spec.compiler.balanceinertia = True
        spec.option.timestep = CYCLE / steps
        spec.option.integrator = integrator
        for name in self.names:
            joint = spec.joint(name)
            joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
            joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
            spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        model = spec.compile()
        model.dof_armature[:], model.dof_damping[:] = ROTOR, VISCOUS
        model.dof_frictionloss[:] = friction
        model.actuator_biastype[:] = mujoco.mjtBias.mjBIAS_AFFINE
        model.actuator_gainprm[:, 0] = self.gains
        model.actuator_biasprm[:, 1:3] = -np.stack([self.gains, self.gains / 20.0], axis=1)
        mujoco.mj_setConst(model, mujoco.MjData(model))
        order = [model.joint(name).id for name in self.names]
        assert order == list(range(len(order)))
        return model

    def run(self, model, steps: int):
        """Return positions (D, K) of MuJoCo's model whose set-points hold for a cycle."""
        data = mujoco.MjData(model)
        data.qpos[:] = self.command[:, 0]
        out = np.empty_like(self.command)
        for k in range(CYCLES):
            out[:, k], data.ctrl[:] = data.qpos, self.command[:, k]
            mujoco.mj_step(model, data, nstep=steps)
        return out

    def rollout(self, model, steps: int):
        """Return a job that rolls out candidates."""
        roller, spare = mujoco.rollout.Rollout(nthread=0), mujoco.MjData(model)
        size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        start = np.zeros((CANDIDATES, size))
        start[:, 1 : 1 + len(self.names)] = self.command[:, 0]
        points = np.repeat(self.command.T, steps, axis=0)[None]
        return lambda: roller.rollout([model] * CANDIDATES, spare, start, points)


def rms(a, b) -> float:
    """Return the RMS difference of positions."""
    return float(np.sqrt(np.mean((a - b) ** 2)))


def report(name: str, case: Case, rounds: int) -> None:
    """Print one arm's table."""
    print(f'{name}, {len(case.names)} joints: us a cycle of {1e3 * CYCLE:g} ms and a candidate')
    for friction in (0.0, COULOMB):
        model, theta = case.ours(friction)
        extended, wide = case.ours(friction, EFFECTS)
        twice, _ = case.ours(friction, steps=2)
        jobs = {
            'ours': lambda m=model, t=theta: m.simulate(t),
            'ours, two steps': lambda m=twice, t=theta: m.simulate(t),
            'ours, three effects': lambda m=extended, t=wide: m.simulate(t),
        }
        kinds = {'implicitfast': (FIRST_ORDER, 1), 'RK4': (FOURTH_ORDER, 1)}
        for label, (integrator, steps) in kinds.items():
            jobs[f'MuJoCo, {label}'] = case.rollout(
                case.mujoco(friction, integrator, steps), steps
            )
        times = interleaved(jobs, rounds)
        fine, _ = case.ours(friction, steps=FINE)
        own = rms(model.simulate(theta[:1])[0], fine.simulate(theta[:1])[0])
        best = case.mujoco(friction, FOURTH_ORDER, FINE)
        finest = case.run(best, FINE)
        best.dof_solref[:] = 2.0 * best.opt.timestep, 1.0
        best.dof_solimp[:] = 0.9999, 0.9999, 1e-3, 0.5, 2.0
        firm = case.run(best, FINE)
        halved = rms(twice.simulate(theta[:1])[0], fine.simulate(theta[:1])[0])
        errors = {'ours': own, 'ours, two steps': halved, 'ours, three effects': np.nan}
        for label, (integrator, steps) in kinds.items():
            there = case.run(case.mujoco(friction, integrator, steps), steps)
            errors[f'MuJoCo, {label}'] = rms(there, finest)
        base = times['ours'].least
        print(f'  Coulomb friction {friction:g} N m')
        for label, timing in times.items():
            cost = 1e6 * timing.least / CANDIDATES / CYCLES
            ratio = timing.least / base
            print(f'    {label:22} {cost:8.3f} us {ratio:7.1f} x, error {errors[label]:.1e} rad')
        apart = rms(fine.simulate(theta[:1])[0], firm)
        print(f'    ours beside MuJoCo, both in {FINE} steps: {apart:.1e} rad')


def main() -> None:
    """Print times and errors of the arms."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--robots', type=Path, help='folder of descriptions; fetched by default')
    parser.add_argument('--rounds', type=int, default=5)
    args = parser.parse_args()
    folder = args.robots or robots(Path('build/robots').absolute(), sys.executable)
    for name, (urdf, gains) in ARMS.items():
        report(name, Case(folder / urdf, gains), args.rounds)


if __name__ == '__main__':
    main()
