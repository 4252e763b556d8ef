# SPDX-License-Identifier: Apache-2.0
"""Steps a second of the `mujoco` machine beside bare `mujoco.rollout`, on one core.

Candidates differ in gain, damping and friction; attributes, set-points and what is made of the
sensors count. The bare model has dry friction as well: without it MuJoCo solves no constraints.
Process time, the best of the rounds; both in turn. Needs MuJoCo.

    python checks/benchmarks/mujoco_rollout.py MJCF [--seconds 10] [--candidates 128] [--rounds 3]
"""

import argparse
from pathlib import Path
import tempfile

import numpy as np
import yaml

from checks.benchmarks.measure import interleaved
from ros2_ident.models import load_machine
from ros2_ident.models.mujoco.model import Mujoco
from ros2_ident.recording import Dataset

BOXES = {
    'kp': [10.0, 2e3, 'N m/rad'],
    'damping': [0.0, 2.0, 'N m s/rad'],
    'frictionloss': [0.0, 0.5, 'N m'],
}


def written_machine(mjcf, drives, cycle, boxes, **more):
    """Return the `mujoco` machine of an MJCF."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / 'robot.xml').write_text(mjcf.read_text())
        content = {
            'machine': 'mujoco',
            'drives': drives,
            'geometry': {'description': 'robot.xml'},
            'controller': {'cycle': cycle},
            'parameters': boxes,
        }
        (Path(folder) / 'machine.yaml').write_text(yaml.safe_dump(content | more))
        return load_machine(Path(folder) / 'machine.yaml')


def main():
    """Print steps a second of both, and their quotient."""
    # What only takes a machine from here needs no MuJoCo.
    import mujoco
    import mujoco.rollout

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('mjcf', type=Path)
    parser.add_argument('--seconds', type=float, default=10.0)
    parser.add_argument('--candidates', type=int, default=128)
    parser.add_argument('--rounds', type=int, default=3)
    args = parser.parse_args()
    bare = mujoco.MjModel.from_xml_path(str(args.mjcf))
    bare.dof_frictionloss[:] = 0.5 * sum(BOXES['frictionloss'][:2])
    joints = [bare.joint(int(bare.actuator_trnid[a, 0])).name for a in range(bare.nu)]
    cycle = 4.0 * bare.opt.timestep
    instants = np.arange(0.0, args.seconds, cycle)
    rates = 2.0 * np.pi * np.linspace(0.4, 0.9, len(joints))[:, None]
    command = 0.5 * np.sin(rates * instants) * np.minimum(instants, 1.0)
    machine = written_machine(args.mjcf, joints, cycle, BOXES)
    zero = np.zeros_like(command)
    data = Dataset(machine.drives, cycle, 0, command, zero, zero, None, zero)
    model = Mujoco(machine, data, quantities=('effort', 'position'))
    low = np.array([p.low for p in model.parameters])
    high = np.array([p.high for p in model.parameters])
    theta = low + (high - low) * np.random.default_rng(0).random((args.candidates, len(low)))
    roller, spare = mujoco.rollout.Rollout(nthread=0), mujoco.MjData(bare)
    size = mujoco.mj_stateSize(bare, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    steps = np.repeat(command.T, 4, axis=0)[None]
    part = model.plant.together(len(instants))

    def plain():
        for first in range(0, args.candidates, part):
            count = min(part, args.candidates - first)
            roller.rollout([bare] * count, spare, np.zeros((count, size)), steps)

    jobs = {'ours': lambda: model.simulate(theta), 'theirs': plain}
    ours, theirs = (t.least for t in interleaved(jobs, args.rounds).values())
    done = args.candidates * len(instants) * 4
    print(
        f'{args.mjcf.name}: {done / ours:.0f} steps a second, bare {done / theirs:.0f}, '
        f'share {theirs / ours:.3f}'
    )


if __name__ == '__main__':
    main()
