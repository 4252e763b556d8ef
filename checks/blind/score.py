# SPDX-License-Identifier: Apache-2.0
"""Scores of a table: what is counted, out of how many, with its interval and its level."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
import math
import re
from typing import Any

import numpy as np
import numpy.typing as npt

from checks.blind.forms.form import twins
from checks.share import share_interval
from ros2_ident.effects import CATALOGUE
from ros2_ident.gap.rules import Rules
from ros2_ident.gap.verdict import NAMELESS, NONE, UNKNOWN

Array = npt.NDArray[np.float64]
Row = Mapping[str, Any]

# Windows of true size in which the detection curve's levels are read.
WINDOWS = ((0.7, 0.55, 0.9), (1.5, 1.2, 1.9), (3.0, 2.4, math.inf))
SEEN = 1.5  # true size from which a name is asked for
SHARE_NEAR = 0.05
BINS = 10
CRASH = 'error'


@dataclass(frozen=True)
class Score:
    """One quantity.

    Attributes:
        value: The figure; NaN where no case asks for it.
        low: Lower end of the 95 % interval, NaN where it has none.
        level: What is to be reached, as text.
        reached: Whether it is; None where no case asks for it.
        share: Whether the figure is a share of the cases.
    """

    name: str
    value: float
    low: float
    high: float
    count: int
    level: str
    reached: bool | None
    share: bool = True


def same(name: str, where: Sequence[str], truth: Mapping[str, Any]) -> bool:
    """Whether an effect and its place are the true ones; twins are one effect under two names."""
    return alike(name, truth['effect']) and list(where) == list(truth['where'])


def alike(name: str, other: str) -> bool:
    """Whether two ids name the same effect: one of its twins or variants will do."""
    variants = {CATALOGUE[twin].variant_of for twin in twins(name) & CATALOGUE.keys()}
    return other in twins(name) | variants


def family(name: str) -> str:
    """Return an effect's structural class."""
    return CATALOGUE[name].family if name in CATALOGUE else name


def verdict_of(row: Row) -> str:
    """Return the verdict's effect, or `CRASH`."""
    return str(row['verdict']['effect']) if 'verdict' in row else CRASH


def named(row: Row) -> bool:
    """Whether a catalogued effect was named."""
    return verdict_of(row) not in {*NAMELESS, CRASH}


def detected(row: Row) -> bool:
    """Whether anything was said to be missing."""
    return verdict_of(row) not in (NONE, CRASH)


def exact(row: Row) -> bool:
    """Whether the first effect named is one that is there, whatever its place."""
    return any(alike(verdict_of(row), e['effect']) for e in row['effects'])


def right(row: Row) -> bool:
    """Whether the verdict is right: its effect and place, or `unknown`, or rightly `none`.

    `none` is right where all that is in the case leaves less than what counts as missing; of a
    bookkeeping fault, see `fault_named`.
    """
    verdict = verdict_of(row)
    if row.get('fault'):
        return fault_named(row)
    if verdict == NONE:
        return bool(row['rho_all'] < Rules().material)
    if verdict == UNKNOWN:
        return str(row['sort']) == 'outside'
    return named(row) and any(same(verdict, row['verdict']['where'], e) for e in row['effects'])


def confusable_set(row: Row) -> list[tuple[str, tuple[str, ...]]]:
    """Return the verdict's effect and what it may be confused with."""
    first = (row['verdict']['effect'], tuple(row['verdict']['where']))
    rest = [(c['effect'], tuple(c['where'])) for c in row['confusable']]
    return list(dict.fromkeys([first, *rest]))


def covered(row: Row) -> bool:
    """Whether the set holds the true effect at its place."""
    (truth,) = row['effects']
    return any(same(name, where, truth) for name, where in confusable_set(row))


