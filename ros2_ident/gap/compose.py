# SPDX-License-Identifier: Apache-2.0
"""From what the rounds found to the diagnosis as a value."""

from collections.abc import Iterator, Mapping, Sequence
import math

import numpy as np

from ros2_ident.effects import get_effect
from ros2_ident.gap.blocks import Blocks, Interval
from ros2_ident.gap.case import Case
from ros2_ident.gap.coordinates import motion_of
from ros2_ident.gap.criteria import at_bound
from ros2_ident.gap.diagnosis import Diagnosis, DriveGap, Ranked, Step, Trace, Value
from ros2_ident.gap.explain import Explained, Explainer
from ros2_ident.gap.fits import Explanation
from ros2_ident.gap.floor import Floor
from ros2_ident.gap.localise import Finding
from ros2_ident.gap.reading import CoarseReading
from ros2_ident.gap.verdict import (
    advice,
    cannot_show,
    effect_of,
    NAMELESS,
    NONE,
    OFTEN,
    PUSHED,
    REFUSED,
    RESTLESS,
    titled,
    UNKNOWN,
    Verdict,
    Weighed,
)
from ros2_ident.gap.wording import length, of_output, small
from ros2_ident.gates.scale import MORE
from ros2_ident.models import EffectAt, FullModel
from ros2_ident.search.evidence import Evidence


def compose(
    explainer: Explainer,
    found: Explained,
    verdict: Verdict,
    gates: Sequence[tuple[str, str, str]],
    where: tuple[Finding, ...],
    hidden: tuple[EffectAt, ...],
    seconds: float,
    seed: int,
) -> Diagnosis:
    """Return the diagnosis.

    Args:
        explainer: Who ran the rounds.
        found: What came of them.
        verdict: What follows from it.
        gates: What was checked before, as (name, level, sentence).
        where: Where the gap lies.
        hidden: Effects that the motion cannot show.
        seconds: Time taken, s.
        seed: Of the resampling.
    """
    floor, fits, case = explainer.floor, explainer.fits, explainer.case
    chain = found.chain if verdict.effect not in NAMELESS else found.chain[:1]
    final = chain[-1]
    model = case.fit.with_effects(final.effects).models[0]
    rows = [case.check.rows(e.check_residual / fits.check_weight) for e in found.chain]
    blocks = Blocks(rows, model.cycle, seed=seed, starts=case.check.starts)
    labels = ['nominal', *(titled(at) for at in found.chain[-1].effects)]
    steps = tuple(Step(label, blocks.rms(i)) for i, label in enumerate(labels))
    last = len(found.chain) - 1
    share = blocks.share_closed(0, last, floor) if last else Interval(0.0, math.nan, math.nan)
    again = _again(explainer, found, verdict, blocks)
    evidence = explainer.noise_of(final).evidence if found.complete else None
    per_drive, whole = _per_drive(explainer, found, blocks)
    values = _values(explainer, final, evidence) | _steps(verdict.readings)
    values |= verdict.constants
    nominal = {
        p.name: v
        for p, v in zip(case.fit.with_effects(()).parameters, found.chain[0].theta, strict=True)
    }
    moved = {
        name: (values[name].value - v) / v
        for name, v in nominal.items()
        if name in values and v != 0.0
    }
    return Diagnosis(
        effect=verdict.effect,
        where=verdict.where,
        probability=verdict.probability,
        sentence=_sentence(verdict, explainer, found, per_drive, model, share.value, hidden)
        + _bounded(values),
        also=verdict.also,
        confusable=tuple(_ranked(explainer, found.chain[0], w) for w in verdict.confusable),
        ranking=tuple(_ranked(explainer, found.chain[0], w) for w in verdict.ranking),
        unit=model.unit,
        steps=steps,
        floor=floor,
        share_closed=share,
        held_out=case.held_out,
        evidence={
            'size': explainer.size(found.chain[0]),
            'remaining': found.remaining,
            'closed': verdict.closed,
            'material': explainer.rules.material,
            'share_of_output': whole,
        },
        per_drive=per_drive,
        localisation=where,
        parameters=values,
        moved=moved,
        nominal=nominal,
        gates=tuple(gates),
        not_testable=hidden,
        advice=(
            *_doubts(values),
            *_hints(verdict, again),
            *_hidden_by_noise(verdict, floor, case.drives, model.unit),
            *advice(verdict, hidden, model.travel),
        ),
        again=again,
        complete=found.complete,
        seconds=seconds,
        seed=seed,
        traces=_traces(case, found),
    )


