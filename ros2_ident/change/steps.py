# SPDX-License-Identifier: Apache-2.0
"""Encoder steps that one side has, found in what its controllers miss.

No simulation repeats the course of what steps make, so no fit tells them from noise: they are
looked for where they show, see `gap.suspects.encoder_steps`.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.change.result import Change, Size, Suspect
from ros2_ident.errors import IdentError
from ros2_ident.gap.recordings import Part, Split
from ros2_ident.gap.suspects.encoder_steps import (
    EncoderSteps,
    find_encoder_steps,
    made_by_steps,
    SURE,
)
from ros2_ident.models import FullModel


@dataclass(frozen=True)
class OwnSteps:
    """Encoder steps of one side.

    Attributes:
        change: They as a change.
        explained: Share that they are of what is left there and not on the other side, in power.
    """

    change: Change
    explained: float


def steps_of_one_side(
    models: Sequence[FullModel], after: npt.NDArray[np.bool_], theta: Array
) -> Iterator[OwnSteps]:
    """Yield encoder steps of one side that would have shown on the other.

    Args:
        models: Nominal models, one a recording.
        after: (M,) whether a recording is of the side after.
        theta: (N,) one fit of all.
    """
    with suppress(IdentError):
        parts = [[m for m, a in zip(models, after, strict=True) if a == s] for s in (False, True)]
        splits = [Split(Part(tuple(part))) for part in parts]
        found = [find_encoder_steps(split, theta) for split in splits]
        left = [_left(split, theta) for split in splits]
        for own, other in ((0, 1), (1, 0)):
            for steps in found[own]:
                place = splits[own].drives.index(steps.drive)
                made, there = (made_by_steps([steps], x, theta)[place] for x in splits)
                more = left[own][place] ** 2 - left[other][place] ** 2
                # All that is left there is less than they would make.
                if there > left[other][place]:
                    yield OwnSteps(_change(steps, own == 1), float(made**2 / max(more, made**2)))


def _left(split: Split, theta: Array) -> Array:
    """Return (D,) what a fit leaves of each drive's output, RMS."""
    (residual,) = split.whole.with_effects(()).residual(theta[None])
    return np.asarray(np.sqrt(np.nanmean(split.whole.rows(residual) ** 2, axis=1)))


def _change(steps: EncoderSteps, later: bool) -> Change:
    suspect = Suspect('effect', steps.at.effect, steps.drive, 'after' if later else 'before')
    ends = steps.step - steps.error, steps.step + steps.error
    return Change(suspect, (Size(steps.name, steps.step, *ends, steps.unit, np.nan),), SURE, ())
