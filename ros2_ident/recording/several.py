# SPDX-License-Identifier: Apache-2.0
"""Several logs as the data of one fit."""

from collections.abc import Sequence
from pathlib import Path

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording.bag import read_bag, Topics
from ros2_ident.recording.shown import printable
from ros2_ident.recording.streams import Recording


def read_bags(paths: Sequence[str | Path], topics: Topics | None = None) -> list[Recording]:
    """Read logs one after the other.

    Args:
        paths: As for `read_bag`.
        topics: As for `read_bag`.

    Raises:
        IdentError: As `read_bag`; INVALID_GOAL where two hold the same, which would count twice
            and make every interval too narrow.
    """
    found: list[Recording] = []
    of: dict[str, str | Path] = {}
    for path in paths:
        recordings = read_bag(path, topics)
        digest = recordings[0].sha256
        if digest in of:
            raise IdentError(
                ErrorCode.INVALID_GOAL,
                f'{printable(str(path))}: is the same log as {printable(str(of[digest]))} and '
                'would count twice; name it once',
            )
        of[digest] = path
        found += recordings
    return found
