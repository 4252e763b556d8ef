# SPDX-License-Identifier: Apache-2.0
"""Where goals read and write: paths that others give, folders of runs, checkpoints.

A checkpoint lies in `unfinished` in the output directory and is named by what the run depends on:
the same goal on the same data goes on where a run was ended or killed, and a client that sends its
goal again after a crash need not know of it.
"""

from contextlib import closing
from datetime import datetime
import hashlib
from pathlib import Path

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import Growing, remove_file
from ros2_ident.identify.problem import sources
from ros2_ident.search.journal import MAGIC

UNFINISHED, SUFFIX = 'unfinished', '.checkpoint'
# Goals that were never sent again: the oldest files go.
MOST = 8


def _no_path(path: str, reason: object) -> IdentError:
    return IdentError(ErrorCode.INVALID_GOAL, f'{path!r} is no path ({reason}); give one that is')


def expanded(path: str) -> Path:
    """Return a path with `~` replaced by the home directory.

    Raises:
        IdentError: INVALID_GOAL where it can be no path.
    """
    if '\0' in path:
        raise _no_path(path, 'it holds a zero byte')
    try:
        return Path(path).expanduser()
    except RuntimeError as exc:
        raise _no_path(path, exc) from None


def allowed(path: str, directory: str, *, there: bool = True) -> Path:
    """Return a path to read.

    Args:
        path: As the goal has it.
        directory: What it has to lie in, wherever links lead; empty for anywhere.
        there: Whether it has to exist.

    Raises:
        IdentError: NO_DATA where nothing is there, INVALID_GOAL where it is not allowed.
    """
    found = expanded(path)
    try:
        real = found.resolve()
        exists = real.exists()
    except (OSError, RuntimeError) as exc:
        raise _no_path(path[:80], getattr(exc, 'strerror', None) or exc) from None
    if directory and not real.is_relative_to(expanded(directory).resolve()):
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            f'{path} lies outside of allowed_directory {directory}; move it there or have the '
            'parameter changed',
        )
    if there and not exists:
        raise IdentError(
            ErrorCode.NO_DATA,
            f"{path}: does not exist on the node's machine; give the path of a bag there",
        )
    return found


def new_folder(directory: str) -> Path:
    """Make a folder named by the time; never one that is there already.

    Raises:
        IdentError: INVALID_GOAL where nothing can be written there.
    """
    base = expanded(directory)
    stamp = f'{datetime.now().astimezone():%Y%m%d_%H%M%S}'
    for number in range(1, 1000):
        path = base / (stamp if number == 1 else f'{stamp}_{number}')
        try:
            path.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as exc:
            raise IdentError(
                ErrorCode.INVALID_GOAL,
                f'output_directory {base} cannot be written ({exc.strerror}); give another one, '
                'or an empty string to write nothing',
            ) from None
        return path
    raise IdentError(ErrorCode.INVALID_GOAL, f'{base} is full of runs of {stamp}; clear it')


def checkpoint_of(directory: str, *what: str) -> Path | None:
    """Return where a run keeps its checkpoint; None where that is not to be, or cannot be.

    Args:
        directory: The request's output directory; empty to write nothing.
        what: What the run depends on beside the sources.
    """
    if not directory:
        return None
    folder = expanded(directory) / UNFINISHED
    name = hashlib.sha256('\n'.join((sources(), *what)).encode()).hexdigest()[:16]
    path = folder / f'{name}{SUFFIX}'
    try:
        with closing(Growing(path)) as file:
            if not file.size:
                file.write(MAGIC)
        others = [x for x in folder.glob(f'*{SUFFIX}') if x != path]
        for old in sorted(others, key=lambda x: x.stat().st_mtime)[: -(MOST - 1)]:
            remove_file(old)
    except (IdentError, OSError):
        return None  # a full disk, or another node on the same goal, is no reason not to run
    return path
