# SPDX-License-Identifier: Apache-2.0
"""MuJoCo: inverse dynamics, and motion in steps."""

from common import answer, exported, Simulation
import mujoco
import numpy as np


class Run(Simulation):
    """The MJCF, with effects where there are any."""

    def __init__(self, folder, joints, gravity):
        mujoco.set_mjcb_passive(None)
        if (folder / 'load_mujoco.py').is_file():
            loaded = exported(folder, 'mujoco')
            self.model = loaded.load()
            mujoco.set_mjcb_passive(loaded.act)
        else:
            self.model = mujoco.MjModel.from_xml_path(str(folder / 'robot.xml'))
        self.data = mujoco.MjData(self.model)
        if not gravity:
            self.model.opt.gravity[:] = 0.0
        self.q = [self.model.joint(name).qposadr[0] for name in joints]
        self.v = [self.model.joint(name).dofadr[0] for name in joints]

    def torque(self, position, velocity, acceleration, guess):
        data = self.data
        data.qpos[self.q], data.qvel[self.v], data.qacc[self.v] = position, velocity, acceleration
        for _ in range(2):  # friction that depends on the place is that of the call before
            mujoco.mj_inverse(self.model, data)
        return np.array(data.qfrc_inverse[self.v])

    def motion(self, position, velocity, seconds):
        self.data.qpos[self.q], self.data.qvel[self.v] = position, velocity
        mujoco.mj_step(self.model, self.data, round(seconds / self.model.opt.timestep))
        return self.data.qpos[self.q]

    def limits(self):
        numbers = self.model.dof_jntid[self.v]
        limited = self.model.jnt_actfrclimited[numbers]
        return np.where(limited, self.model.jnt_actfrcrange[numbers, 1], np.inf)


answer('mujoco', Run)