def found_names(row: Row) -> list[tuple[str, list[str]]]:
    """Return the effects found, in order, with their places."""
    if not named(row):
        return []
    first = [(row['verdict']['effect'], row['verdict']['where'])]
    return first + [(a['effect'], a['where']) for a in row['also']]


def hits_of_pair(row: Row, most: int) -> int:
    """Return how many of a pair's effects are among the first found."""
    found = found_names(row)[:most]
    return sum(any(same(name, where, e) for name, where in found) for e in row['effects'])


def recognised(row: Row) -> bool:
    """Whether an effect the motion does not show is said not to be testable, and none is named."""
    (truth,) = row['effects']
    listed = any(same(name, (where,), truth) for name, where in row.get('not_testable', []))
    return listed and not named(row)


def blames_physics(row: Row) -> bool:
    """Whether an effect of drive or structure is named, first or further on."""
    named_ones = [name for name, _ in found_names(row)]
    known = [CATALOGUE[name].group for name in named_ones if name in CATALOGUE]
    return any(group in ('drive', 'structure') for group in known)


def fault_named(row: Row) -> bool:
    """Whether a fault is named, by a gate or by refusing the log, before any physics."""
    words = [str(word).lower() for word in row['fault']['named_by']]
    said = [str(row.get('error', '')), str(row.get('verdict', {}).get('sentence', ''))]
    for gate in row.get('gates', []):
        said.append(f'{gate["gate"]} {gate["sentence"]}')
    # Whole words and their endings: `late` is in `lately`, not in `plate`.
    hit = any(re.search(rf'\b{re.escape(w)}', text.lower()) for text in said for w in words)
    return hit and not blames_physics(row)


def calibration(rows: Sequence[Row], bins: int = BINS) -> tuple[float, float, list[Any]]:
    """Return Brier score, expected calibration error, and (probability, share right, count) a bin.

    The bins hold equally many cases.
    """
    answered = [r for r in rows if 'verdict' in r]
    if not answered:
        return math.nan, math.nan, []
    p = np.array([r['verdict']['probability'] for r in answered], dtype=float)
    good = np.array([right(r) for r in answered], dtype=float)
    brier = float(np.mean((p - good) ** 2))
    parts = np.array_split(np.argsort(p), min(bins, len(p)))
    table = [(float(p[i].mean()), float(good[i].mean()), len(i)) for i in parts]
    error = sum(n * abs(a - b) for a, b, n in table) / len(p)
    return brier, float(error), table


def _share(
    name: str,
    rows: Sequence[Row],
    test: Callable[[Row], bool],
    level: str = '',
    good: Callable[[float], bool] = lambda value: True,
) -> Score:
    hits = sum(test(r) for r in rows)
    low, high = share_interval(hits, len(rows))
    value = hits / len(rows) if rows else math.nan
    return Score(name, value, low, high, len(rows), level, good(value) if rows else None)


def _least(percent: int) -> tuple[str, Callable[[float], bool]]:
    return f'{percent} %', lambda value: value >= percent / 100


def _most(share: float, level: str = '') -> tuple[str, Callable[[float], bool]]:
    return level or f'at most {100 * share:g} %', lambda value: value <= share


def _number(
    name: str, values: Sequence[float], of: Callable[[Sequence[float]], float], most: float
) -> Score:
    value = float(of(values)) if values else math.nan
    level = f'at most {most:g}' if math.isfinite(most) else ''
    good = value <= most if values else None
    return Score(name, value, math.nan, math.nan, len(values), level, good, share=False)


def off(row: Row, truth: str = 'true') -> float:
    """Return how far the predicted share closed is from the truth, NaN where that is not known.

    Args:
        truth: `true`, what the diagnosed model closes of the gap without noise; `oracle`, what the
            generator's own model with the true effect closes, imperfections left.
    """
    share = row.get('share', {})
    if share.get('predicted') is None or share.get(truth) is None:
        return math.nan
    return abs(float(share['predicted']) - float(share[truth]))


