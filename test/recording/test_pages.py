# SPDX-License-Identifier: Apache-2.0
"""Rows read page by page are those that SQLite reads; what is damaged is counted."""

from contextlib import closing
import sqlite3
import struct

import pytest

from ros2_ident.recording.damage import Damage
from ros2_ident.recording.sqlite_pages import Pages

# Every kind of value: integers by their bytes, at both ends.
INTEGERS = [0, 1, -1, 2] + [s * (1 << n) for n in (7, 15, 23, 31, 47, 62) for s in (1, -1)]
INTEGERS += [(1 << n) - 1 for n in (7, 15, 23, 31, 47, 63)] + [-(1 << 63)]
PLAIN = [None, 1.5, -2e300, '', 'ä text', b'', b'\x00\xff', *INTEGERS]


def base_of(path, rows, page=4096, table='CREATE TABLE t(id INTEGER PRIMARY KEY, a, b)'):
    with closing(sqlite3.connect(path)) as base:
        base.execute(f'PRAGMA page_size = {page}')
        base.execute(table)
        base.executemany('INSERT INTO t VALUES (?, ?, ?)', rows)
        base.commit()
    return path


def pages_of(path, largest=1 << 20, size=None):
    """Return the pages with all their rows but those of the schema."""
    with path.open('rb') as file:
        pages = Pages(file, path.stat().st_size if size is None else size, largest)
        return pages, [row for row in pages.rows() if row.values[:1] != ('table',)]


@pytest.mark.parametrize('page', [512, 4096, 65536])
def test_every_kind_of_value_comes_back(tmp_path, page):
    rows = [(k + 1, value, k) for k, value in enumerate(PLAIN)]
    pages, found = pages_of(base_of(tmp_path / 'b', rows, page))
    assert pages.page == pages.usable == page
    assert (pages.damaged, pages.stated) == (0, pages.count)
    assert [(row.number, row.values) for row in found] == [
        (number, (None, value, other)) for number, value, other in rows
    ]
    assert [type(row.values[1]) for row in found] == [type(value) for value in PLAIN]


@pytest.mark.parametrize('page', [512, 1024])
def test_long_rows_go_on_where_sqlite_puts_them(tmp_path, page):
    # Up to what fits, one more, and over several pages: each split is another one.
    sizes = [*range(page - 60, page + 20, 3), *range(2 * page - 60, 2 * page, 7), 5 * page, 20_000]
    rows = [(k + 1, bytes([k % 251]) * size, 'end') for k, size in enumerate(sizes)]
    pages, found = pages_of(base_of(tmp_path / 'b', rows, page))
    assert pages.damaged == 0
    got = {row.number: row.values for row in found}
    assert got == {number: (None, value, 'end') for number, value, _ in rows}
    least = max(len(value) for _, value, _ in rows)
    pages, found = pages_of(tmp_path / 'b', largest=least)
    assert pages.damaged == 1 and len(found) == len(rows) - 1
    assert len(pages_of(tmp_path / 'b', largest=least + 20)[1]) == len(rows)


def test_numbers_of_rows_have_up_to_nine_bytes(tmp_path):
    numbers = [
        1,
        127,
        128,
        16_383,
        16_384,
        1 << 48,
        (1 << 56) - 1,
        1 << 56,
        (1 << 63) - 1,
        -1,
        -300,
    ]
    _, found = pages_of(base_of(tmp_path / 'b', [(n, n, 'x') for n in numbers]))
    assert {row.number for row in found} == {n % (1 << 64) for n in numbers}
    assert {row.values[1] for row in found} == set(numbers)


# ---------------------------------------------------------------------- heads and damage


