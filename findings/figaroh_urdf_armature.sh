#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# FIGAROH writes an identified armature into a URDF where neither Pinocchio nor MuJoCo looks for it.
#
# figaroh 1.0.2, export_urdf, with pinocchio 4.1.0 (`pin`) and MuJoCo 4.0.0, its two backends. Of a
# joint's identified friction (`fv_`, `fs_`) and armature (`Ia_`) it makes `<dynamics damping
# friction armature>`. URDF has no such attribute: both read damping and friction from the exported
# file and an armature of 0. An arm of 0.2 kg m^2 with 0.5 kg m^2 of motor and gears so turns with
# 0.2 and accelerates 3.5 times too fast, while its friction is right. Neither the exporter nor a
# reader says a word, where the exporter refuses what it does not know and what fits no joint.
#
# Source: https://wiki.ros.org/urdf/XML/joint (dynamics: damping and friction).
# figaroh/tools/urdf_exporter.py counts "Armature (absolute): Ia_{joint}" among the parameters that
# are "auto-applied to the URDF"; that "URDF parsers ignore" the attribute is said of `elasticity`
# alone, as in
# https://github.com/thanhndv212/figaroh-plus/blob/main/docs/decisions/urdf_exporter.md
#
# Output seen:
#   exported: damping 0.7, friction 0.4, armature 0.5
#   Pinocchio: damping 0.7, friction 0.4, armature 0; inertia of the joint 0.20 for 0.70 kg m^2
#   MuJoCo: damping 0.7, friction 0.4, armature 0; inertia of the joint 0.20 for 0.70 kg m^2
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet figaroh==1.0.2 pin==4.1.0 mujoco==4.0.0 numpy==2.2.6
cat > "$folder/armature.py" << 'END'
import sys
import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pinocchio as pin
from figaroh.tools.urdf_exporter import export_urdf

URDF = """<robot name="arm"><link name="base"/><link name="arm"><inertial>
<origin xyz="0.3 0 0"/><mass value="2"/><inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0"
izz="0.02"/></inertial></link><joint name="j" type="revolute"><parent link="base"/>
<child link="arm"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="10" velocity="3"/>
</joint></robot>"""
IDENTIFIED = {'fv_j': 0.7, 'fs_j': 0.4, 'Ia_j': 0.5}
LINK = 0.02 + 2 * 0.3**2

path = sys.argv[1] + '/arm.urdf'
with open(path, 'w') as file:
    file.write(URDF)
path = export_urdf(path, IDENTIFIED)
written = ET.parse(path).find('joint/dynamics').attrib
print('exported: ' + ', '.join(f'{name} {value}' for name, value in written.items()))
assert float(written['armature']) == IDENTIFIED['Ia_j'], written

model = pin.buildModelFromUrdf(path)
inertia = pin.crba(model, model.createData(), pin.neutral(model))[0, 0]
other = mujoco.MjModel.from_xml_path(path)
data = mujoco.MjData(other)
mujoco.mj_forward(other, data)
unit = np.zeros(1)
mujoco.mj_mulM(other, data, unit, np.ones(1))
for reader, damping, friction, armature, seen in (
    ('Pinocchio', model.damping[0], model.friction[0], model.armature[0], inertia),
    ('MuJoCo', other.dof_damping[0], other.dof_frictionloss[0], other.dof_armature[0], unit[0]),
):
    print(f'{reader}: damping {damping:g}, friction {friction:g}, armature {armature:g}; inertia '
          f'of the joint {seen:.2f} for {LINK + IDENTIFIED["Ia_j"]:.2f} kg m^2')
    assert np.allclose((damping, friction), (0.7, 0.4)), (damping, friction)
    assert armature == 0.0 and np.isclose(seen, LINK), (armature, seen)
END
"$folder/env/bin/python" -W ignore "$folder/armature.py" "$folder"
