# SPDX-License-Identifier: Apache-2.0
"""Checkpoints of goals: the same goal on the same data goes on where a run was ended or killed.

They lie in `unfinished` in the output directory and are named by what the run depends on, so a
client that sends its goal again after a crash need not know of them.
"""

from contextlib import closing
import hashlib
from pathlib import Path

from ros2_ident.errors import IdentError
from ros2_ident.files import Growing, require_ours
from ros2_ident.identify.problem import sources
from ros2_ident.ros.paths import expanded
from ros2_ident.search.journal import forget, MAGIC

DIRECTORY, SUFFIX = 'unfinished', '.checkpoint'
# Goals that were never sent again: the oldest files go.
MOST = 8


def place_of(directory: str, *what: str) -> Path | None:
    """Return where a run keeps its checkpoint; None where that is not to be, or cannot be.

    Args:
        directory: The request's output directory; empty to write nothing.
        what: What the run depends on beside the sources.
    """
    if not directory:
        return None
    folder = expanded(directory) / DIRECTORY
    name = hashlib.sha256('\n'.join((sources(), *what)).encode()).hexdigest()[:16]
    try:
        for number in range(1, MOST + 1):
            path = folder / f'{name}_{number}{SUFFIX}'
            if _free(path):
                _tidy(folder, path)
                return path
    except OSError:
        pass  # what cannot be written there is said where the result is
    return None


def _free(path: Path) -> bool:
    """Return whether a file can be written that is ours and that no other process writes."""
    try:
        require_ours([path])
        with closing(Growing(path)) as file:
            if not file.size:
                file.write(MAGIC)  # a full disk is no reason not to run
    except IdentError:
        return False
    return True


def _tidy(folder: Path, wanted: Path) -> None:
    """Remove the oldest checkpoints beyond the number that is kept, but for those in use."""
    others = [x for x in folder.glob(f'*{SUFFIX}') if x != wanted]
    for path in sorted(others, key=lambda x: x.stat().st_mtime)[: -(MOST - 1)]:
        if _free(path):
            forget(path)
