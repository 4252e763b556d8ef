# SPDX-License-Identifier: Apache-2.0
"""Many bags of many machines as one job: each identified and diagnosed, then all compared.

A bag is a row. What a row says is kept in a file of the output directory under a key of everything
that it depends on, so that the same call goes on where the last one ended, and does anew what has
changed. A bad bag costs its own row.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed, Future
import csv
from dataclasses import asdict, dataclass, field
import hashlib
import io
import json
import math
import os
from pathlib import Path
import re
from typing import Any

import yaml

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import make_directory, write_text
from ros2_ident.search.evaluators import Cancel

Row = dict[str, Any]
OnRow = Callable[[Row], None]

# Probability that a drift is said where there is none, over all comparisons of a fleet.
LEVEL = 0.05
_KEYS = {'bag', 'check', 'machine_file', 'machine', 'date', 'labels'}


@dataclass(frozen=True)
class Entry:
    """One bag of a fleet.

    Attributes:
        name: Of its row and file; unique.
        bag: Path of the bag. All paths are absolute: a worker may run in another folder.
        machine_file: Path of the machine file.
        check: Path of a second bag to judge the diagnosis on; empty for none.
        machine: Which machine it was recorded on.
        date: When, in a form that sorts, as 2026-01-31; empty where unknown.
        labels: Whatever else the list says.
    """

    name: str
    bag: str
    machine_file: str
    check: str = ''
    machine: str = ''
    date: str = ''
    labels: Mapping[str, str] = field(default_factory=dict)


def read_fleet(path: str | Path, machine_file: str | None = None) -> list[Entry]:
    """Read a list file, or take the bags of a directory.

    Args:
        path: A YAML file, paths in it relative to it, or a directory of bags.
        machine_file: For bags whose entry names none.

    Returns:
        The entries, in the order of the list or of their names.

    Raises:
        IdentError: NO_DATA or INVALID_GOAL naming the entry and the remedy.
    """
    path = Path(path)
    if path.is_dir():
        bags = sorted(x for x in path.iterdir() if _is_bag(x))
        listed: Any = [{'bag': x.name, 'machine': x.stem} for x in bags]
        base = path
    else:
        base = path.parent
        try:
            content = yaml.safe_load(path.read_text(encoding='utf-8'))
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as exc:
            raise IdentError(
                ErrorCode.NO_DATA,
                f'{path}: cannot be read ({" ".join(str(exc).split())}); give a YAML list of bags '
                'or a directory of them',
            ) from None
        listed = content.get('bags') if isinstance(content, Mapping) else None
        if isinstance(content, Mapping) and 'machine_file' in content:
            machine_file = str(base / str(content['machine_file']))
    if not isinstance(listed, list) or not listed:
        raise IdentError(
            ErrorCode.NO_DATA, f'{path}: holds no bag; write them in a list below `bags:`'
        )
    entries: list[Entry] = []
    for number, given in enumerate(listed, 1):
        entries.append(_entry(path, base, number, given, machine_file, entries))
    return entries


def _is_bag(path: Path) -> bool:
    return path.suffix in ('.mcap', '.db3', '.bag') or (
        path.is_dir() and any(x.suffix in ('.mcap', '.db3', '.zstd') for x in path.iterdir())
    )


def _entry(
    path: Path,
    base: Path,
    number: int,
    given: Any,
    machine_file: str | None,
    before: Sequence[Entry],
) -> Entry:
    where = f'{path}: entry {number}'
    if not isinstance(given, Mapping) or not given.get('bag') or set(given) - _KEYS:
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            f'{where} is not understood; give it `bag`, and of {", ".join(sorted(_KEYS))} what '
            'you know',
        )
    own = given.get('machine_file')
    file = str(base / str(own)) if own else machine_file
    if not file:
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            f'{where} names no machine file; add `machine_file` to it or to the list, or give '
            '--machine',
        )
    bag = str(given['bag'])
    stem = re.sub(r'[^\w.-]+', '_', bag).strip('._') or 'bag'
    taken = {x.name for x in before}
    name = next(n for n in (stem, *(f'{stem}_{k}' for k in range(2, 10**6))) if n not in taken)
    return Entry(
        name,
        os.path.abspath(base / bag),
        os.path.abspath(file),
        os.path.abspath(base / str(given['check'])) if given.get('check') else '',
        str(given.get('machine') or Path(bag).stem),
        str(given.get('date') or ''),
        {str(k): str(v) for k, v in (given.get('labels') or {}).items()},
    )


# ---------------------------------------------------------------- one row


def key_of(entry: Entry, seed: int, diagnosed: bool) -> str:
    """Return a digest of what a row depends on: contents, labels, settings, sources."""
    from ros2_ident.kernel.hooks import sources_digest
    from ros2_ident.recording.storage import digest, storage_files

    total = hashlib.sha256(json.dumps([asdict(entry), seed, diagnosed], default=dict).encode())
    total.update(sources_digest().encode())
    total.update(Path(entry.machine_file).read_bytes())
    for bag in filter(None, (entry.bag, entry.check)):
        total.update(digest(storage_files(bag)[0]).encode())
    return total.hexdigest()


def run_entry(entry: Entry, seed: int, diagnosed: bool, sources: str = '') -> Row:
    """Identify and diagnose one bag; an error is part of the row.

    Args:
        entry: What to run.
        seed: Of every search.
        diagnosed: Whether to diagnose, too.
        sources: Digest of the sources that have to be here; empty for any.
    """
    row: Row = {**asdict(entry), 'labels': dict(entry.labels), 'key': ''}
    try:
        if sources:
            from ros2_ident.identify.problem import require_sources

            require_sources(sources)
        row['key'] = key_of(entry, seed, diagnosed)
        row.update(_found(entry, seed, diagnosed))
    except IdentError as error:
        row.update(state='failed', code=error.code.name, message=error.message)
    except OSError as error:
        row.update(
            state='failed',
            code=ErrorCode.NO_DATA.name,
            message=f'{error.filename or entry.bag}: cannot be read ({error.strerror}); correct '
            'the path in the list',
        )
    except Exception as error:
        # A defect in one bag's run shall not cost the others theirs.
        row.update(
            state='failed',
            code=ErrorCode.INTERNAL.name,
            message=f'{type(error).__name__}: {error}; run this bag alone and report what it says',
        )
    return row


def _found(entry: Entry, seed: int, diagnosed: bool) -> Row:
    from ros2_ident.gap.diagnose import diagnose
    from ros2_ident.gap.verdict import NONE, UNKNOWN
    from ros2_ident.identify.run import identify, read_problem
    from ros2_ident.models import load_machine

    machine = load_machine(entry.machine_file)
    data = read_problem(entry.bag, machine)
    result = identify(machine, data, seed=seed)
    values = {
        p.name: {'value': p.value, 'low': p.low, 'high': p.high, 'unit': p.unit}
        for p in result.parameters
    }
    found: Row = {
        'state': 'done',
        'code': result.outcome.error_code.name,
        'message': result.message,
        'model': result.model,
        'residual': {x.drive: x.rms for x in result.residuals},
        'unit': result.cost.unit,
        'parameters': values,
    }
    if not diagnosed:
        return found
    check = read_problem(entry.check, machine).datasets if entry.check else ()
    verdict = diagnose(machine, data.datasets, check, seed=seed)
    if verdict.effect not in (NONE, UNKNOWN):
        # With the missing effect in the model its nominal parameters are no longer bent by it.
        values.update(
            {
                name: {'value': v.value, 'low': v.low, 'high': v.high, 'unit': v.unit}
                for name, v in verdict.parameters.items()
                if name in values
            }
        )
    return {
        **found,
        'effect': verdict.effect,
        'where': list(verdict.where),
        'also': [{'effect': x.effect, 'where': x.where} for x in verdict.also],
        'probability': verdict.probability,
        'verdict': verdict.sentence,
        'complete': verdict.complete,
    }


# ---------------------------------------------------------------- all rows


def run_fleet(
    entries: Sequence[Entry],
    out: str | Path,
    *,
    seed: int = 1,
    diagnosed: bool = True,
    scheduler: str | None = None,
    cancel: Cancel | None = None,
    on_start: Callable[[Entry], None] | None = None,
    on_row: OnRow | None = None,
) -> list[Row]:
    """Run what is not done yet, and write the summary.

    Args:
        entries: From `read_fleet`.
        out: Output directory; holds a file for each row, `fleet.json` and `fleet.csv`.
        seed: Of every search.
        diagnosed: Whether to diagnose, too.
        scheduler: Address of a Dask scheduler whose workers see the same files; a bag is one task.
        cancel: Looked at between bags; rows that are done stay.
        on_start: Called before a bag is begun in this process.
        on_row: Called with each row as it is there.

    Returns:
        The rows that are there, in the order of the entries.
    """
    rows_folder = make_directory(Path(out) / 'rows')
    rows: dict[str, Row] = {}

    def take(row: Row) -> None:
        text = json.dumps(_plain(row), indent=1, allow_nan=False) + '\n'
        write_text(rows_folder / f'{row["name"]}.json', text)
        rows[row['name']] = _plain(row)
        if on_row is not None:
            on_row(rows[row['name']])

    left = []
    for entry in entries:
        known = _kept(rows_folder / f'{entry.name}.json', entry, seed, diagnosed)
        if known is None:
            left.append(entry)
            continue
        rows[entry.name] = known
        if on_row is not None:
            on_row(known)
    for row in (
        _here(left, seed, diagnosed, cancel, on_start)
        if scheduler is None
        else _there(left, seed, diagnosed, cancel, scheduler)
    ):
        take(row)
    ordered = [rows[entry.name] for entry in entries if entry.name in rows]
    write_summary(Path(out), ordered)
    return ordered


def _kept(path: Path, entry: Entry, seed: int, diagnosed: bool) -> Row | None:
    """Return a row of an earlier run that still holds; failed ones are tried again."""
    try:
        row: Row = json.loads(path.read_text(encoding='utf-8'))
        holds = row['state'] == 'done' and row['key'] == key_of(entry, seed, diagnosed)
    except (OSError, ValueError, KeyError, TypeError, IdentError):
        return None
    return row if holds else None


def _here(
    entries: Sequence[Entry],
    seed: int,
    diagnosed: bool,
    cancel: Cancel | None,
    on_start: Callable[[Entry], None] | None,
) -> Iterator[Row]:
    for entry in entries:
        if cancel is not None and cancel.is_set():
            return
        if on_start is not None:
            on_start(entry)
        yield run_entry(entry, seed, diagnosed)


def _there(
    entries: Sequence[Entry], seed: int, diagnosed: bool, cancel: Cancel | None, scheduler: str
) -> Iterator[Row]:
    from ros2_ident.kernel.hooks import sources_digest
    from ros2_ident.search.cluster import connect

    if not entries:
        return
    client = connect(scheduler)
    try:
        executor = client.get_executor(pure=False)
        tasks: dict[Future[Row], Entry] = {
            executor.submit(run_entry, entry, seed, diagnosed, sources_digest()): entry
            for entry in entries
        }
        for task in as_completed(tasks):
            if cancel is not None and cancel.is_set():
                return
            try:
                yield task.result()
            except Exception as error:
                yield {
                    **asdict(tasks[task]),
                    'key': '',
                    'state': 'failed',
                    'code': ErrorCode.INTERNAL.name,
                    'message': f'the worker was lost ({error}); run the same command again',
                }
    finally:
        client.close()


def _plain(value: Any) -> Any:
    """Return a value as JSON can hold it: no infinity, no NaN."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value


