# SPDX-License-Identifier: Apache-2.0
"""Prior knowledge as rows of a fit."""

import math

import numpy as np
import pytest

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.prior import Prior

FOUND = Prior(
    'monday', '', {'mass': 2.0, 'friction': 5.0, 'x.delay': 0.1},
    {'mass': 0.1, 'friction': 0.5, 'x.delay': math.inf},
    {'mass': 0.05, 'friction': 0.5, 'x.delay': math.inf},
    {'mass': 'kg', 'friction': 'N', 'x.delay': 's'},
    ((1.0, 0.8, math.nan), (0.8, 1.0, math.nan), (math.nan, math.nan, 1.0)),
)  # fmt: skip
FREE = {'mass': (0.0, 9.0, 'kg'), 'friction': (0.0, 9.0, 'N'), 'x.delay': (0.0, 1.0, 's')}


def test_rows_have_the_covariance_of_the_result():
    rows, mean = FOUND.rows(['other', 'friction', 'x.delay', 'mass'], noise=False)
    assert rows.shape == (2, 4) and not rows[:, [0, 2]].any()
    assert np.isnan(mean[[0, 2]]).all() and mean[[1, 3]].tolist() == [5.0, 2.0]
    own = rows[:, [3, 1]]
    wanted = [[0.01, 0.04], [0.04, 0.25]]
    np.testing.assert_allclose(np.linalg.inv(own.T @ own), wanted, rtol=1e-9)
    own = FOUND.rows(['mass', 'friction'], noise=True)[0]
    wanted = [[0.0025, 0.02], [0.02, 0.25]]
    np.testing.assert_allclose(np.linalg.inv(own.T @ own), wanted, rtol=1e-9)
    alone, _ = FOUND.without(('mass', 'x.')).rows(['mass', 'friction'], noise=False)
    np.testing.assert_allclose(np.abs(alone), [[0.0, 2.0]])


@pytest.mark.parametrize(
    ('free', 'said'),
    [
        ({**FREE, 'mass': (0.0, 9.0, 'kg m^2')}, 'mass in kg, and the machine file has it'),
        (
            {'friction': FREE['friction']},
            'mass, which is no parameter of this machine',
        ),
        (
            {**FREE, 'friction': (6.0, 9.0, 'N')},
            'friction = 5, and the machine file bounds',
        ),
    ],
)
def test_another_machine_gets_a_sentence(free, said):
    FOUND.check({name: x for name, x in FREE.items() if name != 'x.delay'}, ['x'])
    with pytest.raises(IdentError, match=said) as caught:
        FOUND.check(free, ['x'])
    assert caught.value.code is ErrorCode.INVALID_GOAL
