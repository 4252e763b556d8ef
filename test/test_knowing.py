# SPDX-License-Identifier: Apache-2.0
"""Runs that take what an earlier result found as known."""

from dataclasses import replace
import json
from pathlib import Path

import numpy as np
import pytest

from ros2_ident import jobs
from ros2_ident.cli.main import main
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.identify.result import Outcome
from ros2_ident.models import load_machine
from ros2_ident.report.estimate import read_estimate
from ros2_ident.report.files import load_result, write_result

ROOT = Path(__file__).parents[1]
AXIS = ROOT / 'config/emps.yaml'
WORN = ['--effect', 'stribeck@emps_axis:torque=4,velocity=0.004']


@pytest.fixture(scope='module')
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return two logs of an axis with different motions, and two of one with Stribeck friction."""
    folder = tmp_path_factory.mktemp('logs')
    for seed, (name, motion, more) in enumerate([
        ('one', 'reversals', []), ('two', 'mixed', []), ('worn', 'reversals', WORN),
        ('worn_too', 'reversals', WORN),
    ]):  # fmt: skip
        words = ['simulate', f'{folder}/{name}', '--machine', str(AXIS), '--motion', motion]
        assert main([*words, '--seconds', '6', '--seed', str(seed), *more]) == 0
    assert main(_words(folder, 'identify', 'one', 'first')) == 0
    assert main(_words(folder, 'diagnose', 'worn', 'diagnosed')) == 0
    return folder


def _words(folder: Path, command: str, log: str, out: str, *more: str) -> list[str]:
    logs = [f'{folder}/{name}' for name in log.split()]
    words = [command, *logs, '--machine', str(AXIS), '--out', f'{folder}/{out}']
    return [*words, '--quiet', '--no-report', '--no-overlay', *more]


@pytest.mark.parametrize('method', ['genetic', 'algebraic'])
def test_one_log_after_the_other_is_both_together(logs, method):
    own = '--method', method
    assert main(_words(logs, 'identify', 'one', f'{method}_1', *own)) == 0
    more = *own, '--from', f'{logs}/{method}_1'
    assert main(_words(logs, 'identify', 'two', f'{method}_12', *more)) == 0
    assert main(_words(logs, 'identify', 'two', f'{method}_2', *own)) == 0
    assert main(_words(logs, 'identify', 'one two', f'{method}_both', *own)) == 0
    alone, after, both = (
        load_result(logs / f'{method}_{x}').parameters for x in ('2', '12', 'both')
    )
    half = np.array([0.5 * (b.high - b.low) for b in both])
    far, near = (np.array([x.value - b.value for x, b in zip(own, both, strict=True)]) / half
                 for own in (alone, after))  # fmt: skip
    # Of an algebraic solution the noise has colour, which a fit of both does not weigh by.
    assert np.abs(near).max() < (0.1 if method == 'genetic' else 0.5 * np.abs(far).max())
    for one, a, b in zip(alone, after, both, strict=True):
        assert a.noise_high - a.noise_low < 0.95 * (one.noise_high - one.noise_low), a.name
        assert a.noise_high - a.noise_low < 1.1 * (b.noise_high - b.noise_low), a.name
        assert a.high - a.low < 1.3 * (b.high - b.low), a.name
    written = json.loads((logs / f'{method}_12/result.json').read_text(encoding='utf-8'))
    assert written['settings']['from'] == f'{logs}/{method}_1'
    assert main(['report', f'{logs}/{method}_12']) == 0
    page = (logs / f'{method}_12/report.html').read_text(encoding='utf-8')
    assert f'--from {logs}/{method}_1 --out' in page.replace('\xa0', ' ')


def test_effects_of_a_diagnosis_are_in_the_model(logs, capsys):
    known = '--from', f'{logs}/diagnosed'
    assert main(_words(logs, 'identify', 'worn_too', 'worn_2', *known)) == 0
    found = {p.name: p for p in load_result(logs / 'worn_2').parameters}
    before = read_estimate(logs / 'diagnosed')
    alike = np.array(before.prior.correlation)
    assert np.diag(alike) == pytest.approx(1.0) and np.isfinite(alike).all()
    assert 0.1 < np.abs(alike[~np.eye(len(alike), dtype=bool)]).max() < 1.0
    torque = found['emps_axis.stribeck.torque']
    assert torque.low < 4.0 < torque.high
    assert torque.high - torque.low < 3.9 * before.prior.deviations[torque.name]
    assert main(_words(logs, 'diagnose', 'worn_too', 'again', *known)) == 0
    capsys.readouterr()
    words = ['diff', f'{logs}/worn_too', '--after', f'{logs}/two', '--machine', str(AXIS)]
    assert main([*words, *known, '--quiet']) == 0
    assert 'Changed: emps_axis.stribeck.torque by -4.' in capsys.readouterr().out.replace(
        '-3.9', '-4.'
    )
    told = json.loads((logs / 'again/diagnosis.json').read_text(encoding='utf-8'))
    assert told['verdict']['cause'] == 'none', told['verdict']
    assert 'emps_axis.stribeck.torque' in told['nominal']


def test_what_is_held_or_not_compared_needs_no_interval(logs):
    request = jobs.knowing(
        jobs.Request(load_machine(AXIS), (f'{logs}/two',), fixed={'moving_mass': 75.0}),
        logs / 'first',
    )
    problem = request.problem(jobs.read(request).fit)
    assert problem.fixed == {'emps_axis.moving_mass': 75.0}
    assert problem.box.known.rows.shape == (3, 3)
    np.testing.assert_allclose(problem.suggested, read_values(logs / 'first', problem.names))


def read_values(path: Path, names: tuple[str, ...]) -> list[float]:
    return [read_estimate(path).values[name] for name in names]


def test_what_cannot_be_known_gets_a_sentence(logs, tmp_path):
    request = jobs.Request(load_machine(AXIS), (f'{logs}/one',))
    with pytest.raises(IdentError, match='was found from this log, which would count twice'):
        jobs.read(jobs.knowing(request, logs / 'first'))
    result = load_result(logs / 'first')
    for outcome, said in (
        (Outcome.CONTRADICTED, r'cannot be taken as known \(contradicted\); give another result'),
        (Outcome.BUDGET_SPENT, r'cannot be taken as known \(budget spent\)'),
    ):
        write_result(tmp_path, replace(result, outcome=outcome))
        with pytest.raises(IdentError, match=said) as caught:
            jobs.knowing(request, tmp_path)
        assert caught.value.code is ErrorCode.INVALID_GOAL
    write_result(tmp_path, replace(result, rival=tuple(result.theta)))
    with pytest.raises(IdentError, match='several minima fit almost alike'):
        jobs.knowing(request, tmp_path)
