# SPDX-License-Identifier: Apache-2.0
"""The rows of a fleet, one of each bag: what the list gives, and what is found in the bag.

A row is kept in a file of the output directory under a key of everything that it depends on, so
that the same call goes on where the last one ended, and does anew what has changed. A bad bag
fails alone.
"""

from collections.abc import Callable, Collection, Generator, Mapping, Sequence
from concurrent.futures import as_completed, Future
from contextlib import closing
from dataclasses import asdict, replace
import hashlib
import json
import os
from pathlib import Path
import re
from threading import Event
from typing import Any, TYPE_CHECKING

from ros2_ident.arrays import plain
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import make_directory, read_yaml, require_ours, write_json
from ros2_ident.fleet.summary import PAGE, pairs_of, Row, SUMMARY, write_summary
from ros2_ident.search.evaluators import Cancel

if TYPE_CHECKING:
    from ros2_ident.jobs import Request

# How every bag is run: fields of a `jobs.Request`, whether it is `diagnosed`, too, and the
# `effort` that replaces fields of each machine.
How = Mapping[str, Any]
_NOT_ASKED = ('diagnosed', 'effort')
# A row, and the begin of that of the bag before it where the two are compared.
Tasks = Sequence[tuple[Row, Row | None]]
_LARGEST = 1 << 24  # of a list, bytes
_KEYS = {'bag', 'check', 'machine_file', 'machine', 'date', 'labels'}


def read_fleet(path: str | Path, machine_file: str | None = None) -> list[Row]:
    """Read a list file, or take the bags of a directory.

    Args:
        path: A YAML file, paths in it relative to it, or a directory of bags.
        machine_file: For bags whose entry names none.

    Returns:
        The begin of each row, in the order of the list or of their names: `name`, unique; `bag`,
        `more` further ones for the same fit, `check`, `machine_file`, all absolute, for a worker
        may run in another folder; `machine`, `date`, `labels`.

    Raises:
        IdentError: NO_DATA or INVALID_GOAL naming the entry and the remedy.
    """
    path = Path(path)
    base = path if path.is_dir() else path.parent
    if path.is_dir():
        bags = {x for x in path.iterdir() if x.suffix in ('.mcap', '.db3', '.bag')}
        bags |= {x.parent for x in path.glob('*/*') if x.suffix in ('.mcap', '.db3', '.zstd')}
        listed: Any = [{'bag': x.name, 'machine': x.stem} for x in sorted(bags)]
    else:
        try:
            content = read_yaml(path, _LARGEST)
        except ValueError as error:
            raise ErrorCode.NO_DATA.error(
                f'{path}: {error}; give a YAML list of bags or a directory of them'
            ) from None
        listed = content.get('bags') if isinstance(content, Mapping) else None
        if isinstance(content, Mapping) and 'machine_file' in content:
            machine_file = str(base / str(content['machine_file']))
    if not isinstance(listed, list) or not listed:
        raise ErrorCode.NO_DATA.error(f'{path}: holds no bag; write them in a list below `bags:`')
    rows: dict[str, Row] = {}
    for number, given in enumerate(listed, 1):
        row = _begun(f'{path}: entry {number}', base, given, machine_file, rows)
        rows[row['name']] = row
    return [*rows.values()]


def _begun(
    where: str, base: Path, given: Any, machine_file: str | None, taken: Collection[str]
) -> Row:
    if not isinstance(given, Mapping) or not given.get('bag') or set(given) - _KEYS:
        raise ErrorCode.INVALID_GOAL.error(
            f'{where} is not understood; give it `bag`, and of {", ".join(sorted(_KEYS))} what '
            'you know'
        )
    own = given.get('machine_file')
    file = str(base / str(own)) if own else machine_file
    if not file:
        raise ErrorCode.INVALID_GOAL.error(
            f'{where} names no machine file; add `machine_file` to it or to the list, or give '
            '--machine'
        )
    bag, *more = map(str, given['bag'] if isinstance(given['bag'], list) else [given['bag']])
    stem = re.sub(r'[^\w.-]+', '_', bag).strip('._') or 'bag'
    names = (stem, *(f'{stem}_{k}' for k in range(2, len(taken) + 2)))
    return {
        'name': next(name for name in names if name not in taken),
        'bag': os.path.abspath(base / bag),
        'machine_file': os.path.abspath(file),
        'check': os.path.abspath(base / str(given['check'])) if given.get('check') else '',
        'machine': str(given.get('machine') or Path(bag).stem),
        'date': str(given.get('date') or ''),
        'labels': {str(k): str(v) for k, v in (given.get('labels') or {}).items()},
        'more': [os.path.abspath(base / x) for x in more],
    }


