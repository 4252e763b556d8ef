#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# SAPIEN drops a URDF's joint friction, and brakes each joint with a twentieth of its load instead.
#
# sapien 3.0.3, the wheel of a turntable: 10 kg on a vertical axis, 10 rad/s, 0.1 s, links' damping
# off. `<dynamics friction>` of 0, 0.5 and 5 N m give the same 5.4 N m, which falls with the mass
# on the axis. The loader reads `friction` and hands it on; the builder takes the damping alone;
# what is left is 0.05, PhysX's own coefficient: unitless, a share of the force and torque that the
# joint carries. So a URDF that says "no friction" brakes with 5.4 N m, and the Coulomb friction
# that somebody identifies from SAPIEN's log is one that depends on the payload and on gravity.
#
# Source: https://wiki.ros.org/urdf/XML/joint (friction: "static friction value of the joint", in N
# m); sapien/wrapper/urdf_loader.py, lines 504 to 508, reads it; articulation_builder.py, line 132
# (`set_drive_property(0, b.joint_record.damping)`), does not use it. PhysX of its coefficient:
# "unitless and relates the magnitude of the spatial force ... to the maximal friction force".
#
# Output seen:
#   10 kg, friction 0 N m in the URDF: SAPIEN 0.05, brakes 5.40 N m
#   10 kg, friction 0.5 N m in the URDF: SAPIEN 0.05, brakes 5.40 N m
#   10 kg, friction 5 N m in the URDF: SAPIEN 0.05, brakes 5.40 N m
#   1 kg, friction 5 N m in the URDF: SAPIEN 0.05, brakes 0.54 N m
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet sapien==3.0.3 numpy==2.2.6
cat > "$folder/friction.py" << 'END'
import sys

import numpy as np
import sapien

URDF = """<robot name="table"><link name="base"/><link name="plate"><inertial><mass value="{}"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<joint name="j" type="revolute"><parent link="base"/><child link="plate"/><axis xyz="0 0 1"/>
<limit lower="-99" upper="99" effort="99" velocity="99"/>
<dynamics damping="0" friction="{}"/></joint></robot>"""
INERTIA, SPEED, STEP, STEPS = 0.1, 10.0, 1e-3, 100

seen = []
for mass, friction in ((10, 0), (10, 0.5), (10, 5), (1, 5)):
    path = sys.argv[1] + '/table.urdf'
    with open(path, 'w') as file:
        file.write(URDF.format(mass, friction))
    scene = sapien.Scene([sapien.physx.PhysxCpuSystem()])
    scene.set_timestep(STEP)
    loader = scene.create_urdf_loader()
    loader.fix_root_link = True
    robot = loader.load(path)
    for link in robot.links:
        link.linear_damping = link.angular_damping = 0.0
    robot.set_qvel(np.array([SPEED]))
    for _ in range(STEPS):
        scene.step()
    torque = INERTIA * (SPEED - robot.qvel[0]) / (STEP * STEPS)
    coefficient = robot.active_joints[0].friction
    seen.append((coefficient, torque))
    print(f'{mass} kg, friction {friction:g} N m in the URDF: SAPIEN {coefficient:.2f}, '
          f'brakes {torque:.2f} N m')
assert np.allclose([x for x, _ in seen], 0.05), seen
assert np.allclose([x for _, x in seen], [5.4, 5.4, 5.4, 0.54], rtol=0.02), seen
END
"$folder/env/bin/python" -W ignore "$folder/friction.py" "$folder"
