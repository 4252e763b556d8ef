#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# mujoco-usd-converter leaves an actuator's delay out of the USD, and warns of nothing.
#
# mujoco-usd-converter 0.8.0 with the MuJoCo 3.16.0 that it asks for, whose actuators have `delay`,
# `nsample` and `interp`. A position servo takes its set-points 50 ms late: of that the layer has
# no attribute, and its command, which warns of cameras, lights and texture layers, says nothing.
# In MuJoCo such a servo has gone a third as far 0.1 s after a step as one without the delay, as the
# USD has it. Whoever tunes a controller on the USD does it for a loop without its dead time.
#
# Source: https://mujoco.readthedocs.io/en/stable/XMLreference.html#actuator-position-delay;
# mujoco_usd_converter/_impl/actuator.py, where the attributes that are written stand.
#
# Output seen:
#   in USD: mjc:biasPrm mjc:biasType mjc:forceRange:max mjc:forceRange:min mjc:gainPrm
#   warnings: 0
#   0.1 s after a step by 0.5 rad: 0.067 rad, without the delay 0.203 rad
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet mujoco-usd-converter==0.8.0 mujoco==3.16.0 \
  usd-exchange==3.0.1 numpy==2.2.6
cat > "$folder/servo.xml" << 'END'
<mujoco model="servo"><option timestep="0.001" gravity="0 0 0" integrator="implicitfast"/>
<worldbody><body name="arm"><joint name="swing" axis="0 1 0"/>
<inertial pos="0 0 -0.1" mass="0.5" diaginertia="0.01 0.01 0.01"/></body></worldbody>
<actuator><position name="servo" joint="swing" kp="2" kv="0.2" forcerange="-5 5" delay="0.05"
nsample="60" interp="linear"/></actuator></mujoco>
END
"$folder/env/bin/mujoco_usd_converter" "$folder/servo.xml" "$folder/usd" &> "$folder/said"
cat > "$folder/late.py" << 'END'
import sys

import mujoco
from pxr import Usd

stage = Usd.Stage.Open(sys.argv[1] + '/usd/servo.usda')
[servo] = [prim for prim in stage.Traverse() if prim.GetTypeName() == 'MjcActuator']
there = [x.GetName() for x in servo.GetAuthoredAttributes()]
print('in USD:', *there)
with open(sys.argv[1] + '/said') as file:
    warned = [line for line in file if 'warn' in line.lower()]
print('warnings:', len(warned))


def swung(late):
    model = mujoco.MjModel.from_xml_path(sys.argv[1] + '/servo.xml')
    model.actuator_delay[:] *= late
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 100)
    data.ctrl[0] = 0.5
    mujoco.mj_step(model, data, 100)
    return float(data.qpos[0])


late, prompt = swung(True), swung(False)
print(f'0.1 s after a step by 0.5 rad: {late:.3f} rad, without the delay {prompt:.3f} rad')
assert 'mjc:gainPrm' in there and not [x for x in there if 'delay' in x or 'sample' in x]
assert not warned and late < 0.7 * prompt
END
"$folder/env/bin/python" "$folder/late.py" "$folder"
