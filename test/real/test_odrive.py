# SPDX-License-Identifier: Apache-2.0
"""The cogging of a motor on an ODrive, by three effects from a user's file, against its map."""

import json
from pathlib import Path
import shutil
import subprocess
import sys

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
RECORDED = ROOT.parent / 'shared/data'
NAMES = ('ripple_a', 'ripple_b', 'ripple_c')
POLE_PAIRS, TORQUE_CONSTANT = 7, 0.0551333

pytestmark = pytest.mark.skipif(
    not (RECORDED / 'odrive_slow003_nocomp').is_dir(), reason='the log of a motor is not here'
)

# Effects come before everything else of the package, so this has a process of its own.
PROGRAM = """
import json, sys
from ros2_ident.effects import add_effect_files
add_effect_files(sys.argv[3:])
from pathlib import Path
import numpy as np
from ros2_ident.identify.data import read_data
from ros2_ident.identify.problem import problem_of
from ros2_ident.models import EffectAt, load_machine
from ros2_ident.search.least_squares import least_squares
machine = load_machine(sys.argv[2])
effects = [EffectAt(Path(name).stem, 'motor') for name in sys.argv[3:]]
problem = problem_of(machine, read_data(sys.argv[1], machine), effects=effects)
start = problem.low + 0.1 * (problem.high - problem.low)
start[-9:] = [0.0, 0.0, 1.0, 0.0, 0.0, 2.0, 0.0, 0.0, 4.0]
found = least_squares(
    problem.models[0].residuals, start, problem.low, problem.high, iterations=40
)
print(json.dumps(found.theta[-9:].tolist()))
"""


def test_cogging_of_an_odrive_is_that_of_its_map(tmp_path: Path) -> None:
    files = [str(tmp_path / f'{name}.py') for name in NAMES]
    for file in files:
        shutil.copy(ROOT / 'config/motor_ripple.py', file)
    run = subprocess.run(
        [
            sys.executable, '-c', PROGRAM, str(RECORDED / 'odrive_slow003_nocomp'),
            str(ROOT / 'config/odrive.yaml'), *files,
        ],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    sine, cosine, order = np.array(json.loads(run.stdout.splitlines()[-1])).reshape(3, 3).T
    np.testing.assert_allclose(POLE_PAIRS * order, [7.0, 14.0, 28.0], rtol=0.01)
    published = np.genfromtxt(RECORDED / 'odrive_cogging_map.csv', delimiter=',', skip_header=1)
    angle, current = published[:, 1], published[:, 2]
    waves = np.exp(-1j * np.outer([7, 14, 28], angle))
    size = 2.0 * np.abs(waves @ current) / len(angle)
    ratio = np.hypot(sine, cosine) / TORQUE_CONSTANT / size
    # Amplitudes published with the recording: of this run over those of the map, measured at rest.
    run_of_map = [0.889 / 0.862, 0.305 / 0.349, 0.454 / 0.560]
    assert ratio == pytest.approx(run_of_map, abs=0.1)