# ---------------------------------------------------------------- summary


def summarise(rows: Sequence[Row]) -> dict[str, Any]:
    """Compare the rows that are done.

    Two values differ where their difference is beyond its own interval: with half widths a and b
    the standard deviation of it is sqrt(a^2 + b^2) / 1.96. The level is shared among all
    comparisons (Holm 1979), so that in a fleet of equal machines one in twenty says anything.

    Returns:
        `drifts`: parameters of a machine against its earliest bag; `machines`: latest values of a
        machine against the mean of the others; both strongest first. `effects`: for each effect
        the drives it was found on.
    """
    done = sorted((r for r in rows if r['state'] == 'done'), key=lambda r: str(r['date']))
    by_machine: dict[str, list[Row]] = {}
    for row in done:
        by_machine.setdefault(row['machine'], []).append(row)
    drifts = [
        _difference(name, row, of_one[0]['parameters'][name], of_one[0]['name'])
        for of_one in by_machine.values()
        for row in of_one[1:]
        for name in row['parameters']
        if name in of_one[0]['parameters']
    ]
    latest = [of_one[-1] for of_one in by_machine.values()]
    machines = []
    for number, row in enumerate(latest):
        for name in row['parameters']:
            others = [r for r in latest if r is not row and name in r['parameters']]
            # What one of two machines is against the other has been said by the first.
            if others and not (len(others) == 1 and others[0] in latest[:number]):
                against = others[0]['machine'] if len(others) == 1 else 'the other machines'
                mean = _mean([r['parameters'][name] for r in others])
                machines.append(_difference(name, row, mean, against))
    effects: dict[str, list[str]] = {}
    for row in done:
        if row.get('effect') not in (None, 'none'):
            for effect, drive in _effects_of(row):
                effects.setdefault(effect, []).append(f'{row["name"]}: {drive}')
    return {'drifts': _told(drifts), 'machines': _told(machines), 'effects': effects}


