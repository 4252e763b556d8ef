# SPDX-License-Identifier: Apache-2.0
"""The rows of a fleet: what is found in a bag, here or on a cluster, and the key of its causes."""

from collections.abc import Callable, Generator, Sequence
from concurrent.futures import as_completed, Future
from contextlib import closing
from dataclasses import asdict, fields, replace
import hashlib
import json
from pathlib import Path
from threading import Event

from ros2_ident.arrays import plain
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import make_directory, require_ours, write_text
from ros2_ident.fleet.entries import Entry, Row, Wish
from ros2_ident.fleet.summary import effects_named, PAGE, sound, SUMMARY, TABLE, write_summary
from ros2_ident.search.evaluators import Cancel

Tasks = Sequence[tuple[Entry, Row | None]]
# Ids, each with its place.
Effects = Sequence[Sequence[str]]
MARKED = {'format': 'ros2_ident.row'}


def run_fleet(
    entries: Sequence[Entry],
    out: str | Path,
    *,
    wish: Wish | None = None,
    scheduler: str | None = None,
    cancel: Cancel | None = None,
    on_start: Callable[[Entry], None] = lambda entry: None,
    on_row: Callable[[Row], None] = lambda row: None,
) -> list[Row]:
    """Run what is not done yet, and write the summary.

    Args:
        entries: From `read_fleet`.
        out: Output directory; holds a file for each row, `fleet.json` and `fleet.csv`.
        wish: How; as a command without options where None.
        scheduler: Address of a Dask scheduler whose workers see the same files; a bag is one task.
        cancel: Looked at between bags; rows that are done stay.
        on_start: Called before a bag is begun in this process.
        on_row: Called with each row as it is there.

    Returns:
        The rows that are there, in the order of the entries.

    Raises:
        IdentError: INVALID_GOAL where something is there that is not ours to replace; or, when all
            is worked out, where a file could not be written.
    """
    wish, cancel = wish or Wish(), cancel or Event()
    files = {x.name: make_directory(Path(out) / 'rows') / f'{x.name}.json' for x in entries}
    require_ours([*(Path(out) / name for name in (SUMMARY, TABLE, PAGE)), *files.values()])
    rows: dict[str, Row] = {}
    unwritten: list[IdentError] = []

    def work(tasks: Tasks) -> None:
        with closing(_worked(tasks, wish, scheduler, on_start)) as found:
            while not cancel.is_set() and (row := plain(next(found, None))) is not None:
                rows[row['name']] = row
                on_row(row)
                text = json.dumps({**MARKED, **row}, indent=1, allow_nan=False) + '\n'
                try:
                    write_text(files[row['name']], text)
                except IdentError as error:  # the others are worked out all the same
                    unwritten.append(error)

    for entry in entries:
        if (known := _kept(files[entry.name], entry, wish)) is not None:
            rows[entry.name] = known
            on_row(known)
    work([(entry, None) for entry in entries if entry.name not in rows])
    # Values are compared of one model on all logs: with every effect that was named on any.
    common = effects_named(rows.values())
    done = [(e, rows[e.name]) for e in entries if e.name in rows and sound(rows[e.name])]
    work([(e, {**r, 'common': common}) for e, r in done if r.get('common', []) != common])
    ordered = [rows[entry.name] for entry in entries if entry.name in rows]
    if unwritten:
        raise unwritten[0]
    write_summary(Path(out), ordered)
    return ordered


def _kept(path: Path, entry: Entry, wish: Wish) -> Row | None:
    """Return a row of an earlier run that still holds; failed ones are tried again."""
    try:
        row: Row = json.loads(path.read_text(encoding='utf-8'))
        row.pop('format', None)
        holds = row['state'] == 'done' and row['key'] == key_of(entry, wish)
    except (OSError, ValueError, KeyError, TypeError, IdentError):
        return None
    return row if holds else None


def _worked(
    tasks: Tasks, wish: Wish, scheduler: str | None, on_start: Callable[[Entry], None]
) -> Generator[Row]:
    """Yield each row as it is there, from this process or from the workers of a scheduler."""
    if scheduler is None:
        for entry, known in tasks:
            on_start(entry)
            yield run_entry(entry, wish, '', known)
        return
    from ros2_ident.identify.problem import sources
    from ros2_ident.search.evaluators import connect

    if not tasks:
        return
    client = connect(scheduler)
    try:
        executor = client.get_executor(pure=False)
        futures: dict[Future[Row], Entry] = {
            executor.submit(run_entry, entry, wish, sources(), known): entry
            for entry, known in tasks
        }
        for future in as_completed(futures):
            try:
                yield future.result()
            except Exception as error:
                lost = f'the worker was lost ({error}); run the same command again'
                yield _failed(_named(futures[future]), ErrorCode.INTERNAL, lost)
    finally:
        client.close()


