# SPDX-License-Identifier: Apache-2.0
"""The messages of a sound db3 bag (SQLite); its format has no checksums."""

from collections import Counter
from contextlib import closing
from pathlib import Path
import sqlite3
from urllib.parse import quote

from ros2_ident.recording.content import Content, Sink
from ros2_ident.recording.damage import Damage, Losses
from ros2_ident.recording.limits import Limits

_SOUND_STEPS, _STEPS_PER_BYTE, _EVERY = 2_000_000, 20, 10_000


def scan(path: Path, content: Content) -> Losses:
    """Read the messages of a db3 file into a bag's content.

    Args:
        path: The file.
        content: What to fill.

    Returns:
        What is lost of the file; its text is empty where nothing is.

    Raises:
        Damage: SQLite finds it malformed, or no bag.
    """
    losses = Losses(size=path.stat().st_size)
    wal = path.with_name(path.name + '-wal')
    if wal.is_file() and wal.stat().st_size:
        losses.say(f'{wal.name} beside it holds messages that were never moved into it')
    name = f'file:{quote(str(path))}?mode=ro&immutable=1'
    try:
        with closing(sqlite3.connect(name, uri=True)) as base:
            _guard(base, losses.size)
            if base.execute('PRAGMA quick_check(1)').fetchone() != ('ok',):
                raise Damage('SQLite finds it malformed')
            _read(base, content, losses)
    except (sqlite3.Error, UnicodeDecodeError, OverflowError, TypeError) as exc:
        raise Damage(f'SQLite cannot read it: {exc}') from None
    return losses


def _guard(base: sqlite3.Connection, size: int) -> None:
    """Let no damaged or crafted file compute without end, or anything but read tables."""
    left = (_SOUND_STEPS + _STEPS_PER_BYTE * size) // _EVERY

    def tick() -> int:
        nonlocal left
        left -= 1
        return left < 0

    base.set_progress_handler(tick, _EVERY)
    base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, Limits.from_environment().chunk)
    base.execute('PRAGMA trusted_schema = OFF')
    base.execute('PRAGMA cell_size_check = ON')
    known = dict(base.execute('SELECT name, type FROM sqlite_master'))
    if known.get('topics') != 'table' or known.get('messages') != 'table':
        raise Damage("none of its tables is a bag's")


def _read(base: sqlite3.Connection, content: Content, losses: Losses) -> None:
    ways: dict[int, tuple[str, Sink | None]] = {}
    query = 'SELECT id, name, type, serialization_format FROM topics ORDER BY id'
    for number, name, kind, form in base.execute(query):
        kind = kind if form in ('cdr', '') else f'{kind} ({form})'
        ways[number] = name, content.open(name, kind)
    found: Counter[int] = Counter()
    found.update(dict(base.execute('SELECT topic_id, count(*) FROM messages GROUP BY topic_id')))
    losses.unknown = sum(count for number, count in found.items() if number not in ways)
    wanted = [number for number, (_, target) in ways.items() if target is not None]
    rows = base.execute(
        'SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN '  # noqa: S608
        f'({", ".join("?" * len(wanted))}) ORDER BY timestamp, rowid',
        wanted,
    )
    for number, when, data in rows:
        if not isinstance(when, int) or not isinstance(data, bytes):
            found[number] -= 1
            losses.unknown += 1
            continue
        ways[number][1](when, data)  # type: ignore[misc]
    for number, (topic, _) in ways.items():
        content.counts[topic] += found[number]
        losses.whole += found[number]