def run_fleet(
    entries: Sequence[Row],
    out: str | Path,
    how: How,
    *,
    scheduler: str | None = None,
    cancel: Cancel | None = None,
    on_start: Callable[[Row], None] = lambda entry: None,
    on_row: Callable[[Row], None] = lambda row: None,
) -> list[Row]:
    """Run what is not done yet, and write the summary.

    Args:
        out: Output directory; holds a file for each row, and `fleet.json`.
        scheduler: Address of a Dask scheduler whose workers see the same files; a bag is one task.
        cancel: Looked at between bags; rows that are done stay.

    Returns:
        The rows that are there, in the order of the entries, and those of the comparisons.

    Raises:
        IdentError: INVALID_GOAL where something is there that is not ours to replace, or a file
            cannot be written.
    """
    cancel = cancel or Event()
    folder, rows = make_directory(Path(out) / 'rows'), dict[str, Row]()
    require_ours([Path(out) / name for name in (SUMMARY, PAGE)])

    def work(tasks: Tasks) -> None:
        files = {x['name']: folder / f'{x["name"]}.json' for x, _ in tasks}
        require_ours(files.values())
        left = []
        for entry, before in tasks:
            if (known := _kept(files[entry['name']], entry, how, before)) is None:
                left.append((entry, before))
            else:
                rows[entry['name']] = known
                on_row(known)
        with closing(_worked(left, how, scheduler, on_start)) as found:
            while not cancel.is_set() and (row := plain(next(found, None))) is not None:
                rows[row['name']] = row
                on_row(row)
                write_json(files[row['name']], {'format': 'ros2_ident.row', **row})

    work([(entry, None) for entry in entries])
    begun = {x['name']: x for x in entries}
    pairs = pairs_of([rows[name] for name in begun if name in rows])
    work([({**begun[x['after']], **x}, begun[x['before']]) for x in pairs])
    names = [*begun, *(x['name'] for x in pairs)]
    ordered = [rows[name] for name in names if name in rows]
    write_summary(Path(out), ordered)
    return ordered


def _kept(path: Path, entry: Row, how: How, before: Row | None) -> Row | None:
    """Return a row of an earlier run that still holds; failed ones are tried again."""
    try:
        row: Row = json.loads(path.read_text(encoding='utf-8'))
        row.pop('format', None)
        holds = row['state'] == 'done' and row['key'] == key_of(entry, how, before)
    except (OSError, ValueError, KeyError, TypeError, IdentError):
        return None
    return row if holds else None


def _worked(
    tasks: Tasks, how: How, scheduler: str | None, on_start: Callable[[Row], None]
) -> Generator[Row]:
    """Yield each row as it is there, from this process or from the workers of a scheduler."""
    if scheduler is None:
        for entry, before in tasks:
            on_start(entry)
            yield run_entry(entry, how, before)
        return
    from ros2_ident.identify.problem import sources
    from ros2_ident.search.evaluators import connect

    if not tasks:
        return
    client = connect(scheduler)
    try:
        submit, here = client.get_executor(pure=False).submit, sources()
        futures: dict[Future[Row], Row] = {
            submit(run_entry, entry, how, before, here): entry for entry, before in tasks
        }
        for future in as_completed(futures):
            try:
                yield future.result()
            except Exception as error:
                lost = f'the worker was lost ({error}); run the same command again'
                yield _failed(futures[future], ErrorCode.INTERNAL, lost)
    finally:
        client.close()


