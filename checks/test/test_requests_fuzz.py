# SPDX-License-Identifier: Apache-2.0
"""Machine files, messages and goals with odd content are taken, or refused in a sentence.

`checks/benchmarks/fuzz_requests.py` does the same for hours.
"""

import importlib.util
from pathlib import Path
import random

import pytest

from ros2_ident.errors import ErrorCode, IdentError

SCRIPT = Path(__file__).parents[2] / 'checks' / 'benchmarks' / 'fuzz_requests.py'


@pytest.fixture(scope='module')
def fuzz():
    spec = importlib.util.spec_from_file_location('fuzz_requests', SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ('kind', 'count'),
    [
        *(('Machines', 150), ('Urdf', 80), ('Mjcf', 80), ('Columns', 60), ('Lerobot', 60)),
        *(('Messages', 2000), ('Goals', 100)),
    ],
)
def test_odd_requests_are_answered(fuzz, kind, count, tmp_path):
    needed = {'Urdf': 'pinocchio', 'Mjcf': 'pinocchio', 'Lerobot': 'pyarrow'}.get(kind)
    if needed:
        pytest.importorskip(needed, reason=f'{needed} is not installed')
    take = getattr(fuzz, kind)(tmp_path)
    outcomes = set()
    for number in range(count):
        try:
            outcomes.add(take(random.Random(number)))
        except IdentError as error:
            assert error.code != ErrorCode.INTERNAL
            assert error.message.isprintable(), repr(error.message)
            outcomes.add('refused')
    assert outcomes == {'taken', 'refused'}
