# SPDX-License-Identifier: Apache-2.0
"""Whether a result can be believed: what the gates found, and what the model leaves of the log."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.gates import GateReport, sentences
from ros2_ident.gates.scale import figure, FLOORS
from ros2_ident.identify.certainty import doubted
from ros2_ident.identify.problem import Problem
from ros2_ident.identify.result import Identification, Outcome
from ros2_ident.search.noise import fast_noise

# A model that leaves this share of how an output varies, and far more than its noise, is not the
# machine's.
LARGE = 0.3
# What is said of every parameter then.
NOTE = 'means nothing: the model does not fit the log'


@dataclass(frozen=True)
class PoorFit:
    """An output that the model does not fit.

    Attributes:
        name: The output: a drive, or `drive.position`.
        left: RMS of what is left [`unit`].
        unit: Its unit.
        share: The same over the standard deviation of what was measured.
        floors: The same over the noise.
    """

    name: str
    left: float
    unit: str
    share: float
    floors: float

    def __str__(self) -> str:
        """Return it as a part of a sentence."""
        return (
            f'{100.0 * self.share:.0f} % of what varies in {self.name} ({self.left:.3g} '
            f'{self.unit}, {figure(self.floors)} times the noise)'
        )


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
    """Return a result that says first what the gates found, and claims no more than can be.

    Args:
        result: What the fit came to.
        report: What log and machine file say of each other.
        poor: Outputs of which the fit leaves a large part.
    """
    quality = replace(
        result.quality, warnings=tuple(dict.fromkeys((*_said(report), *result.quality.warnings)))
    )
    result = replace(result, gates=report.gates, quality=quality)
    left = ''
    if poor:
        left = f'The model leaves {", ".join(map(str, poor))}'
        left += '.' if report.headline else (
            ', so it is not the one of this machine, or not with these constants; check units, '
            'gains and the kind of machine.'
        )
    ended = result.outcome in (Outcome.IDENTIFIED, Outcome.NOT_IDENTIFIABLE)
    spent = result.outcome is Outcome.BUDGET_SPENT
    if (left and ended) or (report.blocked and (ended or spent)):
        message = _joined(report.headline, left, 'No parameter is identified.')
        return replace(
            result,
            outcome=Outcome.CONTRADICTED,
            message=message,
            parameters=tuple(doubted(p, NOTE) for p in result.parameters),
        )
    return replace(result, message=_joined(report.headline, left, result.message))


def _said(report: GateReport) -> tuple[str, ...]:
    """Return what the gates warn of, but for what is the headline."""
    first = report.contradictions[:1]
    return tuple(sentences(g for g in report.gates if g.level != 'ok' and g not in first))


def _joined(*parts: str) -> str:
    """Return sentences as one text; empty ones are passed over."""
    return ' '.join(part for part in parts if part)
