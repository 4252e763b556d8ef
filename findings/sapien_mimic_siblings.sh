#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# In SAPIEN a joint that mimics its sibling twice as fast turns half as fast, the offset astray.
#
# sapien 3.0.3, a URDF with `<mimic joint="leader" multiplier="2" offset="0.3"/>`. Where the two
# start at one link, as a gripper's fingers do, the loader holds leader = 2 follower + 0.3 in place
# of follower = 2 leader + 0.3; with multiplier 1 and no offset it is the same. Where the follower
# stands on the leader's link the ratio is right and the load is not: 0.1 N m on the leader gives
# 0.40 rad/s^2, where the inertias of 0.1 kg m^2, the second one turning by three times the
# leader's angle, let it have 0.1 / (0.1 + 0.1 x 3^2) = 0.10. Whoever identifies such a finger
# from SAPIEN's log finds a quarter of its inertia.
#
# Source: https://wiki.ros.org/urdf/XML/joint ("value = multiplier * other_joint_value + offset");
# the inversion is https://github.com/haosulab/SAPIEN/pull/297, open, which takes the other case
# for sound; sapien/wrapper/articulation_builder.py, lines 164 to 193, one set of coefficients for
# the links in two orders.
#
# Output seen:
#   siblings: leader -1.290, follower -0.795 rad; 2 x follower + 0.3 = -1.290
#   chain: leader 0.200, follower 0.700 rad; 2 x leader + 0.3 = 0.700
#   chain: 0.40 rad/s^2 by 0.1 N m, due are 0.10
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet sapien==3.0.3 numpy==2.2.6
cat > "$folder/mimic.py" << 'END'
import sys

import numpy as np
import sapien

LINK = """<link name="{}"><inertial><mass value="1"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1"
iyz="0" izz="0.1"/></inertial></link>"""
JOINT = """<joint name="{}" type="revolute"><parent link="{}"/><child link="{}"/>
<axis xyz="0 0 1"/><limit lower="-99" upper="99" effort="99" velocity="99"/>{}</joint>"""
MIMIC = '<mimic joint="leader" multiplier="2" offset="0.3"/>'


def run(parent):
    path = sys.argv[1] + '/robot.urdf'
    with open(path, 'w') as file:
        file.write('<robot name="r"><link name="base"/>' + LINK.format('one') + LINK.format('two')
                   + JOINT.format('leader', 'base', 'one', '')
                   + JOINT.format('follower', parent, 'two', MIMIC) + '</robot>')
    scene = sapien.Scene([sapien.physx.PhysxCpuSystem()])
    scene.set_timestep(1e-3)
    loader = scene.create_urdf_loader()
    loader.fix_root_link = True
    robot = loader.load(path)
    for joint in robot.active_joints:
        joint.friction = 0.0
    for link in robot.links:
        link.linear_damping = link.angular_damping = 0.0
    at = [[x.name for x in robot.active_joints].index(x) for x in ('leader', 'follower')]
    robot.set_qpos(np.array([0.0, 0.3])[np.argsort(at)])
    for _ in range(1000):
        robot.set_qf(np.array([0.1, 0.0])[np.argsort(at)])
        scene.step()
    return *(float(robot.qpos[n]) for n in at), float(robot.qvel[at[0]])


one, two, _ = run('base')
print(f'siblings: leader {one:.3f}, follower {two:.3f} rad; 2 x follower + 0.3 = {2*two+0.3:.3f}')
assert abs(one - (2 * two + 0.3)) < 1e-3 and abs(two - (2 * one + 0.3)) > 0.5
one, two, speed = run('one')
print(f'chain: leader {one:.3f}, follower {two:.3f} rad; 2 x leader + 0.3 = {2*one+0.3:.3f}')
print(f'chain: {speed:.2f} rad/s^2 by 0.1 N m, due are 0.10')
assert abs(two - (2 * one + 0.3)) < 1e-3 and abs(speed - 0.4) < 0.01
END
"$folder/env/bin/python" -W ignore "$folder/mimic.py" "$folder"
