# SPDX-License-Identifier: Apache-2.0
"""The rows of a fleet that are not done yet, here or on a cluster."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed, Future
from dataclasses import asdict
import json
from pathlib import Path

from ros2_ident.arrays import plain
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import make_directory, require_ours, write_text
from ros2_ident.fleet.entries import Entry, Wish
from ros2_ident.fleet.row import key_of, Row, run_entry
from ros2_ident.fleet.summary import effects_named, PAGE, sound, SUMMARY, TABLE, write_summary
from ros2_ident.search.evaluators import Cancel

OnRow = Callable[[Row], None]
Tasks = Sequence[tuple[Entry, Row | None]]
MARKED = {'format': 'ros2_ident.row'}


def run_fleet(
    entries: Sequence[Entry],
    out: str | Path,
    *,
    wish: Wish | None = None,
    scheduler: str | None = None,
    cancel: Cancel | None = None,
    on_start: Callable[[Entry], None] | None = None,
    on_row: OnRow | None = None,
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
    wish = wish or Wish()
    rows_folder = make_directory(Path(out) / 'rows')
    names = SUMMARY, TABLE, PAGE, *(f'rows/{entry.name}.json' for entry in entries)
    require_ours(Path(out) / name for name in names)
    rows: dict[str, Row] = {}

    unwritten: list[IdentError] = []

    def take(row: Row) -> None:
        text = json.dumps({**MARKED, **plain(row)}, indent=1, allow_nan=False) + '\n'
        rows[row['name']] = plain(row)
        if on_row is not None:
            on_row(rows[row['name']])
        try:
            write_text(rows_folder / f'{row["name"]}.json', text)
        except IdentError as error:  # the others are worked out all the same
            unwritten.append(error)

    left = []
    for entry in entries:
        known = _kept(rows_folder / f'{entry.name}.json', entry, wish)
        if known is None:
            left.append(entry)
            continue
        rows[entry.name] = known
        if on_row is not None:
            on_row(known)

    def work(tasks: Tasks) -> None:
        for row in (
            _here(tasks, wish, cancel, on_start)
            if scheduler is None
            else _there(tasks, wish, cancel, scheduler)
        ):
            take(row)

    work([(entry, None) for entry in left])
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


def _here(
    tasks: Tasks,
    wish: Wish,
    cancel: Cancel | None,
    on_start: Callable[[Entry], None] | None,
) -> Iterator[Row]:
    for entry, known in tasks:
        if cancel is not None and cancel.is_set():
            return
        if on_start is not None:
            on_start(entry)
        yield run_entry(entry, wish, '', known)


def _there(
    entries: Tasks, wish: Wish, cancel: Cancel | None, scheduler: str
) -> Iterator[Row]:
    from ros2_ident.identify.problem import sources
    from ros2_ident.search.cluster import connect

    if not entries:
        return
    client = connect(scheduler)
    try:
        executor = client.get_executor(pure=False)
        tasks: dict[Future[Row], Entry] = {
            executor.submit(run_entry, entry, wish, sources(), known): entry
            for entry, known in entries
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
