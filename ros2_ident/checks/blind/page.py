# SPDX-License-Identifier: Apache-2.0
"""The page on a run: how it was made, what was reached, what was not."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ros2_ident.checks.blind import figures
from ros2_ident.checks.blind.score import (
    confusable_set,
    CRASH,
    detected,
    exact,
    figure,
    hits_of_pair,
    named,
    Row,
    Score,
    SEEN,
    verdict_of,
)
from ros2_ident.files import write_text
from ros2_ident.gap.verdict import UNKNOWN

METHOD = """
## How it is done

Every case is one machine with its own parameters and two motions of different kinds, 8 s to fit
on and 6 s held out. The slow reference simulates it: redundant coordinates, adaptive integration,
and for three quarters of the effects another functional form than the catalogue's. Every log has
noise, quantisation, jitter and lost samples. Half of the cases, those without an effect included,
have one or two small imperfections from the catalogue as well, 0.1 to 0.4 times the noise in total
after the nominal fit, and where it stays within that another sign of friction.

The size of an effect is rho: what the nominal parameters cannot imitate on the noise-free log, RMS
of the worst drive over both recordings, over the noise. Cases are drawn with sizes spread evenly
in its logarithm, by a linearised fit; the figures above use rho from a full fit without noise,
made after the diagnosis. An effect that stays far below its size within its range on the motion
drawn gives way to another one. "Not testable" are effects that an ordinary motion shows (rho at
least 1) and the one recorded does not.

All cases are drawn and sealed before the first diagnosis: SHA-256 over a nonce and the label of
each, and one hash over these. The diagnosis runs as `ident diagnose` in another process, which is
told the paths of the two bags and of the machine file, and in which a hook refuses every other
file of the run. Then the seals are opened.
"""  # noqa: Q001 - the formatter wants these quotes


def write_page(
    path: str | Path,
    rows: Sequence[Row],
    scores: Sequence[Score],
    about: Mapping[str, Any],
    notes: str = '',
) -> Path:
    """Write the page and its pictures.

    Args:
        path: The page; its pictures go to a folder of its name beside it.
        rows: The table.
        scores: From `score.score`.
        about: From the run's directory: command, seed, manifest.
        notes: What a person has found out about the levels that are not reached.

    Returns:
        The page.
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
    counts = Counter(str(r['sort']) for r in rows)
    text = ['# The diagnosis, checked blind', '', '<!-- not run: takes minutes -->', '```bash']
    text += [str(about.get('command', '')), '```', '']
    text += [
        f'{len(rows)} cases, seed {about["seed"]}: '
        + ', '.join(f'{n} {_sort(sort)}' for sort, n in counts.most_common())
        + f'. Hash of the seals: `{about.get("manifest", "")}`.',
        '',
        '| quantity | figure [95 %] | cases | level | |',
        '| --- | --- | --- | --- | --- |',
    ]
    text += [_line(s) for s in scores]
    missed = [s for s in scores if s.reached is False and s.level]
    text += ['', '## Not reached', '']
    text += [f'- {s.name}: {figure(s)} of {s.count}, level {s.level}.' for s in missed] or [
        'Every level that this run can judge is reached.'
    ]
    if notes:
        text += ['', notes.strip()]
    unjudged = [s.name for s in scores if s.reached is None]
    if unjudged:
        text += ['', 'No case of this run asks for: ' + '; '.join(unjudged) + '.']
    for title, picture in pictures.items():
        text += ['', f'## {title}', '', f'![{title}]({folder.name}/{picture.name})']
    text += ['', *_wrong(rows), METHOD]
    return write_text(page, '\n'.join(text))


def _sort(sort: str) -> str:
    return {
        'single': 'with one effect',
        'pair': 'with two',
        'none': 'with none',
        'outside': 'with one outside the catalogue',
        'hidden': 'with one the motion does not show',
    }[sort]


def _line(s: Score) -> str:
    mark = '' if s.reached is None or not s.level else ('reached' if s.reached else '**missed**')
    return f'| {s.name} | {figure(s)} | {s.count} | {s.level} | {mark} |'


def _wrong(rows: Sequence[Row]) -> list[str]:
    """Return the cases that went wrong though their effects could be seen."""
    out = [
        '## Cases that went wrong',
        '',
        f'With an effect of rho {SEEN:g} or more, or a false alarm.',
        '',
        '| case | truth (rho) | imperfections | verdict | probability | set |',
        '| --- | --- | --- | --- | --- | --- |',
    ]
    for r in rows:
        if not went_wrong(r):
            continue
        truth = ', '.join(
            f'{e["effect"]} {" ".join(e["where"])} ({e["rho"]:.2f}, {e["form"]} form)'
            for e in r['effects']
        )
        small = ', '.join(e[0] for e in r['imperfections'])
        verdict, p, others = verdict_of(r), '', ''
        if verdict == CRASH:
            others = str(r['error'])[:120]
        else:
            p = f'{r["verdict"]["probability"]:.2f}'
            verdict += ' ' + ' '.join(r['verdict']['where'])
            verdict += ''.join(f', {a["effect"]} {a["where"][0]}' for a in r['also'])
            others = ', '.join(f'{n} {w[0]}' for n, w in confusable_set(r)[1:] if named(r))
        out.append(f'| {r["case"]} | {truth or "none"} | {small} | {verdict} | {p} | {others} |')
    return out


def went_wrong(row: Row) -> bool:
    """Whether a case that can be judged was judged wrongly."""
    sort = row['sort']
    if verdict_of(row) == CRASH:
        return True
    if sort in ('none', 'hidden'):
        return detected(row)
    if sort == 'outside':
        return bool(row['rho'] >= SEEN) and verdict_of(row) != UNKNOWN
    if sort == 'pair':
        return hits_of_pair(row, 2) < 2
    return bool(row['rho'] >= SEEN) and not exact(row)
