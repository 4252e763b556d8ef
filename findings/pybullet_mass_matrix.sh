#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# PyBullet's calculateMassMatrix refuses links from about 30 kg m^2 on, as inertias without symmetry.
#
# pybullet 3.2.7, URDF_USE_INERTIA_FROM_FILE. "invalid inertia tensor body 1 I(1,2)!=I(2,1).
# I(1,2)-I(2,1)= 7.105427e-15" (IDMath.cpp, line 438): it keeps principal axes, and turning them back
# into the joint's frame rounds. The same link, ten times lighter, has a mass matrix.
# calculateInverseDynamics refuses it likewise; simulation does not mind.
#
# Source: a URDF's inertia has six numbers, and no place for anything without symmetry.
#
# Output seen:
#   13 kg m^2: mass matrix 24.00, torque 24.00
#   130 kg m^2: mass matrix SystemError, torque SystemError
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet pybullet==3.2.7 numpy==2.2.6
cat > "$folder/mass.py" << 'END'
import sys

import pybullet

URDF = """<robot name="arm"><link name="base"/><link name="arm">
<inertial><origin xyz="0.1 0.2 0.3"/><mass value="{0}"/><inertia ixx="{1}" ixy="{2}" ixz="{3}"
iyy="{4}" iyz="{5}" izz="{6}"/></inertial></link><joint name="j" type="continuous">
<parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint></robot>"""
ONE = 10.0, 1.3, 0.11, -0.17, 1.7, 0.13, 1.9


def tried(call):
    try:
        return call()
    except (SystemError, pybullet.error) as error:
        return type(error).__name__


pybullet.connect(pybullet.DIRECT)
pybullet.setGravity(0, 0, 0)
seen = []
for size in (10.0, 100.0):
    path = f'{sys.argv[1]}/{size}.urdf'
    with open(path, 'w') as file:
        file.write(URDF.format(*(size * x for x in ONE)))
    arm = pybullet.loadURDF(
        path, flags=pybullet.URDF_USE_INERTIA_FROM_FILE, useFixedBase=True
    )
    mass = tried(lambda: pybullet.calculateMassMatrix(arm, [0.0])[0][0])
    torque = tried(lambda: pybullet.calculateInverseDynamics(arm, [0.0], [0.0], [1.0])[0])
    seen.append((mass, torque))
    mass, torque = (f'{x:.2f}' if isinstance(x, float) else x for x in seen[-1])
    print(f'\n{1.3 * size:.0f} kg m^2: mass matrix {mass}, torque {torque}')
assert abs(seen[0][0] - 24.0) < 1e-6 and isinstance(seen[1][0], str)
END
"$folder/env/bin/python" "$folder/mass.py" "$folder" | grep " kg m^2: "