def _effects_of(row: Row) -> Iterator[tuple[str, str]]:
    for drive in row['where'] or ['all']:
        yield row['effect'], drive
    for further in row.get('also', ()):
        yield further['effect'], further['where']


def _half(value: Mapping[str, Any]) -> float:
    if value['low'] is None or value['high'] is None:
        return math.inf
    return 0.5 * (float(value['high']) - float(value['low']))


def _mean(values: Sequence[Mapping[str, Any]]) -> Row:
    count = len(values)
    middle = sum(float(v['value']) for v in values) / count
    half = math.sqrt(sum(_half(v) ** 2 for v in values)) / count
    return {'value': middle, 'low': middle - half, 'high': middle + half}


def _difference(name: str, row: Row, other: Mapping[str, Any], against: str) -> Row:
    value = row['parameters'][name]
    spread = math.hypot(_half(value), _half(other)) / 1.96
    change = float(value['value']) - float(other['value'])
    strength = abs(change) / spread if 0.0 < spread < math.inf else 0.0
    return {
        'parameter': name,
        'machine': row['machine'],
        'bag': row['name'],
        'against': against,
        'value': value['value'],
        'reference': other['value'],
        'change': change / float(other['value']) if other['value'] else None,
        'unit': value['unit'],
        'p': math.erfc(strength / math.sqrt(2.0)),
    }


