#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Drake reads an MJCF's gear for the motor's inertia alone: its actuators pull with a tenth of it.
#
# drake 1.51.1 (1.58.0 does the same) beside MuJoCo 4.0.0 on the same text, torques on the joint.
# The armature, 0.05 kg m^2 at the joint, becomes a rotor of 0.0005 behind Drake's gear ratio, so
# the inertia is right. But Drake's inputs, effort limits and gains count at the joint: neither the
# control nor `forcerange` is multiplied by the gear, nor kp by its square. kv is not read at all:
# a servo swings undamped. There is no warning, as there is one of a joint's frictionloss.
#
# Source: https://mujoco.readthedocs.io/en/stable/XMLreference.html#actuator-general (gear: "scales
# the length (and consequently moment arms, velocity and force) of the actuator"); kv of `position`
# is damping there. pydrake.multibody.tree.JointActuator says of the gear ratio "See
# reflected_inertia" alone. Read since https://github.com/RobotLocomotion/drake/pull/21967.
#
# Output seen:
#   motor, gear 10, control 1: Drake 1.00 N m, MuJoCo 10.00 N m
#   motor, gear 10, forcerange 3, control 100: Drake 3.00 N m, MuJoCo 30.00 N m
#   position, gear 2, kp 100, 0.1 rad off: Drake -10.00 N m, MuJoCo -40.00 N m
#   position, gear 1, kv 7, 1 rad/s: Drake 0.00 N m, MuJoCo -7.00 N m
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet drake==1.51.1 mujoco==4.0.0 numpy==2.2.6
cat > "$folder/gear.py" << 'END'
from pathlib import Path
import sys

import mujoco
import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

XML = """<mujoco model="m"><worldbody><body name="b"><inertial mass="1" pos="0 0 0"
diaginertia="0.1 0.1 0.1"/><joint name="j" axis="0 0 1" armature="0.05"/></body></worldbody>
<actuator><{} joint="j" {}/></actuator></mujoco>"""
path = sys.argv[1] + '/robot.xml'


def in_mujoco(control, state):
    data = mujoco.MjData(mujoco.MjModel.from_xml_path(path))
    data.qpos[0], data.qvel[0], data.ctrl[0] = *state, control
    mujoco.mj_forward(data.model, data)
    return data.qfrc_actuator[0]


def in_drake(control, state):
    plant = MultibodyPlant(1e-6)
    plant.SetUseSampledOutputPorts(False)
    (number,) = Parser(plant).AddModels(path)
    plant.Finalize()
    context = plant.CreateDefaultContext()
    plant.SetPositionsAndVelocities(context, np.array(state))
    if kind == 'motor':
        plant.get_actuation_input_port().FixValue(context, [control])
    else:
        plant.get_desired_state_input_port(number).FixValue(context, [control, 0.0])
    return plant.get_net_actuation_output_port().Eval(context)[0]


for kind, attributes, control, state, title, drake, own in (
    ('motor', 'gear="10"', 1, (0, 0), 'gear 10, control 1', 1, 10),
    ('motor', 'gear="10" forcelimited="true" forcerange="-3 3"', 100, (0, 0),
     'gear 10, forcerange 3, control 100', 3, 30),
    ('position', 'gear="2" kp="100"', 0, (0.1, 0), 'gear 2, kp 100, 0.1 rad off', -10, -40),
    ('position', 'kp="100" kv="7"', 0, (0, 1), 'gear 1, kv 7, 1 rad/s', 0, -7),
):
    Path(path).write_text(XML.format(kind, attributes))
    seen = np.round([f(control, state) for f in (in_drake, in_mujoco)], 3) + 0.0
    print(f'{kind}, {title}: Drake {seen[0]:.2f} N m, MuJoCo {seen[1]:.2f} N m')
    assert np.allclose(seen, (drake, own), atol=1e-2), seen
END
"$folder/env/bin/python" "$folder/gear.py" "$folder"
