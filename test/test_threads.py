# SPDX-License-Identifier: Apache-2.0
"""What a program asks of its libraries: cores for the simulations, and memory to give back."""

import os
import subprocess
import sys

import pytest

from ros2_ident.threads import ONE_THREAD


@pytest.mark.parametrize(('stated', 'found'), [(None, '1'), ('3', '3')])
def test_the_command_takes_one_thread_unless_told_otherwise(stated, found):
    environment = {k: v for k, v in os.environ.items() if k not in ONE_THREAD}
    if stated is not None:
        environment['OPENBLAS_NUM_THREADS'] = stated
    code = (
        'import os, sys; import ros2_ident.cli.main as m; assert "numpy" not in sys.modules; '
        'm.main(["new-machine", "--kind", "linear_axis"]); '
        'print(os.environ["OPENBLAS_NUM_THREADS"])'
    )
    run = subprocess.run(
        [sys.executable, '-c', code], env=environment, capture_output=True, text=True, check=True
    )
    assert run.stdout.splitlines()[-1] == found
