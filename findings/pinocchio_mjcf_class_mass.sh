#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Pinocchio takes a geom of an MJCF for one of 1000 kg/m^3 where its class of defaults states a mass.
#
# pinocchio 4.1.0 (`pin`), buildModelFromMJCF, beside MuJoCo 4.0.0 on the same text: a ball of
# 0.1 m whose mass a class of defaults states, named by the geom, by `childclass` of its body, or
# the one for all. Type, size and density are taken from the class, the mass is not: what a user
# stated in kg weighs by its volume. dm_control's cart-pole has 7.7 kg in place of 1.1. Neither an
# error nor a warning.
#
# Source: https://mujoco.readthedocs.io/en/stable/XMLreference.html#default (all attributes of a
# geom can be defaults); dm_control 1.0.50, suite/cartpole.xml, the class "pole" of mass 0.1.
#
# Output seen:
#   mass at the geom: pinocchio 3.000 kg, MuJoCo 3.000 kg
#   mass of its class: pinocchio 4.189 kg, MuJoCo 3.000 kg
#   mass of its body's childclass: pinocchio 4.189 kg, MuJoCo 3.000 kg
#   mass of all: pinocchio 4.189 kg, MuJoCo 3.000 kg
#   density of all: pinocchio 2.094 kg, MuJoCo 2.094 kg
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet pin==4.1.0 mujoco==4.0.0 numpy==2.2.6
cat > "$folder/classes.py" << 'END'
import sys

import mujoco
import numpy as np
import pinocchio as pin

XML = """<mujoco><default><geom type="sphere" size="0.1" {}/>
  <default class="heavy"><geom mass="3"/></default></default>
<worldbody><body name="base"><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>
  <body name="arm" {}><joint name="j" axis="0 1 0"/><geom pos="0.3 0 0" {}/></body></body>
</worldbody></mujoco>"""

for title, parts, seen, own in (
    ('mass at the geom', ('', '', 'mass="3"'), 3.0, 3.0),
    ('mass of its class', ('', '', 'class="heavy"'), 4.189, 3.0),
    ("mass of its body's childclass", ('', 'childclass="heavy"', ''), 4.189, 3.0),
    ('mass of all', ('mass="3"', '', ''), 4.189, 3.0),
    ('density of all', ('density="500"', '', ''), 2.094, 2.094),
):
    path = sys.argv[1] + '/arm.xml'
    with open(path, 'w') as file:
        file.write(XML.format(*parts))
    model, whole = pin.buildModelFromMJCF(path), mujoco.MjModel.from_xml_path(path)
    found = model.inertias[1].mass, whole.body('arm').mass[0]
    print(f'{title}: pinocchio {found[0]:.3f} kg, MuJoCo {found[1]:.3f} kg')
    assert np.allclose(found, (seen, own), atol=1e-3), found
END
"$folder/env/bin/python" "$folder/classes.py" "$folder"
