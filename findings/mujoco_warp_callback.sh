#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# MuJoCo Warp steps a model whose passive forces come from mujoco.set_mjcb_passive without them,
# and says nothing.
#
# MuJoCo 4.0.0 and MuJoCo Warp 4.0.0 with Warp 1.19.0, on the processor. A joint that a callback
# brakes with 2 N m s/rad: in MuJoCo its speed falls by the callback's torque, in MuJoCo Warp it
# stays. put_model raises NotImplementedError for plugins, but looks at no callback. Its own are
# the fields of Model.callback, called with its Model and Data, as the last line shows. So whoever
# puts a model there that is braked by a callback runs it unbraked.
#
# Source: https://mujoco.readthedocs.io/en/stable/APIreference/APIglobals.html#mjcb-passive
#
# Output seen:
#   MuJoCo 0.1351, MuJoCo Warp 1.0000, with Model.callback.passive 0.1351 rad/s
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet mujoco==4.0.0 mujoco-warp==4.0.0 warp-lang==1.19.0 numpy==2.2.6
cat > "$folder/brake.py" << 'END'
import warp

warp.config.quiet = True
import mujoco
import mujoco_warp
import numpy as np

warp.set_device('cpu')
XML = """<mujoco><option gravity="0 0 0" timestep="0.001"/><worldbody><body>
<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/><joint name="j" axis="0 0 1"/></body>
</worldbody></mujoco>"""


def brake(model, data):
    data.qfrc_passive[:] -= 2.0 * data.qvel


def brake_there(model, data):
    data.qfrc_passive.assign(data.qfrc_passive.numpy() - 2.0 * data.qvel.numpy())


def ends(own):
    data = mujoco.MjData(model)
    data.qvel[:] = 1.0
    there, state = mujoco_warp.put_model(model), mujoco_warp.put_data(model, data)
    there.callback.passive = own
    for _ in range(1000):
        mujoco_warp.step(there, state)
    return state.qvel.numpy()[0, 0]


model = mujoco.MjModel.from_xml_string(XML)
mujoco.set_mjcb_passive(brake)
data = mujoco.MjData(model)
data.qvel[:] = 1.0
mujoco.mj_step(model, data, nstep=1000)
host, silent, told = data.qvel[0], ends(None), ends(brake_there)
print(f'MuJoCo {host:.4f}, MuJoCo Warp {silent:.4f}, with Model.callback.passive {told:.4f} rad/s')
assert np.isclose(host, 0.998**1000, rtol=1e-3) and silent == 1.0
assert np.isclose(told, host, rtol=1e-3)
END
"$folder/env/bin/python" "$folder/brake.py"
