# SPDX-License-Identifier: Apache-2.0
"""A digest of what a result depends on beside its data: this package's sources, the libraries."""

import functools
import hashlib
from importlib.metadata import version
from pathlib import Path

# Where other versions may give other numbers.
LIBRARIES = ('llvmlite', 'numba', 'numpy', 'rosbags', 'scipy')
# Rooms that show or write a result, and have no part in it.
NO_PART = ('cli', 'commissioning.py', 'files.py', 'report', 'ros', 'simulate')


def digest_of(package: Path) -> str:
    """Return the digest for a copy of this package.

    Args:
        package: Its folder.
    """
    total = hashlib.sha256()
    for name in LIBRARIES:
        total.update(f'{name} {version(name)}\n'.encode())
    for path in sorted(package.rglob('*.py')):
        inside = path.relative_to(package)
        if inside.parts[0] not in NO_PART:
            content = path.read_bytes()
            total.update(f'{inside.as_posix()} {len(content)}\n'.encode())
            total.update(content)
    return total.hexdigest()[:16]


@functools.cache
def result_digest() -> str:
    """Return the digest for what this process runs."""
    return digest_of(Path(__file__).parent)