def test_the_head_of_a_file_is_doubted(tmp_path):
    rows = [(k, b'x' * 100, k) for k in range(1, 100)]
    path = base_of(tmp_path / 'b', rows)
    whole = path.read_bytes()

    def read(at, value, size=None):
        path.write_bytes(whole[:at] + value + whole[at + len(value) :])
        return pages_of(path, size=size)

    for stated, page in ((b'\x00\x01', 65536), (b'\x02\x00', 512), (b'\x80\x00', 32768)):
        assert read(16, stated)[0].page == page
    for nonsense in (b'\x00\x00', b'\x01\x00', b'\x0f\xff', b'\x18\x00'):
        pages, found = read(16, nonsense)
        assert pages.page == 4096 and len(found) == 99
    for kept, usable in ((0, 4096), (12, 4084), (64, 4032), (65, 4096), (255, 4096)):
        assert read(20, bytes([kept]))[0].usable == usable
    assert read(28, b'\x00\x01\x00\x02')[0].stated == 65538
    count = len(whole) // 4096
    for size, pages in ((len(whole), count), (len(whole) + 1, count + 1), (4097, 2), (4096, 1)):
        assert read(0, b'', size)[0].count == pages
    for short in (whole[:99], b'', b'x' + whole[1:]):
        path.write_bytes(short)
        with pytest.raises(Damage, match='no SQLite file'):
            pages_of(path)
    path.write_bytes(whole[:100])
    assert pages_of(path)[1] == []


def test_a_damaged_page_costs_what_is_on_it_and_is_counted(tmp_path):
    rows = [(k, b'y' * 900, k) for k in range(1, 13)]
    path = base_of(tmp_path / 'b', rows)
    whole = path.read_bytes()
    leaf = next(at for at in range(4096, len(whole), 4096) if whole[at] == 0x0D)
    cells = int.from_bytes(whole[leaf + 3 : leaf + 5], 'big')

    def read(at, value):
        path.write_bytes(whole[:at] + value + whole[at + len(value) :])
        pages, found = pages_of(path)
        return pages.damaged, len(found)

    assert read(leaf, b'\x0d') == (0, 12)
    assert read(leaf, b'\x0a') == (0, 12 - cells)  # a page of an index
    most = (4096 - 8) // 2
    assert read(leaf + 3, struct.pack('>H', most + 1)) == (1, 12 - cells)
    damaged, found = read(leaf + 3, struct.pack('>H', most))
    assert damaged >= 1 and found >= 12
    # A cell that points beyond the page, and one that points into the zeros.
    assert read(leaf + 8, b'\x0f\xff')[1] == 11
    assert read(leaf + 8, b'\xff\xff') == (1, 11)
    path.write_bytes(whole[: leaf + 7])
    assert pages_of(path)[0].damaged == 0
    path.write_bytes(whole[: leaf + 4096 - 10])
    pages, found = pages_of(path)
    assert pages.damaged == 1 and pages.count == leaf // 4096 + 1


def test_a_chain_of_pages_that_is_cut_or_leads_astray_is_damage(tmp_path):
    path = base_of(tmp_path / 'b', [(1, b'z' * 10_000, 'end')], 512)
    whole = path.read_bytes()
    pages, found = pages_of(path)
    assert len(found) == 1
    leaf = next(at for at in range(512, len(whole), 512) if whole[at] == 0x0D)
    place = int.from_bytes(whole[leaf + 8 : leaf + 10], 'big')
    # Two bytes of size and one of the number, the row's head of six, its values; the number of the
    # next page ends what is on this one.
    least = (512 - 12) * 32 // 255 - 23
    size = 6 + 10_000 + 3
    local = least + (size - least) % 508
    local = local if local <= 512 - 35 else least
    link = leaf + place + 3 + local
    first = int.from_bytes(whole[link : link + 4], 'big')
    assert 1 < first <= pages.count

    def read(at, number):
        path.write_bytes(whole[:at] + struct.pack('>I', number) + whole[at + 4 :])
        pages, found = pages_of(path)
        return pages.damaged, len(found)

    assert read(link, first) == (0, 1)
    assert read(link, 0) == read(link, pages.count + 1) == (1, 0)
    assert read((first - 1) * 512, 0) == (1, 0)
    last = len(whole) // 512
    path.write_bytes(whole[:-1])
    kept, found = pages_of(path)
    assert kept.count == last and (kept.damaged, found) in ((1, []), (0, found))
    path.write_bytes(whole[: (last - 1) * 512 + 3])
    assert pages_of(path)[1] == []
