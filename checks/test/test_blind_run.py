# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from pathlib import Path
import subprocess
import sys

from blind_rows import a_label
import pytest

from checks.blind import seal
from checks.blind.keep import verify
from checks.blind.label import to_mapping
from checks.blind.run import ask_all, BlindCheck, order_of, Stopped
from checks.blind.score import score, verdict_of
from checks.blind.store import read_json, stamp, Store
from checks.blind.truth import intervals, make_row

ROOT = Path(__file__).parents[2]
TRIPOD = ROOT / 'config' / 'tripod.yaml'


def orders(tmp_path: Path, numbers: tuple[int, ...]) -> dict[int, dict[str, str]]:
    there = {'machine': str(TRIPOD)}
    return {
        n: there | {k: str(tmp_path / f'case_{n}' / k) for k in ('fit', 'check', 'out')}
        for n in numbers
    }


def test_a_diagnosis_that_fails_is_kept_with_its_reason(tmp_path) -> None:
    store = Store(tmp_path)
    for number in (1, 2):
        store.case(number).mkdir(parents=True)
    assert sorted(ask_all(store, orders(tmp_path, (1, 2)), 1)) == [1, 2]
    assert 'exit code 2' in read_json(store.case(1) / 'run.json')['error']


def test_stopping_ends_the_processes_and_answers_nothing(tmp_path) -> None:
    store = Store(tmp_path)
    store.case(1).mkdir(parents=True)
    with pytest.raises(Stopped):
        list(ask_all(store, orders(tmp_path, (1,)), 1, lambda: True))
    assert store.answered(1) is None


def test_row_of_a_case_without_diagnosis_counts_as_a_miss(tmp_path) -> None:
    store = Store(tmp_path)
    plain = to_mapping(replace(a_label(), fault=None, rho_all=2.1))
    row = make_row(seal.unseal(seal.close(plain, 3), 3), store.case(1), store.clean(1))
    assert verdict_of(row) == 'error'
    assert row['rho'] == row['rho_all'] == 2.1
    by_name = {s.name: s for s in score([row])}
    assert by_name['diagnoses that failed'].value == 1.0
    assert by_name['exact effect first, rho from 1.5'].value == 0.0


def test_intervals_stand_beside_the_parameters_they_are_of() -> None:
    parameters = {'tool_mass': 1.3, 'drive_2.coulomb_torque': 0.05, 'measurement_delay': 0.02}
    label = replace(a_label(), parameters=parameters)
    one = {'value': 1.2, 'low': 1.1, 'high': 1.25, 'unit': 'kg'}
    names = ('drive_1.tool_mass', 'drive_2.coulomb_torque', 'measurement_delay', 'x.torque')
    found = intervals(label, {'parameters': dict.fromkeys(names, one)})
    assert [(p['name'], p['true']) for p in found] == [
        ('drive_1.tool_mass', 1.3),
        ('drive_2.coulomb_torque', 0.05),
    ]


def test_an_order_names_the_cases_own_machine_file(tmp_path) -> None:
    order = order_of(Store(tmp_path), 7)
    assert order['machine'] == str(tmp_path / 'cases' / 'case_0007' / 'machine.yaml')
    assert set(order) == {'fit', 'check', 'machine', 'out'}


def test_rows_come_back_in_order(tmp_path) -> None:
    store = Store(tmp_path)
    store.write_rows([{'case': 2}, {'case': 1}])
    assert [r['case'] for r in store.rows()] == [1, 2]
    assert Store(tmp_path / 'none').rows() == []


def test_scoring_opens_only_what_is_diagnosed(tmp_path) -> None:
    check = BlindCheck(tmp_path / 'run', 1)
    check.begin(TRIPOD, 1, 3, {'none': 1.0}, 'python -m checks.blind')
    check.store.seal(1, seal.close({'case': 1}, 3))
    assert check.score() == []


def test_practice_script_skips_where_there_is_nothing(tmp_path) -> None:
    done = subprocess.run(
        [sys.executable, str(ROOT / 'checks' / 'benchmarks' / 'practice.py'), str(tmp_path)],
        env={'PYTHONPATH': str(ROOT), 'PATH': '/usr/bin:/bin'},
        capture_output=True,
        text=True,
        check=True,
    )
    assert 'nothing to do' in done.stdout


def test_what_the_repository_keeps_is_what_was_sealed() -> None:
    kept = ROOT / 'docs' / 'blind'
    assert '--verify' in (kept / 'README.md').read_text(encoding='utf-8')
    for seals in kept.rglob('seals.json'):
        assert verify(seals.parent)


def test_a_run_notes_every_program_that_diagnosed(tmp_path) -> None:
    store = Store(tmp_path / 'run')
    store.begin({'command': '', 'cases': 1, 'seed': 1, 'shares': {}}, TRIPOD)
    now = stamp()
    assert len(now['sources']) == 16
    for program in (now, now, now | {'commit': 'another'}):
        store.diagnosed_by(program)
    assert [p['commit'] for p in store.about()['diagnosed']] == [now['commit'], 'another']
