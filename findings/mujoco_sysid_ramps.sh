#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# MuJoCo's own identification takes held commands for ramps: a servo's damping comes out too high,
# by up to its gain times half a cycle of the log.
#
# mujoco 4.0.0, `mujoco.sysid`. A servo of kp 20 N m/rad and 0.5 N m s/rad gets a set-point per
# cycle and holds it, as machines do; the log has a row per cycle. residual() resamples the
# commands to the time step of the model in straight lines from one row to the next, so that each
# begins to act a cycle before it was sent, half a cycle on the mean. From a log of 50 Hz the
# damping, all that is unknown, comes out 36 % too high. No option of residual() says that
# commands are held. What helps is to resample them oneself before, to a row per time step, by
# method='zoh'.
#
# Source: https://github.com/google-deepmind/mujoco/blob/main/python/mujoco/sysid/README.md and the
# sysid.ipynb beside it do not say what a command is between two rows; the former names
# `resample(new_times=, target_dt=)` without its method, "linear". mujoco/sysid/_src/residual.py,
# model_residual, calls it with target_dt alone.
#
# Output seen:
#   5 ms: damping 0.534 N m s/rad as it comes, 0.490 with commands held first, 0.500 in truth
#   10 ms: damping 0.582 N m s/rad as it comes, 0.490 with commands held first, 0.500 in truth
#   20 ms: damping 0.678 N m s/rad as it comes, 0.491 with commands held first, 0.500 in truth
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet 'mujoco[sysid]==4.0.0' scipy==1.17.1 numpy==2.2.6
cat > "$folder/ramps.py" << 'END'
import contextlib
import io

import mujoco
import numpy as np
from mujoco import sysid

KP, DAMPING, STEP, LENGTH = 20.0, 0.5, 5e-4, 4.0
XML = f"""<mujoco><option gravity="0 0 0" timestep="{STEP}" integrator="RK4"/><worldbody><body>
<inertial mass="1" pos="0 0 0" diaginertia="0.005 0.005 0.005"/>
<joint name="j" axis="0 0 1" damping="{DAMPING}"/></body></worldbody>
<actuator><position joint="j" kp="{KP}" kv="0"/></actuator>
<sensor><jointpos name="q" joint="j"/></sensor></mujoco>"""


def log(model, cycle):
    """Return times, set-points and positions of a run that holds each set-point for a cycle."""
    data = mujoco.MjData(model)
    times = np.arange(0.0, LENGTH, cycle)
    targets = np.sin(2 * np.pi * 0.7 * times) + 0.3 * np.sin(2 * np.pi * 2.0 * times + 1.0)
    positions = []
    for target in targets:
        positions.append(data.qpos[0])
        data.ctrl[0] = target
        mujoco.mj_step(model, data, nstep=round(cycle / STEP))
    return times, targets[:, None], np.array(positions)[:, None]


def found(cycle, held):
    """Return the damping that is identified from such a log, its commands held first or not."""
    spec = mujoco.MjSpec.from_string(XML)
    model = spec.compile()
    times, targets, positions = log(model, cycle)
    control = sysid.TimeSeries(times, targets)
    if held:
        control = control.resample(STEP * np.arange(round(times[-1] / STEP) + 1), method='zoh')
    control = sysid.TimeSeries.from_control_names(control.times, control.data, model)
    start = sysid.create_initial_state(model, np.zeros(1), np.zeros(1), np.zeros(0))
    sequences = sysid.ModelSequences(
        'servo', spec, 'log', start, control,
        sysid.TimeSeries.from_names(times, positions, model),
    )
    parameters = sysid.ParameterDict()
    parameters.add(sysid.Parameter(
        'damping', 1.0, 0.01, 5.0,
        modifier=lambda spec, p: spec.joint('j').damping.__setitem__(0, p.value[0]),
    ))
    residual = sysid.build_residual_fn(models_sequences=[sequences], n_threads=1)
    with contextlib.redirect_stdout(io.StringIO()):
        result, _ = sysid.optimize(parameters, residual, verbose=False)
    return result['damping'].value[0]


for cycle in (0.005, 0.01, 0.02):
    ramps, steps = found(cycle, False), found(cycle, True)
    print(f'{1e3 * cycle:g} ms: damping {ramps:.3f} N m s/rad as it comes, {steps:.3f} with '
          f'commands held first, {DAMPING:.3f} in truth')
    assert abs(ramps - (DAMPING + KP * cycle / 2)) < 0.03, ramps
    assert abs(steps - DAMPING) < 0.03, steps
END
OPENBLAS_NUM_THREADS=1 "$folder/env/bin/python" "$folder/ramps.py"
