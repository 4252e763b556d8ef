# SPDX-License-Identifier: Apache-2.0
"""The messages of a db3 bag (SQLite), whole or damaged.

A sound file is read by SQLite itself. A damaged one is read page by page, without the trees that
SQLite would follow. The format has no checksums; what `write_bag` writes states one per topic.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import closing
from pathlib import Path
import sqlite3
from typing import Any
from urllib.parse import quote
import zlib

from ros2_ident.recording.content import Content, Sink
from ros2_ident.recording.damage import Damage, Losses
from ros2_ident.recording.sqlite_pages import MAGIC, Pages, Row

# Custom data of a bag: the checksum over times and bytes of a topic's messages.
CHECKSUM = 'crc32 of '
_SOUND_STEPS, _STEPS_PER_BYTE, _EVERY = 2_000_000, 20, 10_000


def scan(path: Path, content: Content, checksums: Mapping[str, str] | None = None) -> Losses:
    """Read the whole messages of a db3 file into a bag's content.

    Args:
        path: The file.
        content: What to fill.
        checksums: Of topics, as `topic_checksum` gives; of a bag in one file.

    Returns:
        What is lost of the file; its text is empty where nothing is.

    Raises:
        Damage: The file is no SQLite file, or no table of it is a bag's.
    """
    size = path.stat().st_size
    with path.open('rb') as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise Damage('no SQLite file: its first bytes are others')
    reader = _Reader(path, size, content, checksums or {})
    if not reader.read_sound():
        reader.read_pages()
    return reader.finish()


def topic_checksum(messages: Iterable[tuple[int, bytes]]) -> str:
    """Return the checksum over log times, ns, and bytes of a topic's messages, in order."""
    total = 0
    for when, data in messages:
        total = zlib.crc32(data, zlib.crc32(when.to_bytes(8, 'little', signed=True), total))
    return f'{total:08x}'


class _Reader:
    """The state of reading one file."""

    def __init__(
        self, path: Path, size: int, content: Content, checksums: Mapping[str, str]
    ) -> None:
        self.path, self.size, self.content = path, size, content
        self.checksums = checksums
        self.losses = Losses(size=size)
        self.ways: dict[int, tuple[str, Sink | None]] = {}
        self.found: Counter[int] = Counter()
        self.sums: Counter[int] = Counter()
        if (wal := path.with_name(path.name + '-wal')).is_file() and wal.stat().st_size:
            self.losses.say(f'{wal.name} beside it holds messages that were never moved into it')

    # ------------------------------------------------------------------ by SQLite

    def read_sound(self) -> bool:
        """Read by SQLite; return False where the file is damaged and nothing was taken."""
        name = f'file:{quote(str(self.path))}?mode=ro&immutable=1'
        try:
            with closing(sqlite3.connect(name, uri=True)) as base:
                self._guard(base)
                if base.execute('PRAGMA quick_check(1)').fetchone() != ('ok',):
                    return False
                self._topics(base)
                self._messages(base)
        except (sqlite3.Error, UnicodeDecodeError, OverflowError):
            if self.found:
                raise Damage('SQLite finds it sound and fails to read it') from None
            self.ways.clear()
            return False
        return True

    def _guard(self, base: sqlite3.Connection) -> None:
        """Let no damaged or crafted file compute without end, or anything but read tables."""
        left = (_SOUND_STEPS + _STEPS_PER_BYTE * self.size) // _EVERY

        def tick() -> int:
            nonlocal left
            left -= 1
            return left < 0

        base.set_progress_handler(tick, _EVERY)
        base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, self.content.limits.chunk)
        base.execute('PRAGMA trusted_schema = OFF')
        base.execute('PRAGMA cell_size_check = ON')
        known = dict(base.execute('SELECT name, type FROM sqlite_master'))
        if known.get('topics') != 'table' or known.get('messages') != 'table':
            raise sqlite3.DatabaseError('no bag')

    def _topics(self, base: sqlite3.Connection) -> None:
        query = 'SELECT id, name, type, serialization_format FROM topics ORDER BY id'
        for number, name, kind, form in base.execute(query):
            self._open(number, name, kind, form)

    def _messages(self, base: sqlite3.Connection) -> None:
        wanted = [number for number, (_, target) in self.ways.items() if target is not None]
        counts = base.execute('SELECT topic_id, count(*) FROM messages GROUP BY topic_id')
        self.found.update({k: n for k, n in counts if k in self.ways and k not in wanted})
        marks = ', '.join('?' * len(wanted))
        rows = base.execute(
            f'SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) '  # noqa: S608
            'ORDER BY timestamp, rowid',
            wanted,
        )
        while part := rows.fetchmany(1000):
            for topic, when, data in part:
                self._take(topic, when, data)

    # ------------------------------------------------------------------ page by page

    def read_pages(self) -> None:
        """Read what the pages hold, whatever leads to them."""
        with self.path.open('rb') as file:
            pages = Pages(file, self.size, self.content.limits.chunk)
            if pages.stated > pages.count or self.size % pages.page:
                self.losses.end = self.size
            else:
                self.losses.say('SQLite finds it malformed')
            for row in pages.rows():
                if _is_topic(row):
                    self._open(row.number, *row.values[1:4])
            for row in pages.rows():
                if _is_message(row):
                    self._take(*row.values[1:4])
            self.losses.blocks += pages.damaged // 2
        if not self.ways and not self.found:
            raise Damage("none of its tables is a bag's")

    # ------------------------------------------------------------------ both

    def _open(self, number: Any, name: Any, kind: Any, form: Any) -> None:
        if not isinstance(name, str) or not isinstance(kind, str) or number in self.ways:
            return
        kind = kind if form in ('cdr', '') else f'{kind} ({form})'
        self.ways[number] = name, self.content.open(name, kind)

    def _take(self, topic: Any, when: Any, data: Any) -> None:
        if not isinstance(when, int) or not isinstance(data, bytes) or topic not in self.ways:
            self.losses.unknown += 1
            return
        self.found[topic] += 1
        target = self.ways[topic][1]
        if target is not None:
            target.append(when, data)
            if self.checksums:
                head = when.to_bytes(8, 'little', signed=True)
                self.sums[topic] = zlib.crc32(data, zlib.crc32(head, self.sums[topic]))

    def finish(self) -> Losses:
        """Return what is lost."""
        for number, (topic, target) in self.ways.items():
            count = self.found[number]
            self.content.counts[topic] = self.content.counts.get(topic, 0) + count
            stated = self.checksums.get(topic)
            if stated and target is not None and stated != f'{self.sums[number]:08x}':
                self.losses.say(f'the checksum of {topic} does not fit')
        named = {topic for topic, _ in self.ways.values()}
        for topic in sorted(self.content.wanted.keys() & set(self.checksums) - named):
            self.losses.say(f'{topic} is missing')
        self.losses.whole = sum(self.found.values())
        return self.losses


def _is_topic(row: Row) -> bool:
    return len(row.values) in (4, 5, 6) and all(isinstance(x, str) for x in row.values[1:4])


def _is_message(row: Row) -> bool:
    kinds = [type(x) for x in row.values[1:]]
    return len(row.values) == 4 and kinds == [int, int, bytes]