def _hidden_by_noise(
    verdict: Verdict, floor: Floor, drives: Sequence[str], unit: str
) -> Iterator[str]:
    """Say how large a gap slow noise may hide."""
    if verdict.effect in (UNKNOWN, *REFUSED):
        return
    hidden = {
        name: f'{math.sqrt(value**2 - low**2):.2g} {unit}'.strip()
        for name, value, low in zip(drives, floor.per_drive, floor.low, strict=True)
        if value > MORE * low
    }
    if hidden:
        yield (
            f'What is left on {", ".join(hidden)} is so slow that it can be noise or a gap of up '
            f'to {", ".join(hidden.values())}: record longer, or the same motion twice.'
        )


def _again(
    explainer: Explainer, found: Explained, verdict: Verdict, blocks: Blocks
) -> tuple[float, ...]:
    """Return how often each effect named counts again where blocks held out are resampled.

    What the controllers' log vouches for need not show in the outputs.

    Reference:
        Meinshausen and Bühlmann (2010), Stability selection, JRSS B 72(4).
    """
    final, rules = found.chain[-1], explainer.rules
    if not verdict.named or len(found.rests) != len(final.effects):
        return ()
    case, weight = explainer.case, explainer.fits.check_weight
    rows = [case.check.rows(e.check_residual / weight) for e in (*found.rests, final)]
    drawn = Blocks(rows, case.fit.models[0].cycle, length=blocks.length, starts=case.check.starts)
    shares = {
        at: 1.0
        if explainer.restores_law(without, final)
        else drawn.falls(i, -1, explainer.floor, rules.material if i else rules.step)
        for i, (at, without) in enumerate(zip(final.effects, found.rests, strict=True))
    }
    # An encoder's steps are read from a line in the spectrum, not from what a fit closes.
    return tuple(shares.get(at, 1.0) for at in verdict.named)


def _hints(verdict: Verdict, again: Sequence[float]) -> list[str]:
    """Return which effects named do not come again often enough to act on them."""
    return [
        f'{titled(at)} counts in only {100.0 * share:.0f} % of the resampled blocks held out: '
        'take it for a hint and record another log before acting on it.'
        for at, share in zip(verdict.named, again, strict=False)
        if share < OFTEN
    ]


def _traces(case: Case, found: Explained) -> tuple[Trace, ...]:
    """Return every recording beside the nominal fit and the last one."""
    base, last = found.chain[0], found.chain[-1]
    parts = [case.fit, case.check] if case.held_out == 'check bag' else [case.fit]
    traces = []
    for part in parts:
        nominal, extended = part.with_effects(()), part.with_effects(last.effects)
        for number, mask in enumerate(part.masks):
            before = nominal.own(number, base.theta)
            after = extended.models[number].simulate(extended.own(number, last.theta))[0]
            traces.append(
                Trace(
                    held_out=part is case.check,
                    motion=motion_of(nominal.models[number], before[0]),
                    measured=nominal.models[number].measured,
                    extended=after,
                    fitted=mask if part is case.fit else np.zeros_like(mask),
                )
            )
    return tuple(traces)


def _values(
    explainer: Explainer, e: Explanation, evidence: Evidence | None = None
) -> dict[str, Value]:
    joint = explainer.case.fit.with_effects(e.effects)
    low, high, *noise = explainer.ends(e, evidence)
    # Those of the effects come last; the bounds of the others are the machine file's matter.
    sizes = [p for at in e.effects for p in joint.models[0].scaled(at)]
    first = len(joint.parameters) - len(sizes)
    ends = [False] * first + [
        at_bound(p, float(v)) for p, v in zip(sizes, e.theta[first:], strict=True)
    ]
    return {
        p.name: Value(float(v), p.unit, float(lo), float(hi), end, float(less), float(more))
        for p, v, lo, hi, end, less, more in zip(
            joint.parameters, e.theta, low, high, ends, *noise, strict=True
        )
    }


