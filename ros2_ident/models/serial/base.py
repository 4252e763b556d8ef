# SPDX-License-Identifier: Apache-2.0
"""Which inertial parameters of an arm a motion can show, and what they stand for together."""

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array

# A column counts as new where this much of it lies outside the others, as nothing where it is
# this much of the longest: frames that are turned by half pi leave a rounding error behind.
_NEW, _NOTHING = 1e-7, 1e-10


def base_columns(terms: Array, given: Array) -> tuple[npt.NDArray[np.int64], Array, Array]:
    """Return the columns that are independent of those before, and how the others add to them.

    Orthogonalised in the order of the columns, as the QR decomposition without exchange that
    Gautier (IEEE ICRA 1990) reads base parameters from; what depends on columns before is left out
    at once, so that its rounding is no direction.

    Args:
        terms: (M, C) terms of a motion that shows whatever can be shown.
        given: (M, E) terms of other parameters that come before all of these.

    Returns:
        (B,) the columns kept, rising, (B, C) the grouping: base parameters are its product with
        the C parameters, and (E, C) what the other parameters stand for beside themselves.
    """
    basis = np.empty((len(terms), 0))
    kept: list[int] = []
    every = np.concatenate([given, terms], axis=1).T
    lengths = np.linalg.norm(every, axis=1)
    for number, (column, length) in enumerate(zip(every, lengths, strict=True)):
        if length <= _NOTHING * lengths.max():
            continue
        rest = column / length
        for _ in range(2):
            rest = rest - basis @ (basis.T @ rest)
        left = float(np.linalg.norm(rest))
        if left > _NEW:
            basis = np.concatenate([basis, (rest / left)[:, None]], axis=1)
            kept.append(number - given.shape[1])
    columns = np.array([n for n in kept if n >= 0], dtype=np.int64)
    whole = np.concatenate([given, terms[:, columns]], axis=1)
    scale = np.maximum(np.linalg.norm(whole, axis=0), 1e-300)
    found = np.linalg.lstsq(whole / scale, terms, rcond=1e-12)[0] / scale[:, None]
    found[np.abs(found) < 1e-9] = 0.0
    beside, grouping = np.split(found, [given.shape[1]])
    grouping[:, columns] = np.eye(len(columns))
    beside[:, columns] = 0.0
    return columns, grouping, beside
