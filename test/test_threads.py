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


# A block is taken, given back and taken again: what glibc says of the second.
SECOND = '''
import ctypes
from ros2_ident.threads import one_heap
libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p
libc.free.argtypes = [ctypes.c_void_p]
class Told(ctypes.Structure):
    _fields_ = [(f'f{n}', ctypes.c_size_t) for n in range(10)]
libc.mallinfo2.restype = Told
if HEAP:
    one_heap()
libc.free(libc.malloc(8 * 2**20))
before = libc.mallinfo2().f4
block = libc.malloc(8 * 2**20)
print(libc.mallinfo2().f4 - before >= 8 * 2**20)
'''


@pytest.mark.skipif(not sys.platform.startswith('linux'), reason='mallopt is of glibc')
@pytest.mark.parametrize(
    ('heap', 'environment', 'from_system'),
    [
        (True, {}, 'True'),
        (False, {}, 'False'),  # glibc keeps a block of this size once one was freed
        (True, {'MALLOC_MMAP_THRESHOLD_': str(2**25)}, 'False'),
    ],
)
def test_large_blocks_go_back_to_the_system_unless_the_user_says_otherwise(
    heap: bool, environment: dict[str, str], from_system: str
) -> None:
    # A Dask worker's parent is told another way of giving back, which switches this one off.
    plain = {k: v for k, v in os.environ.items() if not k.startswith('MALLOC_')}
    done = subprocess.run(
        [sys.executable, '-c', SECOND.replace('HEAP', str(heap))],
        env=plain | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == from_system
