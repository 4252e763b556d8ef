# SPDX-License-Identifier: Apache-2.0
"""What is judged of the cases of MJCFs, which `generators.mjcf_cases` draws."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from checks.blind.score import covered, exact, family, holds, named, Row, same, verdict_of
from checks.blind.store import read_json, Store
from checks.blind.truth import answer_of
from checks.share import told_share

# Numbers of the cases that the package's own tripod is asked about, beyond the case's.
TWIN = 1000
RANKED = 5


def row(store: Store, number: int, label: Mapping[str, Any]) -> dict[str, Any]:
    """Return what was in a case and what was answered, by the package's own tripod as well."""
    change = label['change']
    where = [] if change is None else [{'effect': change[0], 'where': [change[1]]}]
    found = read_json(store.case(number) / 'diagnosis' / 'diagnosis.json')
    out = {**label, 'effects': where, **_answered(store, number)}
    if found is not None:
        out['intervals'] = [
            {'name': name, 'true': true, **{k: at.get(k) for k in ('value', 'low', 'high')}}
            for name, true in label['inertia'].items()
            for at in [found['parameters'][name]]
        ]
    asked = store.answered(number + TWIN) is not None
    return out | {'twin': _answered(store, number + TWIN) if asked else None}


def _answered(store: Store, number: int) -> dict[str, Any]:
    went = store.answered(number) or {'error': 'no diagnosis'}
    found = read_json(store.case(number) / 'diagnosis' / 'diagnosis.json')
    answer = {} if found is None else answer_of(found)
    return went | answer | ({'ranking': answer['ranking'][:RANKED]} if answer else {})


def asked(label: Mapping[str, Any], row: Row) -> dict[str, Any]:
    """Return what a row says of its label."""
    return dict(label)


def placed(row: Row) -> bool:
    """Whether effect and joint are the true ones; without a change, whether none is named."""
    if not row['effects']:
        return verdict_of(row) == 'none'
    verdict = row.get('verdict', {})
    return named(row) and same(verdict['effect'], verdict['where'], row['effects'][0])


def of_class(row: Row) -> bool:
    """Whether the effect named is the true one or of its class."""
    return exact(row) or family(verdict_of(row)) == family(row['effects'][0]['effect'])


def joint_right(row: Row) -> bool:
    """Whether the joint is the true one."""
    return bool(list(row['verdict']['where']) == row['effects'][0]['where'])


def alike(row: Row, twin: Row) -> bool:
    """Whether the package's own tripod says the same of a case."""
    one, other = row['verdict'], twin['verdict']
    return one['effect'] == other['effect'] or same(one['effect'], one['where'], other)


def compatible(row: Row, twin: Row) -> bool:
    """Whether either names what the other calls not to be told from its own."""

    def among(verdict: Row, said: Row) -> bool:
        return any(same(at['effect'], at['where'], verdict) for at in said['confusable'])

    return alike(row, twin) or among(row['verdict'], twin) or among(twin['verdict'], row)


def figures(rows: Sequence[Row]) -> dict[str, str]:
    """Return what came of the cases, by name, of all and by machine."""
    with_one = [row for row in rows if row['effects']]
    both = [(r, r['twin']) for r in rows if 'verdict' in r and 'verdict' in (r['twin'] or {})]
    well = [at for row in rows if placed(row) for at in row.get('intervals', [])]
    out = {'no effect: nothing named': _counted([r for r in rows if not r['effects']], placed)}
    for kind in ('', 'tripod', 'arm'):
        some = [row for row in with_one if kind in ('', row['machine'])]
        said = [row for row in some if named(row)]
        out |= {
            name + (f', {kind}s' if kind else ''): figure
            for name, figure in {
                'effect and joint right': _counted(some, placed),
                'effect right': _counted(some, exact),
                'effect or its class': _counted(some, of_class),
                'joint right, where one is named': _counted(said, joint_right),
                'confusable set holds the effect': _counted(said, covered),
                'no further effect named': _counted(said, lambda row: not row['also']),
            }.items()
        }
    return out | {
        '95 % intervals hold the inertias, answer right': _counted(well, holds),
        'diagnoses that ended': _counted(rows, lambda row: 'verdict' in row),
        "the package's own tripod says the same": told_share([alike(*x) for x in both]),
        'or what either cannot tell from its own': told_share([compatible(*x) for x in both]),
    }


def _counted(rows: Sequence[Row], test: Callable[[Row], bool]) -> str:
    return told_share([test(row) for row in rows])


def _said(row: Row) -> str:
    if 'verdict' not in row:
        return f'failed: {row["error"][:60]}'
    also = ''.join(f', {a["effect"]} {" ".join(a["where"])}' for a in row['also'])
    verdict = row['verdict']
    return f'{verdict["effect"]} {" ".join(verdict["where"])}{also} {verdict["probability"]:.2f}'


def told(store: Store, rows: Sequence[Row]) -> list[str]:
    """Return the cases and what came of them, as lines."""
    out = []
    for row in rows:
        effect, joint, size = row['change'] or ('none', '', 0.0)
        truth = f'{effect} {joint}, {size:g} ({row["rho"]:.1f})'
        mark = '' if placed(row) else ' WRONG'
        twin = f'; its twin: {_said(row["twin"])}' if row['twin'] else ''
        out.append(f'{row["case"]} {row["machine"]} {truth}: {_said(row)}{mark}{twin}')
    return [*out, *(f'{name}: {figure}' for name, figure in figures(rows).items())]
