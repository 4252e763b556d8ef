#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Genesis gives each joint of a URDF a rotor of 0.1 kg m^2, for which URDF has no word.
#
# genesis-world 1.4.5, a wrist of 0.01 kg m^2 about a vertical axis, as in small arms, pushed by
# 0.01 N m: it should speed up by 1 rad/s^2 and does by 0.0909, as if it had 0.11 kg m^2. The
# loader says nothing. `default_armature=0.0` gives 1 rad/s^2; `set_dofs_armature` acts as well.
# So gains tuned there are for another arm, and a log made there identifies eleven times the
# inertia about the wrist.
#
# Source: https://wiki.ros.org/urdf/XML/joint (no element for the inertia of a rotor). Genesis says
# so in genesis/options/morphs.py, lines 1125 to 1129: "It applies to every revolute or prismatic
# joint moving a link on its own whose armature the model file leaves at zero ..., at the cost of
# inertia the real actuator may lack, which slows every such joint down."
#
# Output seen:
#   as it is: 0.0909 rad/s^2 for 0.01 N m, 0.1100 kg m^2
#   default_armature=0.0: 1.0000 rad/s^2 for 0.01 N m, 0.0100 kg m^2
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet genesis-world==1.4.5 torch
cat > "$folder/armature.py" << 'END'
import sys

import genesis as gs
import numpy as np

URDF = """<robot name="wrist"><link name="base"/><link name="hand"><inertial><mass value="1"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
<joint name="j" type="revolute"><parent link="base"/><child link="hand"/><axis xyz="0 0 1"/>
<limit lower="-9" upper="9" effort="9" velocity="9"/></joint></robot>"""
TORQUE, STEP, STEPS = 0.01, 1e-3, 100

path = sys.argv[1] + '/wrist.urdf'
with open(path, 'w') as file:
    file.write(URDF)
gs.init(backend=gs.cpu, precision='64', logging_level='error')
seen = []
for name, options in (('as it is', {}), ('default_armature=0.0', {'default_armature': 0.0})):
    scene = gs.Scene(sim_options=gs.options.SimOptions(dt=STEP), show_viewer=False)
    robot = scene.add_entity(gs.morphs.URDF(file=path, fixed=True, **options))
    scene.build()
    robot.set_dofs_kp([0.0])
    robot.set_dofs_kv([0.0])
    robot.control_dofs_force(np.array([TORQUE]))
    for _ in range(STEPS):
        scene.step()
    seen.append(float(robot.get_dofs_velocity()[0]) / (STEP * STEPS))
    print(f'{name}: {seen[-1]:.4f} rad/s^2 for {TORQUE} N m, {TORQUE / seen[-1]:.4f} kg m^2')
assert np.allclose(seen, [1.0 / 11.0, 1.0], rtol=1e-3), seen
END
"$folder/env/bin/python" -W ignore "$folder/armature.py" "$folder"
