# SPDX-License-Identifier: Apache-2.0
"""Inertials that a body can have, and those of them that a fit and a description ask for.

Ten numbers are the inertials of a body where its pseudo-inertia, a symmetric 4 x 4 matrix, is
positive definite: a cone. How far two bodies are apart says the Bregman divergence of -log det on
that cone, which does not depend on frames and units: Lee, Wensing, Park, Geometric robot dynamic
identification, IEEE T-RO 36(2), 2020; the cone is Wensing, Kim, Slotine, IEEE RA-L 3(1), 2018.
"""

import math

import numpy as np
import scipy

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode

# Least radius of gyration that a described link is given, m; below this mass [kg] it is none.
_SMALLEST, _MASSLESS = 1e-3, 1e-9
# Newton's steps at most, and the decrement at which they end.
_STEPS, _DONE = 200, 1e-11
# Share of the decrease that a shortened step has to bring.
_ENOUGH = 0.1


# Places of inertias xx, xy, yy, xz, yz, zz in a tensor.
SIX = (..., [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2])


def tensors(six: Array) -> Array:
    """Return inertia tensors (..., 3, 3) of inertias (..., 6)."""
    out = np.empty((*six.shape[:-1], 3, 3))
    out[SIX] = out.swapaxes(-1, -2)[SIX] = six
    return out


def pseudo_inertia(inertials: Array) -> Array:
    """Return (L, 4, 4) pseudo-inertias of (L, 10) inertials: second moments, moments, mass.

    Inertials are mass, first moments and inertias xx, xy, yy, xz, yz, zz about the frame's origin.
    """
    xx, _, yy, _, _, zz = inertials[:, 4:].T
    half = 0.5 * (xx + yy + zz)
    out = np.empty((len(inertials), 4, 4))
    out[:, :3, :3] = half[:, None, None] * np.eye(3) - tensors(inertials[:, 4:])
    out[:, :3, 3] = out[:, 3, :3] = inertials[:, 1:4]
    out[:, 3, 3] = inertials[:, 0]
    return out


def inertials_of(pseudo: Array) -> Array:
    """Return (L, 10) inertials of (L, 4, 4) pseudo-inertias."""
    second = pseudo[:, :3, :3]
    trace = np.trace(second, axis1=1, axis2=2)[:, None, None]
    inertia = (trace * np.eye(3) - second)[SIX]
    return np.concatenate([pseudo[:, 3, 3, None], pseudo[:, :3, 3], inertia], axis=1)


def mended(inertials: Array) -> Array:
    """Return (L, 10) inertials as they are, or where no body has them the nearest that one has.

    Mass and centre stay; about the centre nothing is smaller than a body of 1 mm. What has no mass
    is left alone.
    """
    out = inertials.copy()
    for number, (mass, *moment) in enumerate(inertials[:, :4]):
        if mass <= _MASSLESS:
            continue
        pseudo = pseudo_inertia(inertials[number : number + 1])
        away = np.outer(moment, moment) / mass
        sizes, axes = np.linalg.eigh(pseudo[0, :3, :3] - away)
        least = mass * _SMALLEST**2
        if sizes.min() < least:
            pseudo[0, :3, :3] = axes @ np.diag(np.maximum(sizes, least)) @ axes.T + away
            out[number] = inertials_of(pseudo)[0]
    return out


# (10, 4, 4) symmetric matrices that are orthonormal.
_BASIS = np.zeros((10, 4, 4))
for _n, (_i, _j) in enumerate(zip(*np.triu_indices(4), strict=True)):
    _BASIS[_n, _i, _j] = _BASIS[_n, _j, _i] = 1.0 if _i == _j else math.sqrt(0.5)


