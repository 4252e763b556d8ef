# SPDX-License-Identifier: Apache-2.0
"""SAPIEN: single steps, and motion in steps, without a renderer."""

from common import answer, exported, Simulation
import numpy as np
import sapien

# Its numbers have 7 digits.
STEP = 1e-3


class Run(Simulation):
    """As its loader makes it."""

    def __init__(self, folder, joints, gravity):
        config = sapien.physx.PhysxSceneConfig()
        config.gravity = np.array([0.0, 0.0, -9.81 if gravity else 0.0], dtype=np.float32)
        sapien.physx.set_scene_config(config)
        self.scene = sapien.Scene([sapien.physx.PhysxCpuSystem()])
        self.scene.set_timestep(STEP)
        self.loaded = exported(folder, 'sapien')
        self.robot = self.loaded.load(self.scene)
        names = [joint.name for joint in self.robot.active_joints]
        self.at = [names.index(name) for name in joints]

    def put(self, position, velocity):
        for values, write in (
            (position, self.robot.set_qpos),
            (velocity, self.robot.set_qvel),
        ):
            whole = np.zeros(self.robot.dof)
            whole[self.at] = values
            write(whole)

    def step(self, torque):
        whole = np.zeros(self.robot.dof)
        whole[self.at] = torque
        self.robot.set_qf(whole + self.loaded.friction(self.robot))
        self.scene.step()

    def acceleration(self, position, velocity, torque):
        self.put(position, velocity)
        self.step(torque)
        return (self.robot.qvel[self.at] - velocity) / STEP

    def motion(self, position, velocity, seconds):
        self.put(position, velocity)
        for _ in range(round(seconds / STEP)):
            self.step(0.0)
        return self.robot.qpos[self.at]


answer('sapien', Run)
