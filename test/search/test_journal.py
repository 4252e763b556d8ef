# SPDX-License-Identifier: Apache-2.0
"""A journal gives back what was put, and nothing that is not whole."""

import errno
import os

import numpy as np
import pytest

from ros2_ident.errors import IdentError
from ros2_ident.search import journal as module
from ros2_ident.search.journal import digest_of, Journal

KEY = 'bag and machine'


def filled(path, count=5):
    """Return what was put into a journal, one array and one number a record."""
    values = [np.arange(k, dtype=np.float64) / 3.0 for k in range(count)]
    with Journal(path, KEY) as journal:
        for k, value in enumerate(values):
            journal.put({'value': value, 'cost': 0.1 * k, 'name': f'step {k}'}, 'step', k)
    return values


def whole(path, values):
    """Return how many of the steps are there; each has to be as it was."""
    with Journal(path, KEY) as journal:
        found = [journal.get({}, 'step', k) for k in range(len(values))]
    for k, kept in enumerate(found):
        if kept is not None:
            assert kept['value'].tobytes() == values[k].tobytes()
            assert (kept['cost'], kept['name']) == (0.1 * k, f'step {k}')
    return sum(kept is not None for kept in found)


def test_a_journal_gives_back_every_bit(tmp_path):
    path = tmp_path / 'a.checkpoint'
    values = filled(path)
    assert whole(path, values) == len(values)
    odd = {
        'flags': np.array([True, False]),
        'grid': np.arange(6.0).reshape(2, 3).T,
        'none': np.empty((0, 4)),
        'best': np.inf,
    }
    with Journal(path, KEY) as journal:
        journal.put(odd, 'odd')
    with Journal(path, KEY) as journal:
        kept = journal.get({}, 'odd')
        assert whole_of(kept) == whole_of(odd)
        assert journal.get({}, 'step', 99) is None


def whole_of(values):
    return {
        k: (v.dtype, v.shape, v.tobytes()) if isinstance(v, np.ndarray) else v
        for k, v in values.items()
    }


def test_a_journal_cut_anywhere_keeps_what_is_whole_and_grows_on(tmp_path):
    path = tmp_path / 'a.checkpoint'
    values = filled(path)
    data = path.read_bytes()
    counts = set()
    for size in range(0, len(data), 7):
        path.write_bytes(data[:size])
        counts.add(whole(path, values))
        filled(path)
        assert whole(path, values) == len(values)
    assert counts == set(range(len(values)))


def test_no_changed_byte_passes(tmp_path):
    path = tmp_path / 'a.checkpoint'
    values = filled(path)
    data = bytearray(path.read_bytes())
    for at in range(len(module.MAGIC) + 16, len(data)):
        changed = data.copy()
        changed[at] ^= 1 << at % 8
        path.write_bytes(changed)
        assert whole(path, values) < len(values)


@pytest.mark.parametrize(
    ('content', 'said'),
    [
        (b'PK a zip file that lies here by chance', 'is no checkpoint; delete it'),
        (b'ros2_ident journal 9\n' + bytes(16), 'of another version'),
        (module.MAGIC + digest_of('another bag'), 'belongs to a run of other data'),
    ],
)
def test_what_is_no_journal_of_this_run_is_refused_and_kept(tmp_path, content, said):
    path = tmp_path / 'a.checkpoint'
    path.write_bytes(content)
    for _ in range(2):  # nor is it locked after that
        with pytest.raises(IdentError, match=said):
            Journal(path, KEY)
    assert path.read_bytes() == content


def test_two_runs_do_not_write_one_journal(tmp_path):
    path = tmp_path / 'a.checkpoint'
    with Journal(path, KEY), pytest.raises(IdentError, match='another process writes it'):
        Journal(path, KEY)
    with Journal(path, KEY):
        pass


def test_a_full_disk_ends_the_journal_and_not_the_run(tmp_path, monkeypatch):
    path = tmp_path / 'a.checkpoint'
    values = filled(path, 3)
    real = os.pwrite

    def full(number, data, at):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with Journal(path, KEY) as journal:
        monkeypatch.setattr(os, 'pwrite', full)
        journal.put({'value': np.ones(2)}, 'more')
        assert 'No space left' in journal.failed
        monkeypatch.setattr(os, 'pwrite', real)
        assert journal.get({}, 'step', 2) is not None
    assert whole(path, values) == 3