def key_of(entry: Entry, wish: Wish) -> str:
    """Return a digest of what a row depends on.

    That is what the list says, the settings, the sources of everything that has a part in a
    result, the versions of the libraries, and the bytes of the machine file and of the bags.
    """
    from ros2_ident.identify.problem import sources
    from ros2_ident.recording.storage import digest, storage_files

    total = hashlib.sha256(f'{json.dumps(asdict(entry), default=dict)}{wish!r}'.encode())
    total.update(sources().encode())
    total.update(Path(entry.machine_file).read_bytes())
    for bag in filter(None, (entry.bag, *entry.more, entry.check)):
        total.update(digest(storage_files(bag)[0]).encode())
    return total.hexdigest()


def run_entry(entry: Entry, wish: Wish, asked: str = '', known: Row | None = None) -> Row:
    """Identify and diagnose one bag; an error is part of the row.

    Args:
        asked: What `identify.problem.sources` has to return here; empty for anything.
        known: A row whose parameters alone are fitted anew, beside those of its `common` effects.
    """
    row = {**(known or {}), **_named(entry)}
    try:
        if asked:
            from ros2_ident.identify.problem import require_sources

            require_sources(asked)
        row['key'] = key_of(entry, wish)
        return {**row, **_found(entry, wish, None if known is None else known['common'])}
    except IdentError as error:
        return _failed(row, error.code, error.message)
    except OSError as error:
        where = f'{error.filename or entry.bag}: cannot be read ({error.strerror})'
        return _failed(row, ErrorCode.NO_DATA, f'{where}; correct the path in the list')
    except Exception as error:
        # A defect in one bag's run shall not cost the others theirs.
        what = f'{type(error).__name__}: {error}; run this bag alone and report what it says'
        return _failed(row, ErrorCode.INTERNAL, what)


def _named(entry: Entry) -> Row:
    return {**asdict(entry), 'labels': dict(entry.labels), 'key': ''}


def _failed(row: Row, code: ErrorCode, message: str) -> Row:
    return {**row, 'state': 'failed', 'code': code.name, 'message': message}


def _found(entry: Entry, wish: Wish, common: Effects | None) -> Row:
    """Return what is found in a bag; only the parameters beside common effects where given."""
    from ros2_ident import jobs
    from ros2_ident.models import EffectAt, load_machine
    from ros2_ident.words.identification import message
    from ros2_ident.words.verdict import sentence

    request = jobs.Request(
        load_machine(entry.machine_file),
        bags=(entry.bag, *entry.more),
        check=(entry.check,) if entry.check else (),
        machine_file=entry.machine_file,
        **{x.name: getattr(wish, x.name) for x in fields(wish) if x.name != 'diagnosed'},
    )
    logs = jobs.read(request)
    known = request.problem(logs.fit).models[0].extensions() if common else ()
    effects = [at for at in (EffectAt(*x) for x in common or ()) if at in known]
    result = jobs.identify(replace(request, effects=tuple(effects)), logs).result
    values: Row = {
        'parameters': {
            p.name: {'value': p.value, 'low': p.low, 'high': p.high, 'unit': p.unit}
            for p in result.parameters
        },
        'beside': [[at.effect, at.where] for at in effects],
    }
    if common is not None:
        return values
    found: Row = {
        'state': 'done',
        'code': result.outcome.error_code.name,
        'message': message(result),
        'warnings': list(result.quality.warnings),
        'model': result.model,
        'residual': {x.drive: x.rms for x in result.residuals},
        'unit': result.cost.unit,
        **values,
    }
    if not wish.diagnosed:
        return found
    verdict = jobs.diagnose(request, logs).result
    return {
        **found,
        'effect': verdict.effect,
        'where': list(verdict.where),
        'also': [{'effect': x.effect, 'where': x.where} for x in verdict.also],
        'probability': verdict.probability,
        'verdict': sentence(verdict),
        'gap': {
            name: {
                'before': g.before,
                'after': g.after,
                'share_before': g.shares[0],
                'share_after': g.shares[1],
            }
            for name, g in verdict.per_drive.items()
            if g.torque_rms > 0.0
        },
        'complete': verdict.complete,
    }
