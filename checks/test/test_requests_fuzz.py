# SPDX-License-Identifier: Apache-2.0
"""Machine files, messages and goals with odd content are taken, or refused in a sentence.

`checks/benchmarks/fuzz_requests.py` does the same for hours.
"""

import random

import pytest

from checks.benchmarks import fuzz_requests
from ros2_ident.errors import ErrorCode, IdentError


@pytest.mark.parametrize(
    ('kind', 'count'),
    [
        *(('Machines', 150), ('Urdf', 80), ('Mjcf', 80), ('Columns', 60), ('Lerobot', 60)),
        *(('Messages', 2000), ('Goals', 100)),
    ],
)
def test_odd_requests_are_answered(kind, count, tmp_path):
    needed = {'Urdf': 'pinocchio', 'Mjcf': 'pinocchio', 'Lerobot': 'pyarrow'}.get(kind)
    if needed:
        pytest.importorskip(needed, reason=f'{needed} is not installed')
    take = getattr(fuzz_requests, kind)(tmp_path)
    outcomes = set()
    for number in range(count):
        try:
            outcomes.add(take(random.Random(number)))
        except IdentError as error:
            assert error.code != ErrorCode.INTERNAL
            assert error.message.isprintable(), repr(error.message)
            outcomes.add('refused')
    assert outcomes == {'taken', 'refused'}
