# SPDX-License-Identifier: Apache-2.0
"""Drake: derivatives and motion, in continuous time where it can."""

import xml.etree.ElementTree as ET

from common import answer, Simulation
import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder


class Run(Simulation):
    """The URDF, its base held."""

    def __init__(self, folder, joints, gravity):
        builder = DiagramBuilder()
        # Joints that follow others are coupled in discrete time only.
        step = 1e-4 if '<mimic' in (folder / 'drake.urdf').read_text() else 0.0
        self.plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=step)
        (number,) = Parser(builder).AddModels(str(folder / 'drake.urdf'))
        root = ET.parse(folder / 'drake.urdf').getroot()
        carried = {joint.find('child').get('link') for joint in root.iterfind('joint')}
        (base,) = {link.get('name') for link in root.iterfind('link')} - carried
        if base != 'world':
            own = self.plant.GetBodyByName(base, number)
            self.plant.WeldFrames(self.plant.world_frame(), own.body_frame())
        if not gravity:
            self.plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
        self.plant.Finalize()
        self.diagram = builder.Build()
        whole = self.diagram.CreateDefaultContext()
        self.whole, self.context = whole, self.plant.GetMyMutableContextFromRoot(whole)
        found = [self.plant.GetJointByName(name) for name in joints]
        self.q = [joint.position_start() for joint in found]
        self.v = [joint.velocity_start() for joint in found]
        self.force = self.plant.get_applied_generalized_force_input_port()
        self.actuators = self.plant.get_actuation_input_port()
        self.actuators.FixValue(self.context, np.zeros(self.plant.num_actuators()))

    def acceleration(self, position, velocity, torque):
        q, v = (np.zeros(self.plant.num_velocities()) for _ in range(2))
        q[self.q], v[self.v] = position, velocity
        self.plant.SetPositions(self.context, q)
        self.plant.SetVelocities(self.context, v)
        applied = np.zeros(self.plant.num_velocities())
        applied[self.v] = torque
        self.force.FixValue(self.context, applied)
        rates = self.plant.EvalTimeDerivatives(self.context).CopyToVector()
        return rates[self.plant.num_positions() :][self.v]

    def motion(self, position, velocity, seconds):
        q, v = (np.zeros(self.plant.num_velocities()) for _ in range(2))
        q[self.q], v[self.v] = position, velocity
        self.plant.SetPositions(self.context, q)
        self.plant.SetVelocities(self.context, v)
        self.force.FixValue(self.context, np.zeros(self.plant.num_velocities()))
        Simulator(self.diagram, self.whole).AdvanceTo(seconds)
        return self.plant.GetPositions(self.context)[self.q]

    def limits(self):
        every = [self.plant.get_joint_actuator(n) for n in self.plant.GetJointActuatorIndices()]
        limit = {own.joint().velocity_start(): own.effort_limit() for own in every}
        return [limit[v] for v in self.v]


answer('drake', Run)