class _Around:
    """Bodies around described ones: P = L (1 + X) L', P_0 = L L', X by ten coordinates each.

    The described inertials (L, 10) are what bodies can have, or without mass.
    """

    def __init__(self, described: Array) -> None:
        self.count = len(described)
        self.bodies = np.flatnonzero(described[:, 0] > _MASSLESS)
        roots = np.linalg.cholesky(pseudo_inertia(described[self.bodies]))
        moved = np.einsum('lij,njk,lmk->lnim', roots, _BASIS, roots)
        self.each = np.array([inertials_of(one).T for one in moved]).reshape(-1, 10, 10)

    def change(self) -> Array:
        """Return (10 L, C) how all inertials follow the coordinates of the bodies."""
        out = np.zeros((10 * self.count, 10 * len(self.bodies)))
        for n, (body, each) in enumerate(zip(self.bodies, self.each, strict=True)):
            out[10 * body : 10 * body + 10, 10 * n : 10 * n + 10] = each
        return out

    def divergence(self, x: Array) -> tuple[float, Array, Array]:
        """Return the sum of the bodies' divergences, (C,) its slope, (C, C) its curvature.

        Infinite where a body leaves the cone.
        """
        shapes = np.asarray(np.eye(4) + np.einsum('bn,nij->bij', x.reshape(-1, 10), _BASIS))
        try:
            roots = np.linalg.cholesky(shapes)
        except np.linalg.LinAlgError:
            return math.inf, x, np.eye(len(x))
        logs = 2.0 * np.log(np.einsum('bii->bi', roots)).sum()
        value = float(np.einsum('bii->', shapes) - 4.0 * len(shapes) - logs)
        inverse = np.linalg.inv(shapes)
        slope = np.einsum('nij,bij->bn', _BASIS, np.eye(4) - inverse)
        turned = np.einsum('bij,njk->bnik', inverse, _BASIS)
        each = np.einsum('bnij,bmji->bnm', turned, turned)
        return value, slope.ravel(), scipy.linalg.block_diag(*each)


def nearest(
    described: Array,
    told: Array,
    wanted: Array,
    precision: Array,
    held: tuple[Array, Array],
    spread: float,
) -> Array:
    """Return the bodies that a fit and a description make most probable together.

    Args:
        described: (L, 10) inertials that are believed before, see `mended`.
        told: (B, 10 L) what the fit tells of changes of inertials.
        wanted: (B,) what it says they are.
        precision: (B, B) how sure it is: the inverse of their covariance.
        held: (H, 10 L) combinations of changes, and (H,) what they have to be.
        spread: Standard deviation of a link's mass before, as a share of it.

    Returns:
        (L, 10) inertials, each in the cone.

    Raises:
        IdentError: BAD_VALUES where the steps do not end.
    """
    around = _Around(described)
    change = around.change()
    bound = held[0] @ change
    free = scipy.linalg.null_space(bound) if len(bound) else np.eye(change.shape[1])
    first = np.linalg.lstsq(bound, held[1], rcond=None)[0]
    # A body whose every moment grows by e is 2 e^2 away: one deviation costs a half.
    weight = 1.0 / (4.0 * spread**2)
    slopes, wanted = told @ change @ free, wanted - told @ change @ first

    def value(y: Array) -> tuple[float, Array, Array]:
        apart, slope, curve = around.divergence(first + free @ y)
        off = slopes @ y - wanted
        return (
            weight * apart + 0.5 * float(off @ precision @ off),
            weight * (free.T @ slope) + slopes.T @ (precision @ off),
            weight * (free.T @ curve @ free) + slopes.T @ precision @ slopes,
        )

    def bodies(y: Array) -> Array:
        moved = described.ravel() + change @ (first + free @ y)
        return np.asarray(moved.reshape(described.shape))

    y = np.zeros(free.shape[1])
    here = value(y)
    for _ in range(_STEPS):
        step = -np.linalg.solve(here[2], here[1])
        decrease = -float(here[1] @ step)
        if decrease <= _DONE * (1.0 + abs(here[0])):
            # Newton's last step doubles the digits.
            return bodies(y + step)
        length = 1.0
        there = value(y + step)
        while not there[0] <= here[0] - _ENOUGH * length * decrease and length > _DONE:
            length *= 0.5
            there = value(y + length * step)
        if length <= _DONE:
            # What is left of the decrease is rounding.
            return bodies(y)
        y, here = y + length * step, there
    raise ErrorCode.BAD_VALUES.error(
        'the inertials that fit and description ask for together are not found; '
        'identify with a longer motion'
    )
