# SPDX-License-Identifier: Apache-2.0
"""Whether a result can be believed: what the gates found, and what the model leaves of the log."""

from collections.abc import Sequence
from dataclasses import replace
import math

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.gates import GateReport, sentences
from ros2_ident.gates.scale import FLOORS
from ros2_ident.identify.certainty import doubted
from ros2_ident.identify.problem import Problem
from ros2_ident.identify.result import Identification, Outcome, PoorFit
from ros2_ident.search.noise import fast_noise

# A model that leaves this share of how an output varies, and far more than its noise, is not the
# machine's.
LARGE = 0.3
# What is said of every parameter then.
NOTE = 'means nothing: the model does not fit the log'


def poorly_fitted(problem: Problem, residual: Array) -> tuple[PoorFit, ...]:
    """Return the outputs of which a fit leaves a large part.

    Args:
        problem: What was fitted.
        residual: (R,) what is left, as `Problem.residuals` has it; empty where nothing was.
    """
    if not residual.size or not np.isfinite(residual).all():
        return ()
    outputs = problem.models[0].outputs
    rest: list[list[Array]] = [[] for _ in outputs]
    varied: list[list[Array]] = [[] for _ in outputs]
    for o, row, there in problem.parts(residual):
        rest[o].append(row)
        varied[o].append(there - there.mean() if there.size else there)
    found = []
    for output, parts, measured in zip(outputs, rest, varied, strict=True):
        left, spread = (float(np.sqrt(np.mean(np.concatenate(x) ** 2))) for x in (parts, measured))
        stated = problem.noise if output.quantity == outputs[0].quantity else 0.0
        noise = max(stated, fast_noise(*parts))
        if left > LARGE * spread and left > FLOORS * noise:
            share = left / spread if spread > 0.0 else math.inf
            floors = left / noise if noise > 0.0 else math.inf
            found.append(PoorFit(output.name, left, output.unit, share, floors))
    return tuple(found)


def judged(
    result: Identification, report: GateReport, poor: Sequence[PoorFit]
) -> Identification:
    """Return a result with the findings of the gates, that claims no more than can be.

    Args:
        result: What the fit came to.
        report: What log and machine file say of each other.
        poor: Outputs of which the fit leaves a large part.
    """
    first = report.contradictions[:1]  # is the headline
    warned = sentences(g for g in report.gates if g.level != 'ok' and g not in first)
    warnings = tuple(dict.fromkeys((*warned, *result.quality.warnings)))
    quality = replace(result.quality, warnings=warnings)
    result = replace(result, gates=report.gates, quality=quality, poor=tuple(poor))
    ended = result.outcome in (Outcome.IDENTIFIED, Outcome.NOT_IDENTIFIABLE)
    spent = result.outcome is Outcome.BUDGET_SPENT
    if (poor and ended) or (report.blocked and (ended or spent)):
        return replace(
            result,
            outcome=Outcome.CONTRADICTED,
            parameters=tuple(doubted(p, NOTE) for p in result.parameters),
        )
    return result
