# SPDX-License-Identifier: Apache-2.0
"""Newton with MuJoCo as its solver, on CUDA MuJoCo Warp: single steps, and motion in steps."""

from common import DEVICE, Simulation
import newton
import numpy as np
import warp

STEP = 1e-3
warp.set_device(DEVICE)


class Run(Simulation):
    """What `add(builder, folder)` adds to a builder; it returns what gives further efforts."""

    def __init__(self, add, folder, joints, gravity):
        builder = newton.ModelBuilder(gravity=(0.0, 0.0, -9.81 if gravity else 0.0))
        self.effort = add(builder, folder)
        names = [name.rpartition('/')[2] for name in builder.joint_label]
        found = [names.index(name) for name in joints]
        self.q = [builder.joint_q_start[n] for n in found]
        self.v = [builder.joint_qd_start[n] for n in found]
        self.model = builder.finalize()
        self.solver = newton.solvers.SolverMuJoCo(self.model, use_mujoco_cpu=DEVICE == 'cpu')
        self.states = [self.model.state(), self.model.state()]
        self.control = self.model.control()

    def put(self, position, velocity, torque):
        self.asked = np.zeros(self.control.joint_f.shape[0], dtype=np.float32)
        self.asked[self.v] = torque
        for array, at, values in (
            (self.states[0].joint_q, self.q, position),
            (self.states[0].joint_qd, self.v, velocity),
        ):
            whole = np.zeros(array.shape[0], dtype=np.float32)
            whole[at] = values
            array.assign(whole)

    def step(self):
        self.states[0].clear_forces()
        self.control.joint_f.assign(self.asked + self.effort(self.model, self.states[0]))
        self.solver.step(*self.states, self.control, None, STEP)
        self.states.reverse()

    def acceleration(self, position, velocity, torque):
        self.put(position, velocity, torque)
        self.step()
        return (self.states[0].joint_qd.numpy()[self.v] - velocity) / STEP

    def motion(self, position, velocity, seconds):
        self.put(position, velocity, 0.0)
        for _ in range(round(seconds / STEP)):
            self.step()
        return self.states[0].joint_q.numpy()[self.q]

    def limits(self):
        return self.model.joint_effort_limit.numpy()[self.v]
