# SPDX-License-Identifier: Apache-2.0
"""Where one recording ends and the next begins, by the stamps alone."""

from dataclasses import dataclass, field, replace

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording.grid import sample_period
from ros2_ident.recording.streams import IntArray, Stream

# A message may overtake at most so many others; further back it is a restart.
_OVERTAKE = 3
# More restarts than this, and more than this share of the messages, are two clocks on one topic.
_MANY, _SHARE = 10, 0.02
# Nothing at all came for so long, s and in samples: what was before and after are two recordings.
_PAUSE, _PAUSE_SAMPLES = 10.0, 50
# Stamps of so many messages in a row, and of this share of all, may lie apart by themselves; so
# many periods off is apart.
_STRAY, _STRAY_SHARE, _APART = 3, 0.01, 10.0
# So many messages do not overtake each other on one connection.
_LATE_SHARE = 0.25


@dataclass(frozen=True)
class Split:
    """The segments of one stream.

    Attributes:
        segments: For each segment the rows of its messages in the order of their stamps.
        reordered: How many messages arrived late and were put back.
        stray: Rows left out because their stamps lie apart from those around them.
    """

    segments: tuple[IntArray, ...]
    reordered: int
    stray: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.int64))


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
    stray = find_stray(stamp)
    if not stray.size:
        return _split(stamp, where)
    rows = np.delete(np.arange(stamp.size), stray)
    found = _split(stamp[rows], where)
    return replace(found, segments=tuple(rows[x] for x in found.segments), stray=stray)


def find_stray(stamp: IntArray) -> IntArray:
    """Return the messages whose stamps lie apart from those before and after, which fit together.

    One wrong bit in a stamp does that. A clock that was set goes on from where it was set to.

    Args:
        stamp: Stamps (T,), ns, in the order of arrival.
    """
    none = np.empty(0, dtype=np.int64)
    steps = np.diff(stamp)
    forward = steps[steps > 0]
    if stamp.size < 2 * _STRAY + 2 or not forward.size:
        return none
    period = float(np.median(forward))
    apart = np.flatnonzero(np.abs(steps) > _APART * period)
    if not apart.size or apart.size > 2 * max(_STRAY, _STRAY_SHARE * stamp.size):
        return none
    found: list[int] = []
    leap = set(apart.tolist())
    for k in apart.tolist():
        if found and k <= found[-1]:
            continue
        ends = (k + n for n in range(1, _STRAY + 1) if k + n in leap)
        for last in ends:
            around = int(stamp[last + 1] - stamp[k])
            inside = stamp[k + 1 : last + 1]
            outside = (inside < stamp[k]) | (inside > stamp[last + 1])
            if 0 < around <= (last - k + 3) * period and outside.all():
                found += range(k + 1, last + 1)
                break
    if leap and not found or len(found) > max(_STRAY, _STRAY_SHARE * stamp.size):
        return none
    return np.array(found, dtype=np.int64)


def _split(stamp: IntArray, where: str) -> Split:
    """Cut a stream at the backward steps of its stamps."""
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


def split_pauses(group: dict[str, Stream]) -> list[dict[str, Stream]]:
    """Cut one recording where no stream has a sample for long.

    A grid over a clock that was set forward would hold the years between. A command that is only
    sent when it changes is no pause, since the state goes on.

    Args:
        group: The streams of one recording, by role.

    Returns:
        The recordings, one where there is no pause.
    """
    periods = [sample_period(x.stamp) for x in group.values()]
    pause = round(1e9 * max(_PAUSE, _PAUSE_SAMPLES * min((x for x in periods if x), default=0.0)))
    spans: list[tuple[int, int]] = []
    for stream in group.values():
        long = np.flatnonzero(np.diff(stream.stamp) > pause)
        begins = stream.stamp[[0, *(long + 1)]]
        spans += zip(begins.tolist(), stream.stamp[[*long, -1]].tolist(), strict=True)
    spans.sort()
    joined = [spans[0]]
    for begin, end in spans[1:]:
        first, last = joined[-1]
        if begin - last > pause:
            joined.append((begin, end))
        else:
            joined[-1] = first, max(last, end)
    if len(joined) == 1:
        return [group]
    parts = []
    for begin, end in joined:
        cut = {role: stream.between(begin, end + 1) for role, stream in group.items()}
        parts.append({role: stream for role, stream in cut.items() if stream is not None})
    return parts


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
