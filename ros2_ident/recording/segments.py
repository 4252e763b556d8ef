# SPDX-License-Identifier: Apache-2.0
"""Where one recording ends and the next begins, by the stamps alone."""

from dataclasses import dataclass

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording.streams import IntArray, Stream

# A message may overtake at most so many others; further back it is a restart.
_OVERTAKE = 3
# More restarts than this, and more than this share of the messages, are two clocks on one topic.
_MANY, _SHARE = 10, 0.02
# So many messages do not overtake each other on one connection.
_LATE_SHARE = 0.25


@dataclass(frozen=True)
class Split:
    """The segments of one stream.

    Attributes:
        segments: For each segment the rows of its messages in the order of their stamps.
        reordered: How many messages arrived late and were put back.
    """

    segments: tuple[IntArray, ...]
    reordered: int


def split_stamps(stamp: IntArray, where: str) -> Split:
    """Cut a stream at the backward steps of its stamps.

    A message that was merely overtaken has a stamp of its own, lies at most a few periods back,
    and the next stamps go on above the highest one so far; everything else that steps back is a
    restart.

    Args:
        stamp: Stamps (T,), ns, in the order of arrival.
        where: The stream's name, for the error.

    Returns:
        The segments and the number of overtaken messages.

    Raises:
        IdentError: BAD_VALUES where the stamps jump back and forth all the time.
    """
    steps = np.diff(stamp)
    back = np.flatnonzero(steps < 0) + 1
    if not back.size:
        return Split((np.arange(stamp.size),), 0)
    forward = steps[steps > 0]
    period = float(np.median(forward)) if forward.size else 0.0
    cuts = [0]
    late = 0
    resume = 0
    for start in back.tolist():
        if start < resume:
            continue
        length = _overtaken(stamp, start, cuts[-1], period)
        if length:
            late += length
            resume = start + length
        else:
            cuts.append(start)
    restarts = len(cuts) - 1
    if restarts > max(_MANY, _SHARE * stamp.size) or late > max(_MANY, _LATE_SHARE * stamp.size):
        raise IdentError(
            ErrorCode.BAD_VALUES,
            f'{where}: the stamps step back {back.size} times in {stamp.size} messages; two '
            'publishers with different clocks share the topic: record one of them, or remap the '
            'other',
        )
    cuts.append(stamp.size)
    rows = np.arange(stamp.size)
    parts = (rows[a:b] for a, b in zip(cuts, cuts[1:], strict=False))
    return Split(tuple(part[np.argsort(stamp[part], kind='stable')] for part in parts), late)


def _overtaken(stamp: IntArray, start: int, begin: int, period: float) -> int:
    """Return how many messages from `start` on were only overtaken; 0 at a new segment."""
    highest = stamp[start - 1]
    window = stamp[start : start + _OVERTAKE + 1]
    ahead = np.flatnonzero(window > highest)
    if not ahead.size and start + window.size < stamp.size:
        return 0
    length = int(ahead[0]) if ahead.size else window.size
    run = window[:length]
    if length > _OVERTAKE or highest - run.min() > _OVERTAKE * period:
        return 0
    # a restart sends stamps again that were there before; an overtaken message brings a new one
    before = stamp[max(begin, start - 4 * _OVERTAKE) : start]
    if np.isin(run, before).any() or run.min() < stamp[begin]:
        return 0
    return length


def match_segments(pieces: dict[str, list[Stream]]) -> list[dict[str, Stream]]:
    """Put the segments of the roles together that belong to one play of a bag.

    Topics jump back at slightly different moments, but each of them once per restart: with equal
    numbers of segments the k-th belong together. Where one role missed a play, its segments go, in
    order, where their stamps overlap most.

    Args:
        pieces: Segments of each role in the order of arrival.

    Returns:
        One mapping from role to segment per recording.
    """
    count = max(len(streams) for streams in pieces.values())
    leader = next(streams for streams in pieces.values() if len(streams) == count)
    groups: list[dict[str, Stream]] = [{} for _ in range(count)]
    for role, streams in pieces.items():
        places = range(count) if len(streams) == count else _places(streams, leader)
        for place, stream in zip(places, streams, strict=True):
            groups[place][role] = stream
    return groups


def _places(streams: list[Stream], leader: list[Stream]) -> list[int]:
    """Return increasing places in `leader` with the largest total overlap, early ones first."""
    rows, columns = len(streams), len(leader)
    best = np.full((rows + 1, columns + 1), -np.inf)
    best[rows, :] = 0.0
    taken = np.zeros((rows, columns))
    for i in range(rows - 1, -1, -1):
        for j in range(columns - 1, -1, -1):
            one, two = streams[i].stamp, leader[j].stamp
            overlap = max(0.0, float(min(one[-1], two[-1]) - max(one[0], two[0])))
            taken[i, j] = overlap + best[i + 1, j + 1]
            best[i, j] = max(best[i, j + 1], taken[i, j])
    places = []
    j = 0
    for i in range(rows):
        while taken[i, j] < best[i, j]:
            j += 1
        places.append(j)
        j += 1
    return places