def _steps(readings: Sequence[CoarseReading]) -> dict[str, Value]:
    """Return the steps of the encoders named."""
    out = {}
    for r in readings:
        at = effect_of(r)
        (step,) = get_effect(at.effect).parameters
        name = f'{at.where}.{at.effect}.{step.name}'
        out[name] = Value(r.step, r.unit, r.step - r.error, r.step + r.error)
    return out


def _ranked(explainer: Explainer, base: Explanation, one: Weighed) -> Ranked:
    at, e = one.at, one.model
    gap = float(np.sqrt(np.mean(e.check / explainer.check_count * explainer.fits.floor**2)))
    prefix = f'{at.effect}.' if at.where == 'all' else f'{at.where}.{at.effect}.'
    own = {name: v for name, v in _values(explainer, e).items() if name.startswith(prefix)}
    return Ranked(at, one.probability, gap, explainer.share(base, e), own)


def _bounded(values: Mapping[str, Value]) -> str:
    """Return what the sentence adds where a size ended at a bound of its search."""
    names = [name for name, v in values.items() if v.at_bound]
    ends = 'ends at a bound' if len(names) == 1 else 'end at bounds'
    return f' {", ".join(names)} {ends} of the search.' if names else ''


def _doubts(values: Mapping[str, Value]) -> list[str]:
    """Return what to do about sizes at a bound of their search."""
    return [
        f'{name} ends at a bound of its search, {v.value:.4g} {v.unit}: either the effect is '
        'larger than any that is looked for, or it stands in for another cause; check the unit of '
        'the effort and the constants of the machine file, or repeat the diagnosis without it.'
        for name, v in values.items()
        if v.at_bound
    ]


def _per_drive(
    explainer: Explainer, found: Explained, blocks: Blocks
) -> tuple[dict[str, DriveGap], float]:
    """Return each drive's gap, and the nominal one over the measured output of all, RMS."""
    case, floor, last = explainer.case, explainer.floor, len(found.chain) - 1
    gap = np.maximum(explainer.gap(found.chain[0]), 0.0) * floor.per_drive**2
    output = np.empty(len(case.drives))
    counted = blocks.above(floor, 0, -1)
    out = {}
    for d, name in enumerate(case.drives):
        held_out = case.check.measured(d)
        measured = np.concatenate([*case.fit.measured(d), *held_out])
        output[d] = max(float(np.mean(measured**2)), 1e-300)
        out[name] = DriveGap(
            before=float(np.sqrt(blocks.squares[0, d])),
            after=float(np.sqrt(blocks.squares[-1, d])),
            noise_floor=float(floor.per_drive[d]),
            share_closed=blocks.share_closed(0, last, floor, drive=d).value if last else 0.0,
            torque_rms=float(np.sqrt(np.mean(np.concatenate(held_out) ** 2))),
            share_of_output=float(np.sqrt(gap[d] / output[d])),
            counted=bool(counted[d]),
        )
    return out, float(np.sqrt(gap.sum() / output.sum()))


def _sentence(
    verdict: Verdict,
    explainer: Explainer,
    found: Explained,
    per_drive: Mapping[str, DriveGap],
    model: FullModel,
    share: float,
    hidden: Sequence[EffectAt],
) -> str:
    """Return the answer in words, behind what has to be said first."""
    # One share, on data held out, wherever a diagnosis states one.
    closed = share if len(found.chain) > 1 else verdict.closed
    said = _answer(verdict, explainer, found, per_drive, model, closed)
    if verdict.effect == NONE and hidden:
        said = f'{said[:-1]}; this motion {cannot_show(hidden)}'
    if verdict.effect not in REFUSED:
        said += ''.join(
            f' Or {name} of the machine file is wrong: {x.value:.4g} [{x.low:.4g}, {x.high:.4g}] '
            f'{x.unit} closes as much.'
            for name, x in verdict.constants.items()
        )
    material = explainer.size(found.chain[0]) >= explainer.rules.material
    shares = [g.share_of_output for g in per_drive.values()]
    first = small(shares, model.unit) if material and verdict.effect not in REFUSED else ''
    return ' '.join(filter(None, (verdict.first, first, said)))


