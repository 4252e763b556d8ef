# SPDX-License-Identifier: Apache-2.0
"""Streams and recordings: what they refuse, and in which words."""

import numpy as np
import pytest

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import Recording, Stream

STAMP = np.arange(4) * 1_000_000
VALUES = np.arange(8.0).reshape(4, 2)
ENDLESS = np.where(VALUES == 3.0, np.inf, VALUES)


@pytest.mark.parametrize(
    ('changes', 'text'),
    [
        ({'names': ()}, 'a stream needs at least one joint name'),
        ({'names': ('a', 'a')}, 'joint a occurs twice'),
        ({'stamp': STAMP * 1e-9}, r'integers \[ns\] of shape \(T,\), found float64'),
        ({'stamp': STAMP[:0]}, 'a stream needs at least one sample'),
        ({'stamp': STAMP[::-1]}, 'sample 1 is 1000000 ns before its predecessor'),
        ({'stamp': STAMP * 0}, 'sample 1 is 0 ns before its predecessor'),
        ({'position': VALUES[:3]}, r'position has shape \(3, 2\), expected \(4, 2\)'),
        ({'position': ENDLESS}, 'position of b is infinite at sample 1'),
        ({'position': None}, 'holds neither position, velocity nor effort'),
    ],
)
def test_a_stream_refuses_with_one_sentence(changes, text):
    arguments = {'names': ('a', 'b'), 'stamp': STAMP, 'position': VALUES} | changes
    with pytest.raises(IdentError, match=text) as caught:
        Stream(**arguments)
    assert caught.value.code == ErrorCode.BAD_VALUES
    assert '\n' not in caught.value.message


def test_an_empty_recording_is_refused():
    with pytest.raises(IdentError, match='holds no stream at all') as caught:
        Recording(source='x')
    assert caught.value.code == ErrorCode.NO_DATA
    assert caught.value.message.startswith('x: ')
    with pytest.raises(IdentError, match='^recording: holds no stream'):
        Recording()
