#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Robotics Toolbox takes a URDF's Coulomb friction for the viscous one, and drops the viscous one.
#
# roboticstoolbox-python 1.5.0, `<dynamics damping="0.7" friction="0.5"/>`. The link gets
# B = 0.5 N m s/rad and Tc = 0: at 2 rad/s rne() asks for 1.0 N m where the URDF means
# 0.5 + 0.7 x 2 = 1.9, at 0.1 rad/s for 0.05 where it means 0.57. It looks like friction, so that
# a log beside it seems sound at high speed; at low speed the torque is a tenth of the true one.
# `damping` is read into the URDF's tree and used nowhere: with damping alone there is no friction.
#
# Source: https://wiki.ros.org/urdf/XML/joint (damping: N m s/rad; friction: "static friction
# value", N m); roboticstoolbox/models/URDF/URDFRobot.py, line 463 (`childlink.B =
# joint.dynamics.friction`); roboticstoolbox/robot/Link.py: B is "motor viscous friction", Tc
# "motor Coulomb friction".
#
# Output seen:
#   damping 0.7, friction 0.5: B 0.5, Tc 0
#   at 2 rad/s: 1.00 N m, the URDF means 1.90
#   at 0.1 rad/s: 0.05 N m, the URDF means 0.57
#   damping 0.7 alone, at 2 rad/s: 0.00 N m, the URDF means 1.40
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet roboticstoolbox-python==1.5.0 numpy==2.2.6
cat > "$folder/friction.py" << 'END'
import sys

import numpy as np
from roboticstoolbox import Robot

URDF = """<robot name="table"><link name="base"/><link name="plate"><inertial><mass value="1"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<joint name="j" type="revolute"><parent link="base"/><child link="plate"/><axis xyz="0 0 1"/>
<limit lower="-9" upper="9" effort="9" velocity="9"/><dynamics {}/></joint></robot>"""


def loaded(dynamics):
    path = sys.argv[1] + '/table.urdf'
    with open(path, 'w') as file:
        file.write(URDF.format(dynamics))
    return Robot.URDF(path)


def torque(robot, speed):
    return float(robot.rne(np.zeros(1), np.array([speed]), np.zeros(1))[0])


robot = loaded('damping="0.7" friction="0.5"')
link = robot.links[-1]
print(f'damping 0.7, friction 0.5: B {link.B:g}, Tc {np.abs(link.Tc).max():g}')
assert link.B == 0.5 and not np.any(link.Tc)
for speed in (2.0, 0.1):
    seen = torque(robot, speed)
    print(f'at {speed:g} rad/s: {seen:.2f} N m, the URDF means {0.5 + 0.7 * speed:.2f}')
    assert abs(seen - 0.5 * speed) < 1e-9
seen = torque(loaded('damping="0.7"'), 2.0)
print(f'damping 0.7 alone, at 2 rad/s: {seen:.2f} N m, the URDF means 1.40')
assert abs(seen) < 1e-9
END
"$folder/env/bin/python" -W ignore "$folder/friction.py" "$folder"
