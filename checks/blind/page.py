# SPDX-License-Identifier: Apache-2.0
"""The page on one run: its cases, what was reached, what was not."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from checks.blind import figures
from checks.blind.score import (
    confusable_set,
    CRASH,
    detected,
    exact,
    fault_named,
    figure,
    hits_of_pair,
    named,
    Row,
    Score,
    SEEN,
    verdict_of,
)
from checks.blind.sorts import SHARES
from checks.share import table
from ros2_ident.files import write_text
from ros2_ident.gap.verdict import UNKNOWN


def write_page(
    path: str | Path, rows: Sequence[Row], scores: Sequence[Score], about: Mapping[str, Any]
) -> Path:
    """Write the page and its pictures.

    Args:
        path: The page; its pictures go to a folder of its name beside it.
        about: From the run's directory: command, seed, manifest.
    """
    page = Path(path)
    folder = page.parent / page.stem
    folder.mkdir(parents=True, exist_ok=True)
    pictures = {
        'Detection by size': figures.detection(rows, folder / 'detection.png'),
        'Reliability of the stated probabilities': figures.reliability(
            rows, folder / 'reliability.png'
        ),
        'Truth and verdict, cases with at most one effect': figures.confusion(
            rows, folder / 'confusion.png'
        ),
    }
    text = ['# A run of the blind check', '', '```bash', str(about.get('command', '')), '```', '']
    head = 'quantity', 'figure [95 %]', 'cases', 'level', ''
    text += [*_of_what(rows, about), '', table(head, map(_line, scores)).rstrip()]
    missed = [s for s in scores if s.reached is False and s.level]
    text += ['', '## Not reached', '']
    text += [f'- {s.name}: {figure(s)} of {s.count}, level {s.level}.' for s in missed] or [
        'Every level that this run can judge is reached.'
    ]
    unjudged = [s.name for s in scores if s.reached is None]
    if unjudged:
        text += ['', 'No case of this run asks for: ' + '; '.join(unjudged) + '.']
    for title, picture in pictures.items():
        text += ['', f'## {title}', '', f'![{title}]({folder.name}/{picture.name})']
    text += ['', *_wrong(rows)]
    return write_text(page, '\n'.join(text) + '\n', replace=True)


def _of_what(rows: Sequence[Row], about: Mapping[str, Any]) -> list[str]:
    """Return which cases the page is of, and by which program they were drawn and diagnosed."""
    counts = Counter(str(r['sort']) for r in rows)
    sorts = ', '.join(f'{n} {SHARES[sort][1]}' for sort, n in counts.most_common())
    drawn, diagnosed = about.get('drawn', {}), about.get('diagnosed', [])
    programs = ', then '.join(f'{d["commit"]} (sources `{d["sources"]}`)' for d in diagnosed)
    out = [
        f'{len(rows)} of {about["cases"]} sealed cases, seed {about["seed"]}: {sorts}. '
        f'SHA-256 over the seals: `{about.get("manifest", "")}`.',
        f'Drawn at commit {drawn.get("commit", "?")}; diagnosed at {programs or "?"}.',
    ]
    if len(rows) < int(about['cases']):
        out.append('The order of the cases tells nothing, so those diagnosed are a fair sample.')
    if len(diagnosed) > 1:
        out.append('**Of more than one program:** the figures are of no single commit.')
    return out


def _line(s: Score) -> tuple[object, ...]:
    mark = '' if s.reached is None or not s.level else ('reached' if s.reached else '**missed**')
    return s.name, figure(s), s.count, s.level, mark


def _wrong(rows: Sequence[Row]) -> list[str]:
    """Return the cases that went wrong though their effects could be seen."""
    head = 'case', 'truth (rho)', 'imperfections', 'verdict', 'probability', 'set'
    out = []
    for r in rows:
        if not went_wrong(r):
            continue
        truth = ', '.join(
            f'{e["effect"]} {" ".join(e["where"])} ({e["rho"]:.2f}, {e["form"]})'
            for e in r['effects']
        )
        if r.get('fault'):
            truth = 'fault: {kind}, {name}'.format(**r['fault'])
        small = ', '.join(e[0] for e in r['imperfections'])
        verdict, p, others = verdict_of(r), '', ''
        if verdict == CRASH:
            others = str(r['error'])[:120]
        else:
            p = f'{r["verdict"]["probability"]:.2f}'
            verdict += ' ' + ' '.join(r['verdict']['where'])
            verdict += ''.join(f', {a["effect"]} {a["where"][0]}' for a in r['also'])
            others = ', '.join(f'{n} {w[0]}' for n, w in confusable_set(r)[1:] if named(r))
        out.append((r['case'], truth or 'none', small, verdict, p, others))
    which = f'With an effect of rho {SEEN:g} or more, or a false alarm.'
    return ['## Cases that went wrong', '', which, '', table(head, out).rstrip()]


def went_wrong(row: Row) -> bool:
    """Whether a case that can be judged was judged wrongly."""
    sort = row['sort']
    if sort == 'fault':
        return not fault_named(row)
    if verdict_of(row) == CRASH:
        return True
    if sort in ('none', 'ideal', 'hidden'):
        return detected(row)
    if sort == 'outside':
        return bool(row['rho'] >= SEEN) and verdict_of(row) != UNKNOWN
    if sort in ('pair', 'triple'):
        return hits_of_pair(row, len(row['effects'])) < len(row['effects'])
    return bool(row['rho'] >= SEEN) and not exact(row)