def _told(differences: list[Row]) -> list[Row]:
    """Return those that Holm's procedure tells, the surest first."""
    ordered = sorted(differences, key=lambda x: float(x['p']))
    told: list[Row] = []
    for number, difference in enumerate(ordered):
        if difference['p'] > LEVEL / (len(ordered) - number):
            break
        told.append(difference)
    return told


def write_summary(out: Path, rows: Sequence[Row]) -> None:
    """Write `fleet.json` and `fleet.csv`, one line for each bag and parameter or failure."""
    content = {'schema': 'ros2_ident.fleet', 'version': 1, 'rows': rows, **summarise(rows)}
    write_text(out / 'fleet.json', json.dumps(content, indent=1, allow_nan=False) + '\n')
    head = ('bag', 'machine', 'date', 'state', 'code', 'message', 'effect', 'where')
    text = io.StringIO(newline='')
    table = csv.writer(text)
    table.writerow((*head, 'parameter', 'value', 'low', 'high', 'unit'))
    for row in rows:
        same = [row['name'], *(row.get(k, '') for k in head[1:-1])]
        same.append(','.join(row.get('where', ())))
        for name, p in row.get('parameters', {'': {}}).items():
            table.writerow(
                (*same, name, *(p.get(k, '') for k in ('value', 'low', 'high', 'unit')))
            )
    write_text(out / 'fleet.csv', text.getvalue())


def states(rows: Sequence[Row]) -> Counter[str]:
    """Return how many rows are in which state."""
    return Counter(str(row['state']) for row in rows)