def _answer(
    verdict: Verdict,
    explainer: Explainer,
    found: Explained,
    per_drive: Mapping[str, DriveGap],
    model: FullModel,
    closed: float,
) -> str:
    size = explainer.size(found.chain[0])
    if verdict.effect in REFUSED:
        return 'No effect is named.'
    unit, effort = model.unit, model.effort_unit
    level = f'{float(np.mean([g.noise_floor for g in per_drive.values()])):.4g} {unit}'
    worst = list(per_drive.values())[int(explainer.gap(found.chain[0]).argmax())]
    gap = f'{size:.2f} times the noise floor, {of_output(worst.share_of_output, unit)}'
    if verdict.effect == NONE and size < explainer.rules.material:
        return (
            f'Nothing is missing: the largest gap of a drive is {size:.2f} times the noise floor '
            f'({level}), below the {explainer.rules.material:.2g} that counts.'
        )
    if verdict.effect == NONE:
        return (
            f'Nothing can be named: the largest gap of a drive is {gap} '
            f'({level}), and no effect of the catalogue closes enough of it to count.'
        )
    if verdict.pushed:
        made = '; '.join(f'{drive} at {said}' for drive, said in verdict.pushed.items())
        return (
            f'{PUSHED}: {made}. No effect of a machine does that: look for another source of '
            'commands, a hand at the machine, or a fault of the drive.'
        )
    if verdict.restless:
        left = ', '.join(f'{v:.3g} {unit} on {name}' for name, v in verdict.restless.items())
        return (
            f'{RESTLESS}: {left} are left that no effect, motion, position or time predicts, too '
            'slow and too much for the noise of an effort. Look for a load that swings, a frame '
            'that rocks, other axes or a hand at the machine, and state effort_noise as it is at '
            'rest.'
        )
    if verdict.effect == UNKNOWN and not found.complete:
        return (
            f'The run was cut short: a gap of {gap} ({level}) is '
            'there, and nothing was found yet that explains it.'
        )
    if verdict.effect == UNKNOWN:
        tried = len(found.rounds[0].gains) if found.rounds else 0
        best = max((explainer.share(found.chain[0], w.model) for w in verdict.ranking), default=0)
        most = 100 * max(verdict.closed, best, 0)
        return (
            f'Something is missing that is not in the catalogue: the gap on '
            f'{", ".join(verdict.where)} is {gap}, and the best of '
            f'{tried} candidates closes {most:.0f} % of it.'
        )
    steps = ''.join(
        f' {r.drive} reads its position in steps of {length(r.step, r.unit)}: what its controller '
        'commands beside the motion in the log has that period. Its course cannot be repeated by '
        'any simulation, so it does not count as closed.'
        for r in verdict.readings
    )
    steps += ''.join(
        f' The logged effort of {drive} stays at about {size:.3g} {effort} wherever '
        'its control law asks for more. No constant limit repeats its course, so it does not '
        'count as closed.'
        for drive, size in verdict.limits.items()
    )
    places: dict[str, list[str]] = {verdict.effect: [*verdict.where]}
    for at in verdict.also:
        places.setdefault(at.effect, []).append(at.where)
    named = ', then '.join(f'{get_effect(e).title} on {", ".join(w)}' for e, w in places.items())
    rest = ''
    if found.remaining >= explainer.rules.unknown:
        rest = f' {found.remaining:.2f} times the noise floor remains unexplained.'
    # The data held out may show no gap at all; then the figure is of all data.
    share = closed if math.isfinite(closed) else min(max(verdict.closed, 0.0), 1.0)
    return (
        f'{named}: closes {100 * share:.0f} % of a gap of {gap}.{steps or rest}'
    )
