# SPDX-License-Identifier: Apache-2.0
"""How an identification ended, and which parameters it determines."""

from collections.abc import Iterator, Sequence
import math

from ros2_ident.gates import GateReport
from ros2_ident.identify.result import Identification, Outcome, ParameterEstimate
from ros2_ident.recording.limits import enumerated
from ros2_ident.search import RefineStatus, StopReason
from ros2_ident.words.figures import figure, quantity

# Parameters that a sentence names; every one has its line in the result.
NAMED = 4


def message(result: Identification) -> str:
    """Return the outcome with its reasons and the remedy where there is one."""
    return ' '.join(_parts(result))


def _parts(result: Identification) -> Iterator[str]:
    contradiction = GateReport(result.gates).headline
    if contradiction:
        yield contradiction
    if result.poor:
        left = ', '.join(
            f'{100.0 * x.share:.0f} % of what varies in {x.name} ({x.left:.3g} {x.unit}, '
            f'{figure(x.floors)} times the noise)'
            for x in result.poor
        )
        remedy = (
            ', so it is not the one of this machine, or not with these constants; check units, '
            'gains, couplings and the kind of machine'
        )
        yield f'The model leaves {left}{"" if contradiction else remedy}.'
    yield _ended(result)


def _ended(result: Identification) -> str:
    outcome = result.outcome
    if outcome is Outcome.CONTRADICTED:
        return f'No parameter is identified. {at_bounds(result.parameters)}'.rstrip()
    if outcome is Outcome.DIVERGED:
        return (
            'Every candidate diverged; narrow the bounds in the machine file to values the '
            'machine can have, and check the controller gains there.'
        )
    if outcome is Outcome.CANCELLED:
        if math.isfinite(result.cost.ga):
            return (
                'The run was cancelled; the values are the best found until then and may be far '
                'from the optimum.'
            )
        return 'The run was cancelled before a candidate was simulated to its end.'
    if outcome is Outcome.BUDGET_SPENT:
        spent = StopReason.EVALUATIONS.value, RefineStatus.EVALUATIONS.value
        ends = result.search_stop, result.refinement
        return next((end for end in ends if end in spent), StopReason.SECONDS.value)
    if result.rival:
        there = ', '.join(
            f'{p.name} {x:.5g}' for p, x in zip(result.parameters, result.rival, strict=True)
        )
        return (
            f'The cost has several minima that fit almost alike, another at {there}; the best may '
            'not have been found. Search again with a larger first population and another seed: '
            'the lower cost is the better answer.'
        )
    loose = undetermined(result.parameters)
    text = determined(result.parameters) + (f': {loose}.' if loose else '.')
    return f'{text} {at_bounds(result.parameters)}'.rstrip()


def at_bounds(estimates: Sequence[ParameterEstimate]) -> str:
    """Return which parameters ended at a bound, with their values; empty for none.

    None lies beyond a lower bound of nothing, as of friction.
    """
    ends = [
        f'{e.name} ({quantity(e.value, e.unit)})'
        for e in estimates
        if e.at_bound and (e.lower_bound or e.value > 0.5 * e.upper_bound)
    ]
    if not ends:
        return ''
    return (
        f'{enumerated(ends, NAMED)} {"lies" if len(ends) == 1 else "lie"} at a bound: the true '
        'value can lie beyond; check the bounds in the machine file.'
    )


def determined(estimates: Sequence[ParameterEstimate]) -> str:
    """Return how many parameters are identified, or are not, as the begin of a sentence."""
    count, loose = len(estimates), sum(not e.identifiable for e in estimates)
    if not loose:
        return f'All {count} parameters are identified'
    return f'This data does not determine {loose} of {count} parameters'


def undetermined(estimates: Sequence[ParameterEstimate]) -> str:
    """Return which parameters are not identified, and the remedy; empty for none."""
    loose = [e for e in estimates if not e.identifiable]
    if not loose:
        return ''
    named = [f'{e.name} ({e.bound})' if e.state == 'bounded' else e.name for e in loose]
    remedy = (
        'the model lacks something that trades with them: find it with `ident diagnose`'
        if all(e.hidden for e in loose)
        else 'record a motion that excites them, or fix them at known values'
    )
    return f'{enumerated(named, NAMED)}; {remedy}'
