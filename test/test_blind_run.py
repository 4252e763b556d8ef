# SPDX-License-Identifier: Apache-2.0
from pathlib import Path
import subprocess
import sys

import numpy as np
import pytest

from ros2_ident.checks.blind import seal
from ros2_ident.checks.blind.draw import Shares
from ros2_ident.checks.blind.label import Label, MotionOrder, to_mapping
from ros2_ident.checks.blind.run import ask_all, BlindCheck, Stopped
from ros2_ident.checks.blind.score import score, verdict_of
from ros2_ident.checks.blind.store import read_json, Store
from ros2_ident.checks.blind.truth import make_row
from ros2_ident.models import load_machine
from ros2_ident.reference.bag_making import draw_parameters
from ros2_ident.reference.effects import Effect

ROOT = Path(__file__).parent.parent
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


def a_case(store: Store) -> Label:
    machine = load_machine(TRIPOD)
    motions = MotionOrder('multi_point', 1.5, 3), MotionOrder('mixed', 1.5, 4)
    effect = Effect('torque_ripple', ('drive_2',), {'torque': 0.05, 'order': 2.0, 'phase': 1.0})
    parameters = draw_parameters(machine, np.random.default_rng(1))
    label = Label(1, 'single', parameters, motions, (effect,), (), (2.0,), {}, 5)
    store.case(1).mkdir(parents=True)
    return label


def test_row_of_a_case_without_diagnosis_counts_as_a_miss(tmp_path) -> None:
    store = Store(tmp_path)
    label = a_case(store)
    plain = to_mapping(label)
    row = make_row(seal.unseal(seal.close(plain, 3), 3), store.case(1), TRIPOD)
    assert verdict_of(row) == 'error'
    assert row['rho'] > 1.0
    assert row['rho_all'] == row['rho']
    by_name = {s.name: s for s in score([row])}
    assert by_name['diagnoses that failed'].value == 1.0
    assert by_name['exact effect first, rho from 1.5'].value == 0.0


def test_rows_come_back_in_order(tmp_path) -> None:
    store = Store(tmp_path)
    store.write_rows([{'case': 2}, {'case': 1}])
    assert [r['case'] for r in store.rows()] == [1, 2]
    assert Store(tmp_path / 'none').rows() == []


def test_scoring_opens_only_what_is_diagnosed(tmp_path) -> None:
    check = BlindCheck(tmp_path / 'run', 1)
    check.begin(TRIPOD, 1, 3, Shares(), 'ident blind')
    check.store.seal(1, seal.close({'case': 1}, 3))
    assert check.score() == []


def test_practice_script_skips_where_there_is_nothing(tmp_path) -> None:
    done = subprocess.run(
        [sys.executable, str(ROOT / 'benchmarks' / 'practice.py'), str(tmp_path)],
        env={'PYTHONPATH': str(ROOT), 'PATH': '/usr/bin:/bin'},
        capture_output=True,
        text=True,
        check=True,
    )
    assert 'nothing to do' in done.stdout
