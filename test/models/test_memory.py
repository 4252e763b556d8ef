# SPDX-License-Identifier: Apache-2.0
"""Effects with a memory: several on one hook, each with its own.

A user's file brings the second one, so that runs in a process of its own.
"""

from dataclasses import replace
import inspect
import os
from pathlib import Path
import subprocess
import sys

import pytest

from ros2_ident.effects import get_effect, Hook
from ros2_ident.effects.loading import VARIABLE
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.kernel.hooks import check_memories

ROOT = Path(__file__).parents[2]


def twice_on_one_hook():
    """Run where the lag of a current loop is there twice."""
    from numba import njit
    import numpy as np

    from ros2_ident.effects import DriveState
    from ros2_ident.kernel import hooks
    from ros2_ident.kernel.rows import bit, DRIVE_COUNT, effect_row, MEMORY_COUNT
    from ros2_ident.lanes import spread, store, WIDTH

    names = 'current_loop_lag', 'more_current_loop_lag'
    on = sum(bit(name) for name in names)

    @njit
    def run(torque, par, mem, out):
        zero = spread(0.0)
        for k in range(torque.size):
            drive = DriveState(
                zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, spread(1e-3), zero,
                zero, zero,
            )  # fmt: skip
            value = spread(torque[k])
            store(out, k * WIDTH, hooks.command_hook(value, drive, on, par, 0, mem, 0))
            hooks.command_keeps(value, drive, on, par, 0, mem, 0, None)

    torque = np.random.default_rng(1).standard_normal(40)
    lags = np.array([0.002, 0.007])
    par, mem = np.zeros(DRIVE_COUNT * WIDTH), np.zeros(MEMORY_COUNT * WIDTH)
    for name, lag in zip(names, lags, strict=True):
        par[effect_row(name) * WIDTH :][:WIDTH] = lag
    out = np.empty((torque.size, WIDTH))
    run(torque, par, mem, out.ravel())
    # The second lag follows the mean of what the first lets through in a cycle.
    state = np.zeros(2)
    for k, value in enumerate(torque):
        through = value
        for i, lag in enumerate(lags):
            share = (1.0 - np.exp(-1e-3 / lag)) * lag / 1e-3
            mean = through + (state[i] - through) * share
            state[i] = through + (state[i] - through) * np.exp(-1e-3 / lag)
            through = mean
        np.testing.assert_allclose(out[k], through, rtol=1e-13, atol=1e-15)


def test_effects_of_one_hook_have_a_memory_each(tmp_path: Path) -> None:
    text = (ROOT / 'ros2_ident/effects/current_loop_lag.py').read_text(encoding='utf-8')
    more = tmp_path / 'more_current_loop_lag.py'
    more.write_text(text.replace("id='current", "id='more_current"), encoding='utf-8')
    ran = subprocess.run(
        [sys.executable, '-c', f'{inspect.getsource(twice_on_one_hook)}\ntwice_on_one_hook()'],
        cwd=ROOT,
        env={**os.environ, VARIABLE: str(more), 'NUMBA_CACHE_DIR': str(tmp_path / 'numba')},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr


def test_a_memory_where_none_is_written_is_refused() -> None:
    lag = get_effect('current_loop_lag')
    check_memories([lag, get_effect('backlash')])
    with pytest.raises(IdentError, match='an effect of TORQUE has no memory') as info:
        check_memories([lag, replace(lag, hook=Hook.TORQUE)])
    assert info.value.code is ErrorCode.INVALID_GOAL
