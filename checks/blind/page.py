# SPDX-License-Identifier: Apache-2.0
"""The page on a run: how it was made, what was reached, what was not."""

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
from ros2_ident.files import write_text
from ros2_ident.gap.verdict import UNKNOWN

METHOD = """
## How it is done

Every case is a machine of its own: geometry, masses, gear, controller, gains and cycle are
drawn, and two motions of different kinds, 8 s to fit on and 6 s held out. {generator} In every
drive two things are a little off, and often one in the machine as a whole: together 0.05 to 0.4
times the noise after the nominal fit. "Ideal" are machines without even these. The log's noise
is an autoregression of order 0, 1 or 2 with a first-order correlation up to 0.99, of a size
drawn for each case; the logger takes a mean, rounds, is resampled by a clock of its own, comes
at 250, 500 or 1000 Hz (or next to it), and messages are lost one by one or in bursts. What the
machine file says of the noise is off by up to 2.5 times, or missing. In a fifth of the cases it
is off by 2.5, with a correlation of 0.9 or 0.99.

The effects' equations come from the literature and are in no case those of the catalogue; no
number is drawn within 4 % of a value from which the search starts.
`checks/blind/forms/` holds them; who changes the catalogue does not read it.

The size of an effect is rho: what the nominal parameters cannot imitate on the noise-free log,
RMS of the worst drive over both recordings, over the true noise. Cases are drawn with sizes
spread evenly in its logarithm, by a linearised fit; the figures use rho from a full fit without
noise, which is sealed with the rest. An effect that stays far below its size within its range on
the motion drawn gives way to another one. "Not testable" are effects that an ordinary motion
shows (rho at least 1) and the one recorded does not. The share that the true model closes is one
minus what the imperfections alone leave, over what everything leaves, squares on the recording
held out.

Bookkeeping faults are wrong signs, units, orders of joints, clocks and constants. They count as
named where a gate, the verdict's sentence or the refusal says which, and no effect of drive or
structure is named. Intervals count where the verdict is right and complete, as only then its
parameters mean the machine's; those of one machine are not independent, so the intervals of
these shares are too narrow.

All cases are drawn and sealed before the first diagnosis: SHA-256 over a nonce and the label of
each, and one hash over these. The diagnosis runs as `ident diagnose` in another process, which
is told the paths of the two bags and of the machine file, and in which a hook refuses every
other file of the run. Then the seals are opened. `python -m checks.blind --verify` checks the
files that are kept of a run.
"""  # noqa: Q001 - the formatter wants these quotes
GENERATORS = {
    'reference': 'The slow reference simulates it: redundant coordinates, adaptive integration.',
    'mujoco': 'MuJoCo simulates it: its own integrator, rods as constraints, its own effects.',
}
SORTS = {
    'single': 'with one effect',
    'pair': 'with two',
    'triple': 'with three',
    'none': 'with imperfections only',
    'ideal': 'with nothing',
    'outside': 'with one outside the catalogue',
    'hidden': 'with one the motion does not show',
    'fault': 'with a bookkeeping fault',
}


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
    generator = str(rows[0].get('generator', 'reference')) if rows else 'reference'
    with_mujoco = ' with MuJoCo' if generator == 'mujoco' else ''
    text = [f'# The diagnosis, checked blind{with_mujoco}', '', '<!-- not run: takes minutes -->']
    text += ['```bash', str(about.get('command', '')), '```', '']
    text += [
        *_of_what(rows, about),
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
    text += ['', *_wrong(rows), METHOD.format(generator=GENERATORS[generator])]
    return write_text(page, '\n'.join(text), replace=True)


def _of_what(rows: Sequence[Row], about: Mapping[str, Any]) -> list[str]:
    """Return which cases the page is of, and by which program they were drawn and diagnosed."""
    counts = Counter(str(r['sort']) for r in rows)
    sorts = ', '.join(f'{n} {SORTS[sort]}' for sort, n in counts.most_common())
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
        out.append(f'| {r["case"]} | {truth or "none"} | {small} | {verdict} | {p} | {others} |')
    return out


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
