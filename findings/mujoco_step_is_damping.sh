#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# A log simulated by MuJoCo shows less damping than its model states, by the gain times half a step.
#
# MuJoCo 4.0.0, a joint under a `position` actuator whose set-point is a ramp that is held for 4 ms
# at a time, logged at each new set-point. A machine whose controller holds its set-point as long
# lags by (kv + damping) / kp and half the cycle. With integrator RK4 so does MuJoCo. With Euler,
# implicit and implicitfast a set-point acts from half a time step before its own instant on: the
# lag is half a step short, at any step, so whoever takes the damping from such a log finds it
# kp * timestep / 2 too low. At the default 2 ms and kp 300 that is 0.3 N m s/rad, three times the
# damping of many a servo; at 0.1 ms and kp 3000 still 0.15.
#
# Source: https://mujoco.readthedocs.io/en/stable/computation/index.html#numerical-integration
# ("semi-implicit Euler": the velocity is updated with the acceleration first, and the new velocity
# updates the position; so positions are of whole, velocities of half steps).
#
# Output seen:
#   Euler, 2 ms: lag 0.1023 s of 0.1033 s, damping reads 1.701 for 2.000 N m s/rad
#   implicitfast, 2 ms: lag 0.1023 s of 0.1033 s, damping reads 1.701 for 2.000 N m s/rad
#   RK4, 2 ms: lag 0.1033 s of 0.1033 s, damping reads 2.000 for 2.000 N m s/rad
#   Euler, 0.1 ms: lag 0.1033 s of 0.1033 s, damping reads 1.985 for 2.000 N m s/rad
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet mujoco==4.0.0 numpy==2.2.6
cat > "$folder/lag.py" << 'END'
import mujoco
import numpy as np

KP, KV, DAMPING, CYCLE, RATE = 300.0, 28.4, 2.0, 0.004, 0.5
XML = f"""<mujoco><option gravity="0 0 0" timestep="{{}}" integrator="{{}}"/><worldbody><body>
<inertial mass="1" pos="0 0 0" diaginertia="0.1 0.1 0.1"/>
<joint name="j" axis="0 0 1" damping="{DAMPING}"/></body></worldbody>
<actuator><position joint="j" kp="{KP}" kv="{KV}"/></actuator></mujoco>"""


def reads(step, integrator):
    model = mujoco.MjModel.from_xml_string(XML.format(step, integrator))
    data = mujoco.MjData(model)
    for k in range(1000):
        data.ctrl[0] = RATE * CYCLE * k
        missed = data.ctrl[0] - data.qpos[0]
        mujoco.mj_step(model, data, nstep=round(CYCLE / step))
    lag = missed / RATE
    return lag, KP * (lag - CYCLE / 2) - KV


seen = {}
for integrator, step in (('Euler', 2e-3), ('implicitfast', 2e-3), ('RK4', 2e-3), ('Euler', 1e-4)):
    lag, damping = reads(step, integrator)
    seen[integrator, step] = damping
    due = (KV + DAMPING) / KP + CYCLE / 2
    print(f'{integrator}, {1e3 * step:g} ms: lag {lag:.4f} s of {due:.4f} s, '
          f'damping reads {damping:.3f} for {DAMPING:.3f} N m s/rad')
for (integrator, step), damping in seen.items():
    short = 0.0 if integrator == 'RK4' else KP * step / 2
    assert np.isclose(damping, DAMPING - short, atol=2e-3), (integrator, step, damping)
END
"$folder/env/bin/python" "$folder/lag.py"
