# SPDX-License-Identifier: Apache-2.0
"""Isaac Lab: its own class takes the arguments; nothing is simulated."""

from common import answer, Simulation
from isaaclab.actuators import ImplicitActuatorCfg
import yaml


class Run(Simulation):
    """The actuators' configuration."""

    def __init__(self, folder, joints, gravity):
        self.config = ImplicitActuatorCfg(**yaml.safe_load((folder / 'isaac.yaml').read_text()))
        self.config.validate()
        self.joints = joints

    def limits(self):
        return [self.config.joint_effort_limit[name] for name in self.joints]


answer('isaaclab', Run)
