# SPDX-License-Identifier: Apache-2.0
"""Full inertials of an arm's links, from base parameters and from what was believed before."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ros2_ident.arrays import Array, rms
from ros2_ident.errors import ErrorCode
from ros2_ident.models.drives.model import DriveModel
from ros2_ident.models.serial.cone import mended, nearest
from ros2_ident.models.serial.model import Serial

# Step of a derivative and least share of the box that counts, in box widths; also the least share
# of the effort that is ever missed.
_STEP = 1e-4
# Of a parameter that is held: its standard deviation, as a share of its box.
_HELD = 1e-6


def information_of(model: DriveModel, theta: Array, deviations: Mapping[str, float]) -> Array:
    """Return (N, N) what the log says of the parameters: the inverse of their covariance.

    Joints count by what is left of them. As a whole it is as sure as the estimate's own intervals,
    which allow for what the model lacks; the box is all that is known where the log says nothing.

    Args:
        model: The model along the log.
        theta: (N,) the estimate.
        deviations: Its standard deviations by name, inf where the log sets no limit.
    """
    width = np.array([p.high - p.low for p in model.parameters])
    step = np.diag(_STEP * width)
    up, down, left = np.split(
        model.residuals(np.concatenate([theta + step, theta - step, theta[None]])),
        [len(theta), 2 * len(theta)],
    )
    counts = np.isfinite(model.measured).sum(axis=1)
    parts = np.split(left[0], np.cumsum(counts)[:-1])
    sizes = [
        max(rms(part), _STEP * rms(row)) for part, row in zip(parts, model.measured, strict=True)
    ]
    weights = 1.0 / np.repeat(sizes, counts)
    slopes = ((up - down) / (2.0 * _STEP * width[:, None]) * weights).T
    known = slopes.T @ slopes
    box = np.diag(width**-2.0)
    alone = np.diag(np.linalg.inv(known + _STEP * box))
    told = np.array([deviations[p.name] for p in model.parameters])
    sure = np.isfinite(told) & (told < width)
    factor = float(np.median(told[sure] ** 2 / alone[sure])) if sure.any() else 1.0
    return np.asarray(known / factor + box)


@dataclass(frozen=True)
class Links:
    """Links that bodies can be, and the candidate that they are.

    Attributes:
        inertials: (D, 10) what they have now, in the frames of the joints; the last one with what
            it carries.
        theta: (N,) the candidate, moved as little as its uncertainty allows.
        mended: Bodies whose described inertials none can have.
    """

    inertials: Array
    theta: Array
    mended: tuple[str, ...]


def links_of(model: Serial, theta: Array, information: Array, spread: float) -> Links:
    """Return the links that a fit and the description make most probable together.

    The fit says what it knows of base parameters; the description says the rest, a link's mass
    with the standard deviation `spread` and its shape likewise. What else was identified moves
    with the base parameters to where the log wants it then.

    Args:
        theta: (N,) the fit.
        information: (N, N) the inverse of its covariance, positive definite.
        spread: Share of a link's mass.

    Raises:
        IdentError: INVALID_GOAL where no description says what the links are.
    """
    arm, inertials = model.arm, model.inertials
    if not arm.bodies or not any(body.inertials[0] > 0.0 for body in arm.bodies):
        raise ErrorCode.INVALID_GOAL.error(
            'the machine file describes no links with a mass; give geometry.description, a URDF '
            'or an MJCF'
        )
    names, middle = inertials.names, inertials.middles
    free = {p.name: n for n, p in enumerate(model.parameters)}
    columns = np.array([free[name] for name in names if name in free], dtype=np.int64)
    sought = np.array([name in free for name in names], dtype=np.bool_)
    value = np.array([theta[free[n]] if n in free else model.fixed[n] for n in names], dtype=float)
    described = np.array([body.inertials for body in arm.bodies])
    believed = mended(described)
    told, held = inertials.changes
    # What was told of a description that no body can have counts from where it is mended.
    moved = (believed - described).ravel()
    others = np.setdiff1d(np.arange(len(theta)), columns)
    follow = np.linalg.solve(
        information[np.ix_(others, others)], information[np.ix_(others, columns)]
    )
    known = information[np.ix_(columns, columns)]
    sure = np.zeros((len(names), len(names)))
    sure[np.ix_(sought, sought)] = known - information[np.ix_(columns, others)] @ follow
    fixed = np.flatnonzero(~sought)
    sure[fixed, fixed] = (_HELD * inertials.widths[fixed]) ** -2.0
    wanted = value - middle - told @ moved
    found = nearest(believed, told, wanted, sure, (held, -held @ moved), spread)
    change = told @ (found - described).ravel()
    shift = (middle + change - value)[sought]
    out = theta.copy()
    out[columns] += shift
    out[others] -= follow @ shift
    changed = (believed != described).any(axis=1)
    found = np.vstack([found[:-1], found[-1] + model.carried(out)])
    return Links(found, out, tuple(x.name for x, y in zip(arm.bodies, changed, strict=True) if y))


def effort_of(model: Serial, links: Links) -> Array:
    """Return (D, K) what links ask of the joints along the recorded motion, N m or N."""
    return model.links_effort(links.inertials - np.array([b.inertials for b in model.arm.bodies]))