def _inside(row: Row) -> bool:
    share = row['share']
    return bool(share['low'] <= share['true'] <= share['high'])


def score(rows: Sequence[Row]) -> list[Score]:
    """Return every quantity of a table."""
    by = {sort: [r for r in rows if r['sort'] == sort] for sort in {r['sort'] for r in rows}}
    nulls = [*by.get('none', []), *by.get('ideal', [])]
    singles = [r for r in by.get('single', []) if r['effects']]
    mujoco = any(r.get('generator') == 'mujoco' for r in rows)
    level = _least(88 if mujoco else 90)
    pairs = [r for r in by.get('pair', []) if min(e['rho'] for e in r['effects']) >= 1.0]
    triples = [r for r in by.get('triple', []) if min(e['rho'] for e in r['effects']) >= 1.0]
    faulty = by.get('fault', [])
    outside = [r for r in by.get('outside', []) if r['rho'] >= SEEN]
    hidden = [r for r in by.get('hidden', []) if r['effects'] and r['rho'] < Rules().material]
    strong = [r for r in singles if r['rho'] >= SEEN]
    out = [_share('false alarms, no effect', nulls, detected, *_most(0.025))]
    for (centre, low, high), least in zip(WINDOWS, (50, 90, 98), strict=True):
        window = [r for r in singles if low <= r['rho'] < high]
        text = f'rho {low:g} to {high:g}' if math.isfinite(high) else f'rho from {low:g}'
        name = f'detected at rho {centre:g} ({text})'
        out.append(_share(name, window, detected, *_least(least)))
    placed = [r for r in strong if named(r) and r['effects'][0]['where'] != ['all']]
    sets = [r for r in strong if named(r)]
    sizes = [float(len(confusable_set(r))) for r in sets]
    out += [
        _share(f'exact effect first, rho from {SEEN:g}', strong, exact, *level),
        _share('effect or its class', strong, _class, *_least(97)),
        _share('confusable set holds the effect', sets, covered, *_least(97)),
        _number('mean size of the set', sizes, np.mean, 3.0),
        _share('drive right', placed, _drive, *_least(98)),
        _share('singles: no further effect named', sets, lambda r: not r['also']),
        _share('pairs: one of them first', pairs, lambda r: hits_of_pair(r, 1) == 1, *_least(95)),
        _share('pairs: both in the first two', pairs, _both, *_least(80)),
        _share('pairs: exactly the two', pairs, _exactly, *_least(72)),
        _share('triples: one of them first', triples, lambda r: hits_of_pair(r, 1) == 1),
        _share('triples: all in the first three', triples, lambda r: hits_of_pair(r, 3) == 3),
        _share('outside the catalogue, flagged', outside, _unknown, *_least(90)),
        _share('known effects flagged as unknown', strong, _unknown, *_most(0.04)),
        _share('bookkeeping faults, named before physics', faulty, fault_named, *_least(95)),
        _share('not testable, recognised', hidden, recognised, *_least(90)),
        _share('not testable, nothing named', hidden, lambda r: not named(r)),
    ]
    return out + _intervals(rows) + _shares_closed(singles) + _rest(rows)


def _class(row: Row) -> bool:
    return exact(row) or any(
        family(verdict_of(row)) == family(e['effect']) for e in row['effects']
    )


def _drive(row: Row) -> bool:
    return any(list(row['verdict']['where']) == list(e['where']) for e in row['effects'])


def _both(row: Row) -> bool:
    return hits_of_pair(row, 2) == 2


def _exactly(row: Row) -> bool:
    return len(found_names(row)) == 2 and _both(row)


def _unknown(row: Row) -> bool:
    return verdict_of(row) == UNKNOWN


def answered_well(row: Row) -> bool:
    """Whether the model that a diagnosis delivers holds what is in the machine, and nothing else.

    Only then do its parameters mean those of the machine.
    """
    if row['sort'] in ('none', 'ideal'):
        return verdict_of(row) == NONE
    found = found_names(row)
    known = row['sort'] in ('single', 'pair', 'triple')
    return known and len(found) == len(row['effects']) == hits_of_pair(row, len(found))


