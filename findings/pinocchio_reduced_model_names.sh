#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Pinocchio cannot lock a joint whose name a link has as well, though it reads and simulates it.
#
# pinocchio 4.1.0 (`pin`), buildModelFromXML and buildReducedModel: two links in a chain. Joints and
# links of a URDF may have the same names. Such an arm is read, and its efforts are those of the arm
# with other names; the outer joint can be locked. Locking the inner one, whose child link has its
# name and carries the other joint, is refused: frames are looked for by their name alone. Giving
# the link's frame another name in the model helps.
#
# Source: http://wiki.ros.org/urdf/XML/joint and /link (name: unique, each among its own kind).
#
# Output seen:
#   link "arm": locked "elbow": 1 joint, locked "shoulder": 1 joint
#   link "shoulder": locked "elbow": 1 joint, locked "shoulder": Several frames match the filter
#   link "shoulder", its frame renamed: locked "elbow": 1 joint, locked "shoulder": 1 joint
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet pin==4.1.0 numpy==2.2.6
cat > "$folder/locked.py" << 'END'
import numpy as np
import pinocchio as pin

BODY = (
    '<inertial><origin xyz="0.2 0 0"/><mass value="1"/>'
    '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
)
LIMIT = '<limit lower="-1" upper="1" effort="9" velocity="9"/>'
ARM = (
    '<robot name="arm"><link name="base"/><link name="{0}">' + BODY + '</link>'
    '<link name="hand">' + BODY + '</link>'
    '<joint name="shoulder" type="revolute"><axis xyz="0 1 0"/>' + LIMIT +
    '<parent link="base"/><child link="{0}"/></joint>'
    '<joint name="elbow" type="revolute"><axis xyz="0 1 0"/>' + LIMIT + '<origin xyz="0.4 0 0"/>'
    '<parent link="{0}"/><child link="hand"/></joint></robot>'
)


def locked(model, joint):
    try:
        reduced = pin.buildReducedModel(model, [model.getJointId(joint)], pin.neutral(model))
    except ValueError as error:
        return str(error).partition(' - ')[0]
    return f'{reduced.njoints - 1} joint'


efforts = []
for title, link, renamed, seen in (
    ('link "arm"', 'arm', False, '1 joint'),
    ('link "shoulder"', 'shoulder', False, 'Several frames match the filter'),
    ('link "shoulder", its frame renamed', 'shoulder', True, '1 joint'),
):
    model = pin.buildModelFromXML(ARM.format(link))
    for frame in model.frames if renamed else ():
        if frame.type == pin.FrameType.BODY:
            frame.name = f'link {frame.name}'
    efforts.append(pin.rnea(model, model.createData(), np.array([0.3, 0.5]), *np.ones((2, 2))))
    found = [locked(model, joint) for joint in ('elbow', 'shoulder')]
    print(f'{title}: locked "elbow": {found[0]}, locked "shoulder": {found[1]}')
    assert found == ['1 joint', seen]
assert np.ptp(efforts, axis=0).max() == 0.0
END
"$folder/env/bin/python" "$folder/locked.py"
