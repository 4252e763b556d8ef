# SPDX-License-Identifier: Apache-2.0
"""Which parts of a long log to fit on: those that tell most, until the samples are spent.

A log of hours repeats itself; a minute of it determines the parameters as well as the rest, if it
is the right minute. The log is cut into windows at moments of rest, and windows are taken one
after the other, each time the one that adds most to the logarithm of the determinant of the
information on acceleration, speed, direction and offset, summed over the drives (greedy D-optimal
design).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ros2_ident.recording.streams import FloatArray, Recording, Stream

# Effort samples of all drives together, and length of a window, s.
SAMPLES = 180_000
LENGTH = 10.0
# A window begins at the slowest moment in so much of its first part, s.
_SHIFT = 2.0
# Motion is judged in means over so long, s.
_MEAN = 0.02
# Share of the information that is taken as known before: a single window may leave some open.
_PRIOR = 1e-6

Window = tuple[int, int, int]  # number of the recording, first stamp, stamp after the last, ns


@dataclass(frozen=True)
class Windows:
    """Parts of recordings, each in the order of the log."""

    fit: tuple[Window, ...]  # to fit on
    check: tuple[Window, ...]  # as many others, spread evenly over the rest
    samples: int  # effort samples of the whole log


def effort_samples(recording: Recording, drives: Sequence[str]) -> int:
    """Return how many efforts of the drives a recording holds."""
    stream = recording.effort or recording.state
    if stream is None or stream.effort is None:
        return 0
    return stream.stamp.size * sum(name in stream.names for name in drives)


def choose_windows(
    recordings: Sequence[Recording], drives: Sequence[str], samples: int = SAMPLES
) -> Windows | None:
    """Choose what to fit on.

    Args:
        samples: Effort samples to fit on, all drives together; at least one window is taken.

    Returns:
        The windows, or None where the log has no more samples than that.
    """
    whole = sum(effort_samples(x, drives) for x in recordings)
    if whole <= samples:
        return None
    windows: list[Window] = []
    told: list[FloatArray] = []
    sizes: list[float] = []
    for number, recording in enumerate(recordings):
        stream = recording.command or recording.state
        if stream is None or stream.duration < LENGTH:
            continue
        density = effort_samples(recording, drives) / recording.duration
        features, edges, begin = _features(stream, drives)
        for first, last in pairwise(edges):
            part = features[:, first:last]
            step = round(_MEAN * 1e9)
            windows.append((number, begin + first * step, begin + last * step))
            told.append(np.einsum('dti,dtj->dij', part, part))
            sizes.append(density * (last - first) * _MEAN)
    if not windows:
        return None
    order = sorted(_greedy(np.array(told), np.array(sizes), samples))
    rest = [k for k in range(len(windows)) if k not in order]
    spread = np.unique(np.linspace(0, len(rest) - 1, min(len(rest), len(order))).round())
    others = [rest[int(k)] for k in spread]
    fit, check = (tuple(windows[k] for k in own) for own in (order, others))
    return Windows(fit, check, whole)


def _features(stream: Stream, drives: Sequence[str]) -> tuple[FloatArray, list[int], int]:
    """Return acceleration, speed, direction and one (D, T, 4), edges of windows, first stamp."""
    begin, end = int(stream.stamp[0]), int(stream.stamp[-1])
    step = round(_MEAN * 1e9)
    count = max(1, (end - begin) // step)
    # Every mean starts at the first sample of its time; one without a sample repeats the last.
    edge = np.searchsorted(stream.stamp, begin + step * np.arange(count))
    rows = []
    for name in drives:
        position = stream.column('position', name)
        if position is None:
            continue
        there = np.nan_to_num(position[edge], nan=float(np.nanmean(position)))
        speed = np.gradient(there) / _MEAN if count > 1 else np.zeros(count)
        pair = np.stack([np.gradient(speed), speed])
        scale = np.sqrt(np.mean(pair**2, axis=1, keepdims=True))
        rows.append(np.vstack([pair / np.where(scale > 0.0, scale, 1.0), np.sign(speed)]).T)
    moving = np.array(rows) if rows else np.zeros((1, count, 3))
    features = np.concatenate([moving, np.ones((*moving.shape[:2], 1))], axis=2)
    slow = np.abs(moving[:, :, 1]).max(axis=0)
    length, shift = round(LENGTH / _MEAN), round(_SHIFT / _MEAN)
    starts = range(0, count - length // 2, length)
    edges = [at + int(np.argmin(slow[at : at + shift])) for at in starts]
    return features, [*edges, count], begin


def _greedy(told: FloatArray, sizes: FloatArray, samples: int) -> list[int]:
    """Return the windows to take, by their information (W, D, 4, 4) and sizes (W,)."""
    known = np.eye(told.shape[-1]) * _PRIOR * np.trace(told.mean(axis=0), axis1=1, axis2=2).max()
    have = np.repeat(known[None], told.shape[1], axis=0)
    left = float(samples)
    taken: list[int] = []
    while len(taken) < len(told):
        gain = np.linalg.slogdet(have[None] + told)[1].sum(axis=1)
        gain[taken] = -np.inf
        gain[sizes > left] = -np.inf
        best = int(np.argmax(gain))
        if not np.isfinite(gain[best]):
            break
        taken.append(best)
        have = have + told[best]
        left -= sizes[best]
    return taken or [int(np.argmin(sizes))]
