# SPDX-License-Identifier: Apache-2.0
"""Paths that others give the node: expanded, and kept inside what is allowed."""

from pathlib import Path

from ros2_ident.errors import ErrorCode, IdentError


def expanded(path: str) -> Path:
    """Return a path with `~` replaced by the home directory.

    Raises:
        IdentError: INVALID_GOAL where it can be no path.
    """
    try:
        if '\0' in path:
            raise RuntimeError('it holds a zero byte')
        return Path(path).expanduser()
    except RuntimeError as exc:
        raise IdentError(
            ErrorCode.INVALID_GOAL, f'{path!r} is no path ({exc}); give one that is'
        ) from None


def allowed(path: str, directory: str) -> Path:
    """Return a path to read, which has to exist.

    Args:
        path: As the goal has it.
        directory: What it has to lie in, wherever links lead; empty for anywhere.

    Raises:
        IdentError: NO_DATA where nothing is there, INVALID_GOAL where it is not allowed.
    """
    found = expanded(path)
    try:
        real = found.resolve()
        there = real.exists()
    except (OSError, RuntimeError) as exc:
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            f'{path[:80]!r} is no path ({getattr(exc, "strerror", None) or exc}); give one that '
            'is',
        ) from None
    if directory and not real.is_relative_to(expanded(directory).resolve()):
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            f'{path} lies outside of allowed_directory {directory}; move it there or have the '
            'parameter changed',
        )
    if not there:
        raise IdentError(
            ErrorCode.NO_DATA,
            f"{path}: does not exist on the node's machine; give the path of a bag there",
        )
    return found
