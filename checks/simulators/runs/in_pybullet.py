# SPDX-License-Identifier: Apache-2.0
"""PyBullet: single steps, and motion in steps."""

from common import answer, exported, Simulation
import numpy as np
import pybullet

# Of motions, and of single steps, in which friction may hardly slow a light axis, s.
STEP, SHORT = 1e-4, 1e-8


class Run(Simulation):
    """As its loader makes it."""

    def __init__(self, folder, joints, gravity):
        if not pybullet.isConnected():
            pybullet.connect(pybullet.DIRECT)
        pybullet.resetSimulation()
        pybullet.setGravity(0.0, 0.0, -9.81 if gravity else 0.0)
        pybullet.setTimeStep(STEP)
        self.loaded = exported(folder, 'pybullet')
        self.body = self.loaded.load()
        numbers = range(pybullet.getNumJoints(self.body))
        names = {pybullet.getJointInfo(self.body, n)[1].decode(): n for n in numbers}
        self.joints = [names[name] for name in joints]

    def put(self, position, velocity):
        for n, q, v in zip(self.joints, position, velocity, strict=True):
            pybullet.resetJointState(self.body, n, q, v)

    def states(self, which):
        return np.array([x[which] for x in pybullet.getJointStates(self.body, self.joints)])

    def step(self):
        self.loaded.act(self.body)
        pybullet.stepSimulation()

    def acceleration(self, position, velocity, torque):
        self.put(position, velocity)
        pybullet.setJointMotorControlArray(
            self.body, self.joints, pybullet.TORQUE_CONTROL, forces=torque.tolist()
        )
        pybullet.setTimeStep(SHORT)
        self.step()
        return (self.states(1) - velocity) / SHORT

    def motion(self, position, velocity, seconds):
        self.put(position, velocity)
        for _ in range(round(seconds / STEP)):
            self.step()
        return self.states(0)


answer('pybullet', Run)
