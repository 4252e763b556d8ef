# SPDX-License-Identifier: Apache-2.0
"""The diagnosis, checked blind with cases from MuJoCo: a generator that is not the package's.

Draws machines, motions and effects by seed, simulates them in MuJoCo, seals what is in each case,
lets another process diagnose the bags with `ident diagnose`, and scores the answers. Goes on where
a run was left. MuJoCo has to be importable; `tools/bench.sh mujoco_blind` sees to that.

Example: python benchmarks/mujoco_blind.py --cases 24 --seed 2026 --write docs/blind_mujoco.md
"""

import argparse
from collections import Counter
from collections.abc import Mapping, Sequence
import math
from pathlib import Path
import platform
import sys
import time
from typing import Any

import mujoco
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / 'test'))

from mujoco_cases import draw_case, KINDS, SIZES, write_bags  # noqa: E402

from ros2_ident.checks.blind import seal  # noqa: E402
from ros2_ident.checks.blind.run import ask_all  # noqa: E402
from ros2_ident.checks.blind.score import (  # noqa: E402
    confusable_set,
    detected,
    exact,
    figure,
    named,
    Score,
    score,
    sentences,
    verdict_of,
)
from ros2_ident.checks.blind.store import read_json, Store  # noqa: E402
from ros2_ident.checks.blind.truth import answer_of  # noqa: E402
from ros2_ident.models import load_machine  # noqa: E402
from ros2_ident.threads import processors  # noqa: E402

NULLS, OUTSIDE = 0.2, 0.15
PARTIAL = (
    'The first ones by number were diagnosed; their order is random, so this is a fair sample.'
)
Row = Mapping[str, Any]


def plan(cases: int, seed: int) -> list[tuple[str, float]]:
    """Return kind and size wanted of every case: each kind comes round before one comes twice."""
    rng = np.random.default_rng([seed, 0])
    sorts = {sort: [k for k in KINDS if KINDS[k].sort == sort] for sort in ('single', 'outside')}
    outside, nulls = round(OUTSIDE * cases), round(NULLS * cases)
    names = []
    for sort, count in (('single', cases - outside - nulls), ('outside', outside)):
        rounds = math.ceil(count / len(sorts[sort]))
        names += [str(k) for _ in range(rounds) for k in rng.permutation(sorts[sort])][:count]
    names += ['none'] * nulls
    low, high = SIZES
    even = (rng.permutation(cases) + rng.random(cases)) / cases
    wanted = [(name, float(low * (high / low) ** x)) for name, x in zip(names, even, strict=True)]
    return [wanted[i] for i in rng.permutation(cases)]


def draw(store: Store, seed: int, cases: int) -> None:
    """Draw, simulate and seal the cases that are not there yet."""
    machine = load_machine(store.machine)
    for number, (name, target) in enumerate(plan(cases, seed), 1):
        if store.sealed(number) is not None:
            continue
        begin = time.monotonic()
        rng = np.random.default_rng([seed, number])
        drawn = draw_case(machine, KINDS[name], target, rng)
        write_bags(drawn, store.case(number), rng)
        store.seal(number, seal.close(drawn.label(number), seed))
        print(f'drawn {number} of {cases}, {time.monotonic() - begin:.0f} s', file=sys.stderr)


def diagnose(store: Store, cases: int) -> None:
    """Diagnose the cases that are not diagnosed yet, in a process that is told paths only."""
    orders = {}
    for number in range(1, cases + 1):
        if store.answered(number) is None:
            folder = store.case(number).resolve()
            orders[number] = {
                'fit': str(folder / 'fit'),
                'check': str(folder / 'check'),
                'machine': str(store.machine.resolve()),
                'out': str(folder / 'diagnosis'),
            }
    for done, _ in enumerate(ask_all(store, orders, 1), 1):
        print(f'diagnosed {done} of {len(orders)}', file=sys.stderr)


def row_of(store: Store, number: int, seed: int) -> dict[str, Any]:
    """Open a seal and return the case as a row of the blind check's table."""
    label = seal.unseal(store.sealed(number) or {}, seed)
    effects = []
    if label['sort'] != 'none':
        name = label['effect'] or label['kind']
        effects = [
            {'effect': name, 'where': [label['where']], 'form': 'other', 'rho': label['rho']}
        ]
    row: dict[str, Any] = {
        'case': number,
        'sort': label['sort'],
        'kind': label['kind'],
        'size': label['size'],
        'motions': label['motions'],
        'effects': effects,
        'imperfections': [],
        'rho': label['rho'],
        'rho_small': 0.0,
        'rho_all': label['rho'],
        **(store.answered(number) or {'error': 'no diagnosis'}),
    }
    diagnosis = read_json(store.case(number) / 'diagnosis' / 'diagnosis.json')
    if diagnosis is not None:
        row |= answer_of(diagnosis)
        # Without the effect the model agrees with MuJoCo far below the noise: all can be closed.
        row['share'] |= {'oracle': 1.0, 'actual': None}
    return row


