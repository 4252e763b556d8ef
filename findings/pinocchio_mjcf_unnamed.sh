#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Pinocchio loses a body of an MJCF that has no name and carries another one, and its joint.
#
# pinocchio 4.1.0 (`pin`), buildModelFromMJCF, beside MuJoCo 4.0.0 on the same text: two links of 2
# and 1 kg, one behind the other. Names of bodies are optional in MJCF. Where the first link has
# none, pinocchio's arm has one joint and 1 kg in place of two and 3 kg; where the last has none,
# both are there. Neither an error nor a warning.
#
# Source: https://mujoco.readthedocs.io/en/stable/XMLreference.html#body (name: string, optional).
#
# Output seen:
#   both have a name: pinocchio one, two of 3.0 kg, MuJoCo one, two of 3.0 kg
#   the last has none: pinocchio one, two of 3.0 kg, MuJoCo one, two of 3.0 kg
#   the first has none: pinocchio two of 1.0 kg, MuJoCo one, two of 3.0 kg
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet pin==4.1.0 mujoco==4.0.0 numpy==2.2.6
cat > "$folder/names.py" << 'END'
import sys

import mujoco
import pinocchio as pin

XML = """<mujoco><worldbody>
  <body {}><joint name="one" axis="0 1 0"/>
    <inertial mass="2" pos="0.2 0 0" diaginertia="0.01 0.01 0.01"/>
    <body {} pos="0.4 0 0"><joint name="two" axis="0 1 0"/>
      <inertial mass="1" pos="0.2 0 0" diaginertia="0.01 0.01 0.01"/></body></body>
</worldbody></mujoco>"""
BOTH = 'one, two of 3.0 kg'

for title, first, last, seen in (
    ('both have a name', 'name="a"', 'name="b"', BOTH),
    ('the last has none', 'name="a"', '', BOTH),
    ('the first has none', '', 'name="b"', 'two of 1.0 kg'),
):
    path = sys.argv[1] + '/arm.xml'
    with open(path, 'w') as file:
        file.write(XML.format(first, last))
    model, whole = pin.buildModelFromMJCF(path), mujoco.MjModel.from_xml_path(path)
    joints = [whole.joint(k).name for k in range(whole.njnt)]
    found = f'{", ".join(list(model.names)[1:])} of {sum(x.mass for x in model.inertias):.1f} kg'
    other = f'{", ".join(joints)} of {whole.body_mass.sum():.1f} kg'
    print(f'{title}: pinocchio {found}, MuJoCo {other}')
    assert (found, other) == (seen, BOTH)
END
"$folder/env/bin/python" "$folder/names.py" "$folder"
