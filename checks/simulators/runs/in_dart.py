# SPDX-License-Identifier: Apache-2.0
"""DART, the engine of Gazebo: single steps, and motion in steps."""

from common import answer, Simulation
import dartpy as dart
import numpy as np

# Of motions, and of single steps, in which friction may hardly slow a light axis, s.
STEP, SHORT = 1e-4, 1e-8


class Run(Simulation):
    """The URDF."""

    def __init__(self, folder, joints, gravity):
        self.world = dart.simulation.World()
        self.world.setTimeStep(STEP)
        self.world.setGravity(np.array([0.0, 0.0, -9.81 if gravity else 0.0]))
        self.robot = dart.utils.DartLoader().parseSkeleton(str(folder / 'gazebo.urdf'))
        self.world.addSkeleton(self.robot)
        self.at = [self.robot.getJoint(name).getIndexInSkeleton(0) for name in joints]

    def put(self, position, velocity, torque):
        for values, write in (
            (position, self.robot.setPositions),
            (velocity, self.robot.setVelocities),
            (torque, self.robot.setForces),
        ):
            whole = np.zeros(self.robot.getNumDofs())
            whole[self.at] = values
            write(whole)

    def acceleration(self, position, velocity, torque):
        self.put(position, velocity, torque)
        self.world.setTimeStep(SHORT)
        self.world.step()
        return (self.robot.getVelocities()[self.at] - velocity) / SHORT

    def motion(self, position, velocity, seconds):
        self.put(position, velocity, 0.0)
        for _ in range(round(seconds / STEP)):
            self.world.step()
        return self.robot.getPositions()[self.at]

    def limits(self):
        return [self.robot.getDof(n).getForceUpperLimit() for n in self.at]


answer('dartpy', Run)