def holds(interval: Mapping[str, Any]) -> bool:
    """Whether a 95 % interval holds the truth; one that does not exist holds nothing."""
    low, high = interval['low'], interval['high']
    return low is not None and high is not None and bool(low <= interval['true'] <= high)


def _intervals(rows: Sequence[Row]) -> list[Score]:
    """Return how often intervals hold the truth; those of one machine are not independent."""
    well = [r for r in rows if answered_well(r)]
    what = (
        ('machines imperfect', [r for r in well if r['imperfections']]),
        ('noise AR 0.9 or 0.99, stated off by 2.5', [r for r in well if _hard(r)]),
        ('machines ideal', [r for r in well if not r['imperfections']]),
    )
    out = []
    for text, some in what:
        each = [p for r in some for p in r.get('parameters', [])]
        out.append(_within(_share(f'95 % intervals hold the truth, {text}', each, holds)))
    return out


def _hard(row: Row) -> bool:
    return bool(row.get('noise', {}).get('hard', False))


def _shares_closed(singles: Sequence[Row]) -> list[Score]:
    def near(truth: str) -> Callable[[Row], bool]:
        return lambda row: off(row, truth) <= SHARE_NEAR

    known = [r for r in singles if named(r) and math.isfinite(off(r))]
    bounded = [r for r in known if None not in (r['share']['low'], r['share']['high'])]
    alike = [r for r in singles if named(r) and math.isfinite(off(r, 'oracle'))]
    return [
        _share('share closed, within 0.05 of the truth', known, near('true'), *_least(90)),
        _within(_share('its interval covers the truth', bounded, _inside)),
        _share('within 0.05 of what the true effect alone closes', alike, near('oracle')),
    ]


def _within(s: Score) -> Score:
    """Return a share that shall be 90 to 98 %; more than 98 % has to be significant."""
    good = bool(s.value >= 0.9 and s.low <= 0.98) if s.count else None
    return replace(s, level='90 to 98 %', reached=good)


def _rest(rows: Sequence[Row]) -> list[Score]:
    brier, ece, _ = calibration(rows)
    answered = [float(r['verdict']['probability']) for r in rows if 'verdict' in r]
    seconds = [float(r['seconds']) for r in rows if r.get('seconds')]
    # A log with a fault may be refused.
    whole = [r for r in rows if r['sort'] != 'fault']
    cpu = [float(r['cpu_seconds']) for r in rows if r.get('cpu_seconds')]
    return [
        _number('Brier score of the verdict', answered, lambda _: brier, math.inf),
        _number('calibration error (ECE)', answered, lambda _: ece, 0.04),
        _number('seconds a case, 95th percentile', seconds, lambda s: np.quantile(s, 0.95), 60.0),
        _number('processor seconds a case, median', cpu, np.median, math.inf),
        _share('diagnoses that failed', whole, lambda r: 'verdict' not in r, *_most(0, 'none')),
    ]


def figure(s: Score) -> str:
    """Return a score's figure as text."""
    if not math.isfinite(s.value):
        return 'no case'
    if not s.share:
        return f'{s.value:.3g}'
    text = f'{100 * s.value:.0f} %'
    if math.isfinite(s.low):
        text += f' [{100 * s.low:.0f}, {100 * s.high:.0f}]'
    return text


def sentences(scores: Sequence[Score]) -> list[str]:
    """Return one line a score."""
    out = []
    for s in scores:
        mark = (
            '' if s.reached is None or not s.level else ('  reached' if s.reached else '  missed')
        )
        level = f'  level {s.level}' if s.level else ''
        out.append(f'{s.name:66s} {figure(s):>18s} of {s.count}{level}{mark}')
    return out
