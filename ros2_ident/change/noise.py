# SPDX-License-Identifier: Apache-2.0
"""Noise that one side has more of, and encoder steps that make it.

No fit tells the course of what steps make from noise: they are looked for where they show, see
`gap.suspects.encoder_steps`.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
import math

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.change.result import Apart, Change, Size, Suspect
from ros2_ident.errors import IdentError
from ros2_ident.gap.recordings import Part, Split
from ros2_ident.gap.suspects.encoder_steps import (
    EncoderSteps,
    find_encoder_steps,
    made_by_steps,
    SURE,
)
from ros2_ident.identify.hidden import MATERIAL, Rows
from ros2_ident.models import FullModel, Output
from ros2_ident.search.changes import as_normal, evidence_of, Logs
from ros2_ident.search.noise import NoiseModel

# Of what is predicted wholly the power and its scatter are not quite nothing.
_NOTHING = 1e-300


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


def noise_apart(
    white: Array,
    rows: Rows,
    logs: Logs,
    noise: Sequence[NoiseModel],
    outputs: Sequence[Output],
    price: float,
) -> Iterator[Apart]:
    """Yield the outputs whose noise differs between the sides, further than parts of one do.

    Args:
        white: (R,) what a fit with all that may be missing leaves, whitened by the noise.
        rows: The R samples.
        logs: Which rows are of which log.
        noise: The noise of each output.
        outputs: What they are.
        price: Evidence that is asked for.
    """
    several = min(np.bincount(logs.after, minlength=2)) > 1
    power: dict[int, dict[tuple[int, int], list[Array]]] = {}
    for run in rows.runs:
        log = next(i for i, there in enumerate(logs.rows) if run.start < there.stop)
        own, fold = white[run.start : run.stop] ** 2, logs.fold[run.start : run.stop]
        for part in [0] if several else np.unique(fold).tolist():
            here = own if several else own[fold == part]
            power.setdefault(run.place, {}).setdefault((log, part), []).append(here)
    for place, parts in power.items():
        told = np.array([math.log(np.concatenate(x).mean() or _NOTHING) for x in parts.values()])
        later = np.array([bool(logs.after[log]) for log, _ in parts])
        sides = [told[~later], told[later]]
        if min(x.size for x in sides) < 2:
            continue
        freedom, means = told.size - 2, [float(x.mean()) for x in sides]
        within = sum(float(np.sum((x - x.mean()) ** 2)) for x in sides) / freedom
        square = max(within * sum(1.0 / x.size for x in sides), _NOTHING)
        gain = as_normal((means[1] - means[0]) ** 2 / square, freedom)
        if evidence_of(gain, 1) > price and abs(means[1] - means[0]) > math.log(1.0 + MATERIAL**2):
            one, other = (
                math.sqrt(noise[place].variance * math.exp(x)) / outputs[place].weight
                for x in means
            )
            yield Apart('noise', outputs[place].name, one, other, outputs[place].unit)


def _left(split: Split, theta: Array) -> Array:
    """Return (D,) what a fit leaves of each drive's output, RMS."""
    (residual,) = split.whole.with_effects(()).residual(theta[None])
    return np.asarray(np.sqrt(np.nanmean(split.whole.rows(residual) ** 2, axis=1)))


def _change(steps: EncoderSteps, later: bool) -> Change:
    suspect = Suspect('effect', steps.at.effect, steps.drive, 'after' if later else 'before')
    ends = steps.step - steps.error, steps.step + steps.error
    return Change(suspect, (Size(steps.name, steps.step, *ends, steps.unit, np.nan),), SURE, ())
