# SPDX-License-Identifier: Apache-2.0
"""Genesis: single steps, and motion in steps, on the processor."""

from common import answer, exported, Simulation
import genesis as gs

STEP = 1e-3
gs.init(backend=gs.cpu, precision='64', logging_level='warning')


class Run(Simulation):
    """As its loader makes it."""

    def __init__(self, folder, joints, gravity):
        scene = gs.Scene(
            sim_options=gs.options.SimOptions(
                dt=STEP, gravity=(0.0, 0.0, -9.81 if gravity else 0.0)
            ),
            show_viewer=False,
        )
        loaded = self.loaded = exported(folder, 'genesis')
        self.robot = loaded.add(scene)
        scene.build()
        loaded.set_up(self.robot)
        self.scene = scene
        self.at = [int(self.robot.get_joint(name).dofs_idx_local[0]) for name in joints]

    def put(self, position, velocity):
        self.robot.set_dofs_position(position, self.at)
        self.robot.set_dofs_velocity(velocity, self.at)

    def step(self, torque):
        self.robot.control_dofs_force(self.loaded.effort(self.robot)[self.at] + torque, self.at)
        self.scene.step()

    def acceleration(self, position, velocity, torque):
        self.put(position, velocity)
        self.step(torque)
        return (self.robot.get_dofs_velocity(self.at).numpy() - velocity) / STEP

    def motion(self, position, velocity, seconds):
        self.put(position, velocity)
        for _ in range(round(seconds / STEP)):
            self.step(0.0)
        return self.robot.get_dofs_position(self.at).numpy()

    def limits(self):
        return self.robot.get_dofs_force_range(self.at)[1].numpy()


answer('genesis-world', Run)
