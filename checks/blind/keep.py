# SPDX-License-Identifier: Apache-2.0
"""What of a run is kept for everybody, and the check that it is what was sealed.

Before the first diagnosis: `seals.json`. Afterwards beside it: `labels.jsonl.gz` with every opened
label and its nonce, `table.jsonl` with every row, `run.json` with command, seed and commits.
"""

from collections.abc import Callable, Mapping, Sequence
import gzip
import json
from pathlib import Path
from typing import Any

from checks.blind import arms, mjcf, seal
from checks.blind.score import figure, score
from checks.blind.store import read_json, SEALS, Store, TABLE, write_json
from checks.blind.truth import make_row
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import make_directory, replacing, write_text

LABELS, FIGURES = 'labels.jsonl.gz', 'figures.json'
# Of each row so many ranked candidates are kept.
RANKED = 5
Labels = dict[int, dict[str, Any]]
Judge = tuple[
    Callable[[Mapping[str, Any], Mapping[str, Any]], Mapping[str, Any]],
    Callable[[Sequence[Mapping[str, Any]]], dict[str, str]],
]
# What a row says of the label, as against what was answered.
OF_LABEL = ('case', 'sort', 'generator', 'motions', 'effects', 'imperfections', 'rho', 'rho_small',
            'rho_all', 'noise', 'fault')  # fmt: skip


def keep_seals(store: Store, folder: str | Path) -> Path:
    """Copy the seals, to be committed before the first diagnosis."""
    path = make_directory(folder) / SEALS
    write_json(path, read_json(store.root / SEALS))
    return path


def keep_all(store: Store, folder: str | Path, rows: Sequence[Mapping[str, Any]]) -> Path:
    """Write labels, table and figures of a scored run beside its seals.

    Raises:
        IdentError: INVALID_GOAL where the folder holds the seals of another run.
    """
    to, about = Path(folder), store.about()
    there = read_json(to / SEALS)
    if there is not None and there['manifest'] != about['manifest']:
        raise IdentError(
            ErrorCode.INVALID_GOAL, f'{to} holds the seals of another run; give another directory'
        )
    keep_seals(store, to)
    labels = keep_labels(store, to)
    short = [{**row, 'ranking': row.get('ranking', [])[:RANKED]} for row in rows]
    table = ''.join(json.dumps(row) + '\n' for row in short)
    # What a command said names folders of the machine that ran it.
    write_text(to / TABLE, table.replace(f'{store.root.resolve()}/', ''), replace=True)
    write_json(to / 'run.json', about)
    write_json(to / FIGURES, _judge(labels)[1](short))
    return to


def keep_labels(store: Store, folder: Path) -> Labels:
    """Open every seal and write the labels with their nonces; return the labels by case."""
    about = store.about()
    lines, out = [], {}
    for number in range(1, int(about['cases']) + 1):
        sealed = store.sealed(number) or {}
        out[number] = seal.unseal(sealed, int(about['seed']))
        lines.append(json.dumps({'nonce': sealed['nonce'], 'label': out[number]}))
    packed = gzip.compress('\n'.join(lines).encode(), mtime=0)
    with replacing(folder / LABELS, replace=True) as file:
        file.write(packed)
    return out


def _asked(label: Mapping[str, Any], row: Mapping[str, Any]) -> dict[str, Any]:
    # A folder without a diagnosis: only what the label says.
    row = make_row(label, Path('none'), Path('none'))
    return {key: row[key] for key in OF_LABEL}


def _figures(rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    return {s.name: f'{figure(s)} of {s.count}' for s in score(rows)}


def _judge(labels: Labels) -> Judge:
    """Return what a row says of its label, and the figures of a table, by what a label holds."""
    label = labels[1]
    if 'inertia' in label:
        return mjcf.asked, mjcf.figures
    if 'truth' in label:
        return arms.asked, arms.figures
    return _asked, _figures


def verify(folder: str | Path) -> list[str]:
    """Check a kept run: seals, labels, table, figures.

    Raises:
        IdentError: INVALID_GOAL for the first thing that is not what was sealed.
    """
    at = Path(folder)
    seals = read_json(at / SEALS)
    if seals is None:
        raise _broken(f'{at} holds no {SEALS}')
    if seal.manifest(seals['seals']) != seals['manifest']:
        raise _broken(f'the digest in {at / SEALS} is not that of its seals')
    said = [f'{len(seals["seals"])} seals, SHA-256 over them {seals["manifest"]}']
    if not (at / LABELS).exists():
        return [*said, 'not opened yet: there are no labels']
    labels = opened_labels(at, seals['seals'])
    said.append(f'{len(labels)} labels: each is what was sealed')
    packed = at / f'{TABLE}.gz'
    table = gzip.decompress(packed.read_bytes()) if packed.exists() else (at / TABLE).read_bytes()
    rows = [json.loads(line) for line in table.decode().splitlines()]
    asked, figures = _judge(labels)
    for row in rows:
        label = json.loads(json.dumps(asked(labels[int(row['case'])], row)))
        if any(row[key] != value for key, value in label.items()):
            raise _broken(f'the row of case {row["case"]} does not say what its label says')
    said.append(f'{len(rows)} rows: each says of its case what the label says')
    found = figures(rows)
    if not (at / FIGURES).exists():
        return [*said, *(f'{name}: {figure}' for name, figure in found.items())]
    if found != read_json(at / FIGURES):
        raise _broken(f'the figures in {at / FIGURES} are not those of the table')
    return [*said, 'the figures are those of the table']


def _broken(text: str) -> IdentError:
    return IdentError(ErrorCode.INVALID_GOAL, f'{text}; take the files of the commit they are in')


def opened_labels(at: Path, seals: Sequence[str]) -> Labels:
    """Return the kept labels by case.

    Raises:
        IdentError: INVALID_GOAL where one is not what was sealed.
    """
    lines = gzip.decompress((at / LABELS).read_bytes()).decode().splitlines()
    out = {}
    for number, (line, wanted) in enumerate(zip(lines, seals, strict=False), 1):
        opened = json.loads(line)
        if seal.digest_of(opened['label'], opened['nonce']) != wanted:
            raise _broken(f'the label of case {number} is not the one that was sealed')
        out[number] = opened['label']
    if len(lines) != len(seals):
        raise _broken(f'{at / LABELS} holds {len(lines)} labels of {len(seals)}')
    return out