def right(row: Row) -> bool:
    """Whether a case was answered as it should be."""
    if row['sort'] == 'none':
        return not detected(row)
    if row['sort'] == 'outside':
        return verdict_of(row) == 'unknown'
    place = 'verdict' in row and list(row['verdict']['where']) == list(row['effects'][0]['where'])
    return exact(row) and place


def line(row: Row) -> str:
    """Return a case as a line of the page's table."""
    kind = KINDS[row['kind']]
    truth = f'{row["effects"][0]["effect"]} {row["effects"][0]["where"][0]}' if kind.start else ''
    if row['sort'] == 'outside':
        truth = f'outside: {row["kind"]} {row["effects"][0]["where"][0]}'
    if 'verdict' not in row:
        return f'| {row["case"]} | {truth} | | {row["rho"]:.2f} | {row["error"][:60]} | | | | |'
    found = ' '.join((row['verdict']['effect'], *row['verdict']['where']))
    found += ''.join(f', {a["effect"]} {a["where"][0]}' for a in row['also'])
    others = ', '.join(f'{n} {w[0]}' for n, w in confusable_set(row)[1:]) if named(row) else ''
    share = row['share']['predicted']
    closed = f'{100 * share:.0f} %' if share is not None and named(row) else ''
    size = f'{row["size"]:.2g} {kind.unit}'.strip() if kind.start else ''
    mark = 'right' if right(row) else '**wrong**'
    return (
        f'| {row["case"]} | {truth or "none"} | {size} | {row["rho"]:.2f} | {found} | '
        f'{row["verdict"]["probability"]:.2f} | {others} | {closed} | {mark} |'
    )


def page(rows: Sequence[Row], scores: Sequence[Score], about: Row, notes: str) -> str:
    """Return the page."""
    sorts = Counter(str(r['sort']) for r in rows)
    asked = [s for s in scores if s.count]
    table = ['| quantity | figure [95 %] | cases | level | |', '| --- | --- | --- | --- | --- |']
    for s in asked:
        mark = '' if s.reached is None or not s.level else 'reached' if s.reached else '**missed**'
        table.append(f'| {s.name} | {figure(s)} | {s.count} | {s.level} | {mark} |')
    forms = ['| what | in the catalogue | in MuJoCo |', '| --- | --- | --- |']
    forms += [f'| {k.name} | {k.effect or "-"} | {k.form} |' for k in KINDS.values()]
    cases = ['| case | truth | size | rho | verdict | p | set | closed | |', '| --- ' * 9 + '|']
    return '\n'.join(
        [
            '# The diagnosis, checked blind with MuJoCo',
            '',
            '<!-- not run: takes minutes -->',
            '```bash',
            'make bench ARGS=mujoco_blind',
            '```',
            '',
            'The cases of [blind.md](blind.md) come from a simulation of this project. These come '
            'from MuJoCo: another integrator, rods as constraints, and effects in forms of its '
            'own. What both share: the ranges of the parameters, the motions, the noise of a log, '
            'and how the size rho of an effect is measured.',
            '',
            f'{len(rows)} of {about["cases"]} sealed cases, seed {about["seed"]}: '
            f'{sorts["single"]} with one effect, {sorts["none"]} with none, {sorts["outside"]} '
            f'with one outside the catalogue. Hash of the seals: `{about["manifest"]}`. '
            f'MuJoCo {mujoco.__version__}, {platform.machine()}, {processors()} processors.',
            '',
            *([] if len(rows) == about['cases'] else [PARTIAL, '']),
            *table,
            '',
            notes.strip(),
            '',
            '## The cases',
            '',
            *cases,
            *[line(r) for r in rows],
            '',
            '## Effects in MuJoCo',
            '',
            *forms,
            '',
        ]
    )


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--cases', type=int, default=24)
    parser.add_argument('--seed', type=int, default=2026)
    parser.add_argument('--machine', type=Path, default=Path('config/tripod.yaml'))
    parser.add_argument('--out', type=Path, default=Path('build/mujoco_blind'))
    parser.add_argument('--write', type=Path, help='the page; its notes are kept')
    parser.add_argument('--first', type=int, help='diagnose only so many of the cases')
    args = parser.parse_args()
    store = Store(args.out)
    about = {'cases': args.cases, 'seed': args.seed, 'shares': 'mujoco'}
    store.begin(about, args.machine)
    draw(store, args.seed, args.cases)
    sealed = [store.sealed(n) or {} for n in range(1, args.cases + 1)]
    store.note(manifest=seal.manifest(sealed))
    first = min(args.cases, args.first or args.cases)
    diagnose(store, first)
    rows = [row_of(store, n, args.seed) for n in range(1, first + 1)]
    store.write_rows(rows)
    scores = score(rows)
    print(*[line(r) for r in rows], sep='\n')
    print(*[s for s in sentences(scores) if 'of 0' not in s], sep='\n')
    if args.write:
        args.write.write_text(page(rows, scores, store.about(), kept_notes(args.write)))
    return 0


def kept_notes(path: Path) -> str:
    """Return what a person wrote between the table and the cases, or nothing."""
    text = path.read_text() if path.exists() else ''
    begin, end = text.find('## What'), text.find('## The cases')
    return text[begin:end] if 0 <= begin < end else ''


if __name__ == '__main__':
    sys.exit(main())
