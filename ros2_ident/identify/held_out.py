# SPDX-License-Identifier: Apache-2.0
"""Held-out error: what an estimate leaves of data that it was not fitted on."""

from dataclasses import replace

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.identify.data import Data
from ros2_ident.identify.hidden import Weighed
from ros2_ident.identify.problem import Problem
from ros2_ident.identify.result import Identification
from ros2_ident.search.refine import BOX_DEVIATION

# A log is left out in so many parts.
PARTS = 4
QUARTERS = 'each quarter of the log, predicted from the other three'
REST = 'parts of the log that were not fitted on'


def with_held_out(
    result: Identification, problem: Problem, weighed: Weighed | None, check: Problem | None
) -> Identification:
    """Return a result with its held-out error.

    It is judged on the check recording where there is one, else on the parts of a long log that
    were not fitted on, else on each quarter of the log in turn. The estimate stays that of all.

    Args:
        result: The result.
        problem: What was solved.
        weighed: What its residual shows; None where the run was cut short.
        check: The same problem on data to judge on.
    """
    if not np.isfinite(result.theta).all():
        return result
    on = REST if check is None else check.data.source
    if check is None and problem.setup is not None:
        check = problem.setup.held_out()
    if check is not None:
        theta = check.taken_from(problem, result.theta)
        left = check.left(check.residuals(theta[None, :])[0])
        return replace(result, validation=left, validated_on=on)
    if weighed is None:
        return result
    grown = zip(
        result.residuals,
        problem.left(quarters(problem, weighed, result.theta), weighed.rows.masks),
        problem.left(weighed.residual, weighed.rows.masks),
        strict=True,
    )
    # What is weighed leaves out a log's start and part of a long one; the whole grows likewise.
    validation = tuple(
        replace(whole, rms=whole.rms * factor, share=whole.share * factor)
        for whole, out, fitted in grown
        for factor in [out.rms / fitted.rms if fitted.rms > 0.0 else 1.0]
    )
    return replace(result, validation=validation, validated_on=QUARTERS)


def check_problem(problem: Problem, check: Data) -> Problem:
    """Return the same problem on recordings to judge on.

    Args:
        problem: What is to be solved.
        check: The recordings.

    Raises:
        IdentError: INVALID_GOAL where a parameter has a value of its own in every bag, or the
            models are a user's own; or as `problem_of`.
    """
    if problem.setup is None:
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            'a model brings its own data, and no other can be judged on; leave out check',
        )
    other = problem.setup.judged_on(check)
    own = [p.name for p in other.parameters if p.name not in problem.names]
    if own:
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            f'{own[0]} has a value of its own in every bag (--each), so that no other bag can be '
            'predicted; leave out --check, or share the parameter',
        )
    return other


def quarters(problem: Problem, weighed: Weighed, theta: Array) -> Array:
    """Return (R,) what the estimate from all other parts of the log leaves of each part.

    That estimate is a Gauss-Newton step away from the one of the whole log; no fit is repeated.

    Args:
        problem: What was solved.
        weighed: Residual and slopes at its solution.
        theta: (N,) the solution.
    """
    slopes, residual, blocks = weighed.slopes, weighed.residual, weighed.rows.blocks
    part = (blocks - blocks.min()) * PARTS // (int(np.ptp(blocks)) + 1)
    parts = [part == k for k in np.unique(part)]
    # A triangular factor says all that a part does, in few rows.
    factors = [np.linalg.qr(np.column_stack([slopes[x], residual[x]]), mode='r') for x in parts]
    size = float(np.sqrt(np.mean(residual**2)))
    box = np.column_stack([np.eye(theta.size) * size / BOX_DEVIATION, np.zeros(theta.size)])
    unit = (theta - problem.low) / (problem.high - problem.low)
    left = residual.copy()
    for k, rows in enumerate(parts):
        others = np.vstack([*factors[:k], *factors[k + 1 :], box])
        step = np.linalg.lstsq(others[:, :-1], -others[:, -1], rcond=None)[0]
        left[rows] += slopes[rows] @ (np.clip(unit + step, 0.0, 1.0) - unit)
    return left
