# SPDX-License-Identifier: Apache-2.0
"""Logs and results as CSV tables, by `ident export --to csv`."""

import csv
from pathlib import Path

import numpy as np
import pytest
from reader_cases import equal

from ros2_ident.cli.main import main
from ros2_ident.recording import read_bag, Recording, Stream
from ros2_ident.recording.table import write_table
from ros2_ident.report.files import load_result
from ros2_ident.report.signals import load_signals

ROOT = Path(__file__).parents[2]


def rows_of(path: Path) -> list[list[str]]:
    with path.open(encoding='utf-8', newline='') as file:
        return list(csv.reader(file))


@pytest.mark.parametrize('bag', ['axis_reversals', 'tripod_mixed'])
def test_a_log_comes_back_to_the_bit(bag, tmp_path, capsys) -> None:
    assert main(['export', str(ROOT / 'bags' / bag), '--to', 'csv', '--out', str(tmp_path)]) == 0
    table = tmp_path / f'{bag}.csv'
    assert str(table) in capsys.readouterr().out
    assert equal(read_bag(ROOT / 'bags' / bag), read_bag(table))


def test_effort_in_joint_states_and_a_second_recording_are_kept(tmp_path) -> None:
    def recording(start: int) -> Recording:
        stamp = start + 10**6 * np.arange(50)
        values = np.sin(stamp * 1e-7)[:, None]
        hole = values.copy()
        hole[3] = np.nan
        return Recording(state=Stream(('joint',), stamp, values, None, hole), source='log')

    # the second one steps back in time
    table, where = write_table(tmp_path / 'log.csv', [recording(10**18), recording(10**17)])
    assert where == tmp_path / 'log.columns.yaml'
    back = read_bag(table)
    assert [r.state.stamp[0] for r in back] == [10**18, 10**17]
    assert [r.effort.stamp.size for r in back] == [49, 49]
    assert np.array_equal(back[1].state.position, recording(10**17).state.position)


def test_results_are_tables_with_names_and_units(tmp_path, capsys) -> None:
    out = tmp_path / 'results'
    words = ['identify', str(ROOT / 'bags/axis_reversals'), '--quiet', '--no-report']
    words += ['--machine', str(ROOT / 'config/emps.yaml'), '--out', str(out), '--no-overlay']
    assert main([*words, '--population', '64', '--generations', '4']) == 0
    assert main(['export', str(out), '--to', 'csv', '--out', str(tmp_path / 'tables')]) == 0
    assert 'parameters.csv' in capsys.readouterr().out
    names, *rows = rows_of(tmp_path / 'tables/parameters.csv')
    assert names[:5] == ['parameter', 'value', 'low', 'high', 'unit']
    found = load_result(out)
    assert [(row[0], float(row[1]), row[4]) for row in rows] == [
        (p.name, p.value, p.unit) for p in found.parameters
    ]
    names, *rows = rows_of(tmp_path / 'tables/signals.csv')
    assert names == [
        'recording',
        'time [s]',
        'emps_axis measured [N]',
        'emps_axis simulated, middle of the bounds [N]',
        'emps_axis simulated, identified [N]',
        'emps_axis following error [m]',
        'format=ros2_ident.table',
    ]
    (curves,) = load_signals(out / 'signals.npz').recordings
    assert len(rows) == curves.time.size
    last = [float(x) for x in rows[-1][1:5]]
    kept = [curves.time[-1], curves.measured[0, -1], *curves.simulated[:, 0, -1]]
    assert last == pytest.approx(kept, rel=1e-7)
