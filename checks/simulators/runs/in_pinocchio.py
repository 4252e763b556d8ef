# SPDX-License-Identifier: Apache-2.0
"""pinocchio: a library of algorithms, which moves nothing by itself."""

from common import answer, exported, Simulation
import numpy as np
import pinocchio


class Run(Simulation):
    """The URDF, and what its loader keeps."""

    def __init__(self, folder, joints, gravity):
        self.loaded = exported(folder, 'pinocchio')
        self.model = self.loaded.load()
        self.data = self.model.createData()
        self.joints = [self.model.joints[self.model.getJointId(name)] for name in joints]

    def torque(self, position, velocity, acceleration, guess):
        model = self.model
        q, v, a = pinocchio.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
        for d, joint in enumerate(self.joints):
            whole = joint.nq == 1
            angle = [position[d]] if whole else [np.cos(position[d]), np.sin(position[d])]
            q[joint.idx_q : joint.idx_q + joint.nq] = angle
            v[joint.idx_v], a[joint.idx_v] = velocity[d], acceleration[d]
        torque = self.loaded.torque(model, self.data, q, v, a)
        return torque[[joint.idx_v for joint in self.joints]]

    def limits(self):
        return self.model.effortLimit[[joint.idx_v for joint in self.joints]]


answer('pin', Run)