def key_of(entry: Row, how: How, before: Row | None = None) -> str:
    """Return a digest of what a row depends on.

    That is what the list gives, what is asked for, the sources of everything that has a part in a
    result, the versions of the libraries, the bytes of the machine file and of the bags, and all
    of that of the bag it is compared with.

    Raises:
        IdentError: As `load_machine`, or where a bag is not there.
    """
    from ros2_ident.identify.problem import sources
    from ros2_ident.recording.storage import digest, storage_files

    asked = {k: v for k, v in vars(_request(entry, how)).items() if k != 'machine'}
    beside = how.get('diagnosed', True), how.get('effort', {})
    total = hashlib.sha256(f'{json.dumps(entry)}{asked}{beside}'.encode())
    total.update(b'' if before is None else key_of(before, how).encode())
    total.update(sources().encode())
    total.update(Path(entry['machine_file']).read_bytes())
    for bag in filter(None, (entry['bag'], *entry['more'], entry['check'])):
        total.update(digest(storage_files(bag)[0]).encode())
    return total.hexdigest()


def _request(entry: Row, how: How) -> 'Request':
    from ros2_ident.jobs import Request
    from ros2_ident.models import load_machine

    return Request(
        replace(load_machine(entry['machine_file']), **how.get('effort', {})),
        bags=(entry['bag'], *entry['more']),
        check=(entry['check'],) if entry['check'] else (),
        machine_file=entry['machine_file'],
        **{name: value for name, value in how.items() if name not in _NOT_ASKED},
    )


def run_entry(entry: Row, how: How, before: Row | None = None, here: str = '') -> Row:
    """Identify and diagnose one bag, or compare it with one before; an error is part of the row.

    Args:
        here: What `identify.problem.sources` has to return here; empty for anything.
    """
    row = {**entry, 'key': ''}
    try:
        if here:
            from ros2_ident.identify.problem import require_sources

            require_sources(here)
        row['key'] = key_of(entry, how, before)
        return {**row, **(_found(entry, how) if before is None else _changed(entry, how, before))}
    except IdentError as error:
        return _failed(row, error.code, error.message)
    except OSError as error:
        where = f'{error.filename or entry["bag"]}: cannot be read ({error.strerror})'
        return _failed(row, ErrorCode.NO_DATA, f'{where}; correct the path in the list')
    except Exception as error:
        # A defect in one bag's run shall not cost the others theirs.
        what = f'{type(error).__name__}: {error}; run this bag alone and report what it says'
        return _failed(row, ErrorCode.INTERNAL, what)


def _failed(row: Row, code: ErrorCode, message: str) -> Row:
    return {'key': '', **row, 'state': 'failed', 'code': code.name, 'message': message}


def _changed(entry: Row, how: How, before: Row) -> Row:
    from ros2_ident import jobs
    from ros2_ident.identify.layout import Conditions
    from ros2_ident.words.change import changed

    request = replace(_request(before, how), conditions=Conditions())
    later = (entry['bag'], *entry['more'])
    found = jobs.compare(request, later, among=entry['among']).result
    return {'state': 'done', 'code': 'OK', 'message': ' '.join(changed(found)),
            'found': asdict(found)}  # fmt: skip


def _found(entry: Row, how: How) -> Row:
    from ros2_ident import jobs
    from ros2_ident.words.identification import message
    from ros2_ident.words.verdict import sentence

    request = _request(entry, how)
    logs = jobs.read(request)
    result = jobs.identify(request, logs).result
    found: Row = {
        'parameters': {
            p.name: {'value': p.value, 'low': p.low, 'high': p.high, 'unit': p.unit}
            for p in result.parameters
        },
        'state': 'done',
        'code': result.outcome.error_code.name,
        'message': message(result),
        'warnings': list(result.quality.warnings),
        'model': result.model,
        'residual': {x.drive: x.rms for x in result.residuals},
        'unit': result.cost.unit,
    }
    if not how.get('diagnosed', True):
        return found
    verdict = jobs.diagnose(request, logs).result
    return {
        **found,
        'effect': verdict.effect,
        'where': list(verdict.where),
        'also': [asdict(x) for x in verdict.also],
        'probability': verdict.probability,
        'verdict': sentence(verdict),
        'complete': verdict.complete,
    }
