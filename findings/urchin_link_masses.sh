#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# urchin gives each link without `inertial` 1 kg and 1 kg m^2, and writes them into the URDF.
#
# urchin 0.0.30 (a fork of urdfpy), with pinocchio 4.1.0 (`pin`) as the reader. An arm of 2 kg
# with a flange, a tool frame and a camera frame, which by the specification weigh nothing, is
# loaded and saved, nothing changed: its three frames weigh 3 kg. The same arm needs 4.3 times the
# torque to hold and has 37 times the inertia about its joint. A description that was identified
# and passes through urchin on its way to a simulator is another machine there. No warning.
#
# Source: https://wiki.ros.org/urdf/XML/link (inertial: "optional: defaults to a zero mass and zero
# inertia if not specified"). urchin/link.py, class Link: "inertial : Inertial, optional. The
# inertial properties of the link."; its setter: `Inertial(mass=1.0, inertia=np.eye(3))`.
#
# Output seen:
#   as written: 2.00 kg, 3.92 N m to hold, 0.10 kg m^2
#   loaded and saved: 5.00 kg, 16.68 N m to hold, 3.67 kg m^2
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet urchin==0.0.30 pin==4.1.0 numpy==2.2.6
cat > "$folder/frames.py" << 'END'
import sys

import numpy as np
import pinocchio as pin
from urchin import URDF

FRAME = """<link name="{0}"/><joint name="{0}" type="fixed"><parent link="arm"/><child link="{0}"/>
<origin xyz="{1} 0 0"/></joint>"""
ARM = """<robot name="arm"><link name="base"/><link name="arm"><inertial>
<origin xyz="0.2 0 0"/><mass value="2"/><inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0"
izz="0.02"/></inertial></link><joint name="j" type="revolute"><parent link="base"/>
<child link="arm"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="10" velocity="3"/>
</joint>""" + FRAME.format('flange', 0.4) + FRAME.format('tool', 0.5) + FRAME.format(
    'camera', 0.4) + '</robot>'


def read(path):
    """Return an arm's mass in kg, the torque that holds it in N m and its inertia in kg m^2."""
    model = pin.buildModelFromUrdf(path)
    data, level = model.createData(), pin.neutral(model)
    torque = abs(pin.computeGeneralizedGravity(model, data, level)[0])
    return model.inertias[1].mass, torque, pin.crba(model, data, level)[0, 0]


paths = [f'{sys.argv[1]}/{name}.urdf' for name in ('own', 'saved')]
with open(paths[0], 'w') as file:
    file.write(ARM)
URDF.load(paths[0]).save(paths[1])
due = (2.0, 2 * 0.2 * 9.81, 0.02 + 2 * 0.2**2)
more = (3.0, (0.4 + 0.5 + 0.4) * 9.81, 3.0 + 0.4**2 + 0.5**2 + 0.4**2)
for title, path, expected in (
    ('as written', paths[0], due),
    ('loaded and saved', paths[1], np.add(due, more)),
):
    seen = read(path)
    print('{}: {:.2f} kg, {:.2f} N m to hold, {:.2f} kg m^2'.format(title, *seen))
    assert np.allclose(seen, expected, rtol=1e-3), seen
END
"$folder/env/bin/python" "$folder/frames.py" "$folder"
