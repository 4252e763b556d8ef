# SPDX-License-Identifier: Apache-2.0
"""Certainty of each parameter: identified, bounded, or not determined.

A parameter is identified where its 95 % interval, with what the model may lack, is narrower than
its value and than half of its box; one that a machine can be without (friction, an offset, a
delay) also where no value of the interval changes an output by more than `LITTLE` of it. Otherwise
an interval that ends inside the box bounds it.
"""

from dataclasses import replace

import numpy as np

from ros2_ident.identify.problem import Problem
from ros2_ident.identify.result import bound_of, ParameterEstimate, State
from ros2_ident.search.evidence import Evidence
from ros2_ident.search.fit import Fitted

# An interval wider than this part of the box says no more than the box does.
MOST_OF_BOX = 0.5
# Share of an output that does not matter.
LITTLE = 0.01

NOT_IDENTIFIABLE = 'not identifiable from this data'
# Of a parameter that noise alone would leave identified.
HIDDEN = 'not identified once model error is allowed for'
NIL = 'below 1 % of the output'
# Of what stands for several parameters of links and rotors that show together only.
BASE = 'base parameter, of either sign'
CUT_SHORT = 'interval not computed: the run was cut short'


def state_of(value: float, low: float, high: float, lower: float, upper: float) -> State:
    """Return what is known of a value with an interval (low, high) in a box (lower, upper)."""
    if high - low <= min(abs(value), MOST_OF_BOX * (upper - lower)):
        return 'identified'
    return 'bounded' if bound_of(low, high, lower, upper, '') else 'not determined'


def doubted(estimate: ParameterEstimate, why: str) -> ParameterEstimate:
    """Return an estimate whose interval means nothing, with the reason."""
    return replace(estimate, state='not determined', note=why)


def estimates_of(
    problem: Problem, found: Fitted, evidence: Evidence | None
) -> tuple[ParameterEstimate, ...]:
    """Return the parameters with intervals, states and words; without intervals where cut short.

    Args:
        problem: What was solved.
        found: What was found.
        evidence: What the residual shows of what is missing; None where not weighed.
    """
    known, nothing = found.intervals, np.full(len(found.theta), np.nan)
    noise = (known.low, known.high) if known else (nothing, nothing)
    ends = noise
    if evidence is not None:
        ends = evidence.ends(found.theta, problem.low, problem.high, *noise)
    rows = np.stack([*ends, *noise], axis=1).tolist()
    return tuple(_estimate(problem, found, k, *row) for k, row in enumerate(rows))


def _estimate(
    problem: Problem, found: Fitted, k: int,
    low: float, high: float, noise_low: float, noise_high: float,
) -> ParameterEstimate:  # fmt: skip
    p, value = problem.parameters[k], float(found.theta[k])
    state = state_of(value, low, high, p.low, p.high)
    bound = bound_of(low, high, p.low, p.high, p.unit)
    said, hidden = [], False
    if found.intervals is None:
        at = 'lower' if value <= p.low else 'upper' if value >= p.high else ''
        said.append(CUT_SHORT)
    else:
        at = found.intervals.at_bound[k]
        if state != 'identified' and _is_nil(problem, found, k, low, high):
            state = 'identified'
            said.append(f'{bound}: {NIL}' if bound else NIL)
        elif state != 'identified':
            hidden = state_of(value, noise_low, noise_high, p.low, p.high) == 'identified'
            said += [x for x in (bound, HIDDEN if hidden else '') if x] or [NOT_IDENTIFIABLE]
    said += [f'at its {at} bound'] if at else []
    said += [BASE] if p.kind == 'base' else []
    return ParameterEstimate(
        p.name, p.unit, value, low, high, p.low, p.high, float(found.ga.theta[k]), bool(at), state,
        p.kind, ', '.join(said), noise_low, noise_high, hidden,
    )  # fmt: skip


def _is_nil(problem: Problem, found: Fitted, number: int, low: float, high: float) -> bool:
    """Return whether nothing of an interval shows in any output, beside there being none."""
    p = problem.parameters[number]
    if p.absent is None or high - low > MOST_OF_BOX * (p.high - p.low):
        return False
    candidates = np.repeat(found.theta[None, :], 3, axis=0)
    candidates[:, number] = np.clip([p.absent, low, high], p.low, p.high)
    without, *others = problem.residuals(candidates)
    changes = (x for other in others for x in problem.left(other - without))
    return all(x.rms == 0.0 or x.share <= LITTLE for x in changes)
