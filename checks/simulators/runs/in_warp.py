# SPDX-License-Identifier: Apache-2.0
"""MuJoCo Warp: inverse dynamics, and motion in steps, in one world."""

from common import answer, DEVICE, Simulation
import mujoco
import mujoco_warp
import numpy as np
import warp

warp.set_device(DEVICE)


class Run(Simulation):
    """The MJCF, without effects: MuJoCo's callback is not called here."""

    def __init__(self, folder, joints, gravity):
        model = mujoco.MjModel.from_xml_path(str(folder / 'robot.xml'))
        if not gravity:
            model.opt.gravity[:] = 0.0
        self.q = [model.joint(name).qposadr[0] for name in joints]
        self.v = [model.joint(name).dofadr[0] for name in joints]
        self.step, self.numbers = model.opt.timestep, model.dof_jntid[self.v]
        self.model = mujoco_warp.put_model(model)
        self.data = mujoco_warp.put_data(model, mujoco.MjData(model))

    def put(self, **values):
        for name, (at, numbers) in values.items():
            array = getattr(self.data, name)
            whole = array.numpy()
            whole[0, at] = numbers
            array.assign(whole)

    def torque(self, position, velocity, acceleration, guess):
        self.put(qpos=(self.q, position), qvel=(self.v, velocity), qacc=(self.v, acceleration))
        mujoco_warp.inverse(self.model, self.data)
        return self.data.qfrc_inverse.numpy()[0, self.v]

    def motion(self, position, velocity, seconds):
        self.put(qpos=(self.q, position), qvel=(self.v, velocity))
        for _ in range(round(seconds / self.step)):
            mujoco_warp.step(self.model, self.data)
        return self.data.qpos.numpy()[0, self.q]

    def limits(self):
        limited = self.model.jnt_actfrclimited.numpy()[self.numbers]
        most = self.model.jnt_actfrcrange.numpy()[0, self.numbers, 1]
        return np.where(limited, most, np.inf)


answer('mujoco-warp', Run)
