# SPDX-License-Identifier: Apache-2.0
"""Two bags of an arm of a URDF under P and D on position, simulated by MuJoCo in steps of 50 us.

Gains, armature and friction are drawn and written to `hidden.json`, for who wants to compare what
an identification finds in the bags with it:

    python checks/benchmarks/urdf_arm.py arm.urdf bags
    ident new-machine --description arm.urdf --bag bags/fit --out arm.yaml
    ident check --machine arm.yaml bags/fit
    ident identify bags/fit --machine arm.yaml --outputs position,effort --out out
    ident predict bags/judge --from out
"""

import argparse
import json
from pathlib import Path
import xml.etree.ElementTree as ET

import mujoco
import numpy as np

from ros2_ident.machine.description import joints_in, judged_tree
from ros2_ident.recording import Recording, Stream
from ros2_ident.recording.write import write_bag

CYCLE, STEP, SECONDS = 5e-3, 5e-5, 20.0
# How far the motion goes to either side, rad.
REACH = 0.8
# Least and largest, as shares of a joint's largest effort in the URDF.
HIDDEN = {
    'kp': (20.0, 50.0),
    'kv': (0.5, 1.8),
    'armature': (0.01, 0.022),
    'frictionloss': (0.05, 0.15),
    'damping': (0.06, 0.22),
}


def main() -> None:
    """Draw, simulate, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('urdf', type=Path)
    parser.add_argument('out', type=Path)
    parser.add_argument('--seed', type=int, default=0)
    args = parser.parse_args()
    root = judged_tree(args.urdf.read_text(encoding='utf-8'))
    names = joints_in(root)
    rng = np.random.default_rng(args.seed)
    spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding='unicode'))
    spec.compiler.balanceinertia = True
    spec.option.timestep = STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    most = np.array([spec.joint(name).actfrcrange[1] for name in names])
    hidden = {key: most * rng.uniform(*ends, len(names)) for key, ends in HIDDEN.items()}
    for d, name in enumerate(names):
        added = spec.add_actuator(name=name, target=name, biastype=mujoco.mjtBias.mjBIAS_AFFINE)
        added.trntype = mujoco.mjtTrn.mjTRN_JOINT
        added.gainprm[0] = hidden['kp'][d]
        added.biasprm[1:3] = -hidden['kp'][d], -hidden['kv'][d]
    model = spec.compile()
    for key in ('armature', 'frictionloss', 'damping'):
        getattr(model, f'dof_{key}')[:] = hidden[key]
    # By what a joint moves MuJoCo scales how firmly dry friction holds.
    mujoco.mj_setConst(model, mujoco.MjData(model))
    ends = np.where(model.jnt_limited[:, None], model.jnt_range, [-np.inf, np.inf]).T
    room = np.stack([ends[0] + REACH, np.maximum(ends[1] - REACH, ends[0] + REACH)])
    stamp = np.arange(round(SECONDS / CYCLE)) * round(CYCLE * 1e9)
    time = stamp[:, None] * 1e-9
    for bag in ('fit', 'judge'):
        data = mujoco.MjData(model)
        home = np.clip(rng.uniform(-0.8, 0.8, len(names)), *room)
        points = home + sum(
            size * rng.uniform(0.7, 1.1, len(names))
            * np.sin(2.0 * np.pi * (rate * rng.uniform(0.7, 1.3, len(names)) * time))
            for size, rate in ((0.45, 0.11), (0.2, 0.27), (0.08, 0.5))
        ) * np.clip(0.5 * time, 0.0, 1.0)  # fmt: skip
        data.qpos[:], data.ctrl[:] = home, home
        mujoco.mj_step(model, data, nstep=round(2.0 / STEP))
        seen = np.empty((3, *points.shape))
        for k, row in enumerate(points):
            data.ctrl[:] = row
            mujoco.mj_forward(model, data)
            seen[:, k] = data.qpos, data.qvel, data.qfrc_actuator
            mujoco.mj_step(model, data, nstep=round(CYCLE / STEP))
        noise = np.array([2e-5, 2e-3, 0.01])[:, None, None]
        noise = noise * np.stack([home**0, home**0, np.ptp(seen[2], axis=0)])[:, None]
        seen += noise * rng.standard_normal(seen.shape)
        state = Stream(names, stamp, position=seen[0], velocity=seen[1], effort=seen[2])
        write_bag(args.out / bag, Recording(state, command=Stream(names, stamp, position=points)))
    found = {key: dict(zip(names, each.tolist(), strict=True)) for key, each in hidden.items()}
    (args.out / 'hidden.json').write_text(json.dumps(found, indent=2), encoding='utf-8')


if __name__ == '__main__':
    main()
