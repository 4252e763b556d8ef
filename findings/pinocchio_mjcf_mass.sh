#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Pinocchio leaves out the mass of every geom of an MJCF that collides with nothing.
#
# pinocchio 4.1.0 (`pin`), buildModelFromMJCF, beside MuJoCo 4.0.0 on the same text: a body without
# `inertial`, whose mass is that of its geoms. A geom with contype="0" conaffinity="0" is one for
# the eye to pinocchio and weighs nothing there, even where its `mass` is stated; in MuJoCo these
# two say what may touch, not what weighs. A pendulum whose contacts are off so has 0 kg: it needs
# no torque and has no inertia. Where one geom of two may collide the arm is as heavy as that one.
# Neither an error nor a warning.
#
# Source: https://mujoco.readthedocs.io/en/stable/XMLreference.html#compiler (inertiafromgeom: mass
# and inertia are inferred from the geoms attached to the body; inertiagrouprange: from those of
# groups 0 to 5, all of them, by default). pinocchio 3.7.0, src/parsers/mjcf/mjcf-graph-geom.cpp,
# line 308, calls it VISUAL; mjcf-graph.cpp, line 508, sums up the others' inertias.
#
# Output seen:
#   mass 3 stated, no contacts: pinocchio 0.000 kg and 0.000 N m, MuJoCo 3.000 kg and 8.829 N m
#   by density, no contacts: pinocchio 0.000 kg and 0.000 N m, MuJoCo 4.189 kg and 12.328 N m
#   the rod of two collides: pinocchio 0.500 kg and 0.736 N m, MuJoCo 3.500 kg and 9.565 N m
#   both collide: pinocchio 3.500 kg and 9.565 N m, MuJoCo 3.500 kg and 9.565 N m
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet pin==4.1.0 mujoco==4.0.0 numpy==2.2.6
cat > "$folder/mass.py" << 'END'
import sys

import mujoco
import numpy as np
import pinocchio as pin

XML = """<mujoco><worldbody><body name="base"><inertial mass="1" pos="0 0 0"
diaginertia="1 1 1"/><body name="arm"><joint name="j" axis="0 1 0"/>{}</body></body></worldbody>
</mujoco>"""
BALL = '<geom type="sphere" size="0.1" pos="0.3 0 0" {}/>'
ROD = '<geom type="box" size="0.15 0.01 0.01" pos="0.15 0 0" mass="0.5"/>'
OFF = 'contype="0" conaffinity="0" '

for title, geoms, mass, own in (
    ('mass 3 stated, no contacts', BALL.format(OFF + 'mass="3"'), 0.0, 3.0),
    ('by density, no contacts', BALL.format(OFF), 0.0, 4.18879),
    ('the rod of two collides', ROD + BALL.format(OFF + 'mass="3"'), 0.5, 3.5),
    ('both collide', ROD + BALL.format('mass="3"'), 3.5, 3.5),
):
    path = sys.argv[1] + '/arm.xml'
    with open(path, 'w') as file:
        file.write(XML.format(geoms))
    model, whole = pin.buildModelFromMJCF(path), mujoco.MjModel.from_xml_path(path)
    data = mujoco.MjData(whole)
    mujoco.mj_forward(whole, data)
    weight = pin.computeGeneralizedGravity(model, model.createData(), pin.neutral(model))[0]
    seen = model.inertias[1].mass, whole.body('arm').mass[0]
    print(f'{title}: pinocchio {seen[0]:.3f} kg and {abs(weight):.3f} N m, '
          f'MuJoCo {seen[1]:.3f} kg and {abs(data.qfrc_bias[0]):.3f} N m')
    assert np.allclose(seen, (mass, own), atol=1e-4), seen
END
"$folder/env/bin/python" "$folder/mass.py" "$folder"
