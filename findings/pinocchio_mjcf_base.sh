#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Pinocchio reads an MJCF whose arm stands on a turned base as if the base were upright.
#
# pinocchio 4.1.0 (`pin`), buildModelFromMJCF, beside MuJoCo 4.0.0 on the same text. The first body
# of the worldbody, where it has no joint, becomes the root frame "universe" without its pos and
# euler: a joint that MuJoCo holds level in space lies upright, and gravity asks for nothing where
# MuJoCo asks for m g l. A second body beside it is not in the model at all. Neither an error nor a
# warning. With one more body about all of them the answers agree. Axes that are no unit vectors in
# `axisangle` become matrices that are no rotations; MuJoCo normalises them.
#
# Source: https://mujoco.readthedocs.io/en/stable/XMLreference.html#body ("pos", "quat, axisangle,
# xyaxes, zaxis, euler": position and orientation of the body frame in the parent's; coordinate
# frames are "normalized" where they are not).
#
# Output seen:
#   as written: pinocchio 0.0000 N m, MuJoCo 5.8860 N m; joints of the second arm in pinocchio: 0
#   one body about all: pinocchio 5.8860 N m, MuJoCo 5.8860 N m; joints of the second arm in
#     pinocchio: 1
#   axisangle 1 1 0 30: R R^T is the unit matrix to 0.51 in pinocchio, to 0.00 in MuJoCo
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet pin==4.1.0 mujoco==4.0.0 numpy==2.2.6
cat > "$folder/base.py" << 'END'
import sys

import mujoco
import numpy as np
import pinocchio as pin

MASS = '<inertial mass="3" pos="0.2 0 0" diaginertia="0.1 0.1 0.1"/>'
ARM = f'<body name="{{0}}"{{1}}><joint name="{{0}}" axis="0 0 1"/>{MASS}</body>'
BASE = f'<body name="base" euler="90 0 0">{MASS}' + ARM.format('lies', '') + '</body>'
OTHER = ARM.format('other', ' pos="1 0 0"')
XML = '<mujoco><compiler angle="degree"/><worldbody>{}</worldbody></mujoco>'


def both(text):
    path = sys.argv[1] + '/arm.xml'
    with open(path, 'w') as file:
        file.write(text)
    own = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(own)
    mujoco.mj_forward(own, data)
    return pin.buildModelFromMJCF(path), own, data


seen = []
for name, text in (
    ('as written', BASE + OTHER),
    ('one body about all', '<body name="all">' + BASE + OTHER + '</body>'),
):
    model, own, data = both(XML.format(text))
    weight = pin.computeGeneralizedGravity(model, model.createData(), pin.neutral(model))[0]
    there = int(model.existJointName('other'))
    seen.append((abs(weight), data.qfrc_bias[own.joint('lies').dofadr[0]], there))
    print(f'{name}: pinocchio {abs(weight):.4f} N m, MuJoCo {abs(seen[-1][1]):.4f} N m; '
          f'joints of the second arm in pinocchio: {there}')
model, own, data = both(XML.format(
    '<body name="all">' + ARM.format('lies', ' axisangle="1 1 0 30"') + '</body>'))
turns = model.jointPlacements[1].rotation, data.body('lies').xmat.reshape(3, 3)
off = [np.abs(turn @ turn.T - np.eye(3)).max() for turn in turns]
print(f'axisangle 1 1 0 30: R R^T is the unit matrix to {off[0]:.2f} in pinocchio, '
      f'to {off[1]:.2f} in MuJoCo')
assert seen[0][0] < 1e-9 and not seen[0][2] and seen[1][2]
assert abs(abs(seen[0][1]) - 5.886) < 1e-9 and abs(seen[1][0] - 5.886) < 1e-9
assert off[0] > 0.1 and off[1] < 1e-9
END
"$folder/env/bin/python" "$folder/base.py" "$folder"
