# SPDX-License-Identifier: Apache-2.0
"""Many bags as one job: resumed, compared, and one bad bag among them."""

import json
from pathlib import Path
import shutil

import numpy as np
import pytest

from ros2_ident import compiled
from ros2_ident.cli.main import main
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.fleet import run as fleet
from ros2_ident.fleet.summary import Row, summarise
from ros2_ident.models import load_machine

ROOT = Path(__file__).parents[2]


def row(name: str, machine: str, date: str, mass: float, effect: str = 'none') -> Row:
    return {
        'name': name,
        'machine': machine,
        'date': date,
        'state': 'done',
        'code': 'OK',
        'message': '',
        'effect': effect,
        'where': ['d'] if effect != 'none' else [],
        'parameters': {'mass': {'value': mass, 'low': mass - 1, 'high': mass + 1, 'unit': 'kg'}},
    }


@pytest.fixture
def listed(tmp_path: Path) -> Path:
    shutil.copytree(ROOT / 'bags/axis_reversals', tmp_path / 'good')
    (tmp_path / 'bad.mcap').write_bytes(b'no bag at all')
    shutil.copy(ROOT / 'config/emps.yaml', tmp_path / 'machine.yaml')
    path = tmp_path / 'fleet.yaml'
    path.write_text(
        'machine_file: machine.yaml\n'
        'bags:\n'
        '- {bag: good, machine: press_1, date: 2026-01-05, labels: {hall: north}}\n'
        '- {bag: bad.mcap, machine: press_2}\n'
    )
    return path


def test_bad_bag_costs_its_row_only_and_the_rest_is_not_done_twice(
    listed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / 'out'
    words = ['fleet', str(listed), '--out', str(out), '--no-diagnosis', '--quiet']
    words += ['--fix', 'viscous_friction=203.5']
    assert main(words) == 1
    content = json.loads((out / 'fleet.json').read_text())
    good, bad = content['rows']
    assert (good['state'], bad['state'], bad['code']) == ('done', 'failed', 'DAMAGED_BAG')
    assert 'bad.mcap' in bad['message']
    assert good['labels'] == {'hall': 'north'}
    assert Path(good['bag']).is_absolute() and Path(good['machine_file']).is_absolute()
    assert 'emps_axis.viscous_friction' not in good['parameters']
    mass = good['parameters']['emps_axis.moving_mass']
    assert mass['low'] < 95.1 < mass['high']
    assert 'DAMAGED_BAG' in capsys.readouterr().out

    begun: list[str] = []
    entries = fleet.read_fleet(listed)
    how = {'diagnosed': False, 'fixed': {'viscous_friction': 203.5}}
    again = fleet.run_fleet(entries, out, how, on_start=lambda x: begun.append(x['name']))
    assert begun == ['bad.mcap']
    assert again[0] == good


def test_row_is_done_anew_where_the_bag_has_changed(listed: Path) -> None:
    entry = fleet.read_fleet(listed)[0]
    before = fleet.key_of(entry, {})
    assert fleet.key_of(entry, {'seed': 1}) == before
    for other in ({'seed': 2}, {'diagnosed': False}):
        assert fleet.key_of(entry, other) != before
    with Path(entry['machine_file']).open('a') as file:
        file.write('# another machine file\n')
    assert fleet.key_of(entry, {}) != before


def test_one_byte_in_what_a_row_depends_on_changes_its_key(tmp_path: Path) -> None:
    without = shutil.ignore_patterns('__pycache__')
    package = shutil.copytree(ROOT / 'ros2_ident', tmp_path / 'ros2_ident', ignore=without)
    before = compiled.package_digest(package)
    # what the key holds is this digest, and the copy's is the package's
    assert before == compiled.result_digest()
    counts = ('gap/verdict.py', 'gap/noise_floor.py', 'identify/run.py', 'search/refine.py',
              'recording/align.py', 'models/tripod/kernel.py', 'fleet/run.py',
              'recording/maps/unitree_go-LowState.yaml')  # fmt: skip
    for module in (*counts, 'report/page/charts.py', 'cli/progress.py', 'ros/node.py'):
        content = (package / module).read_bytes()
        (package / module).write_bytes(content[:-2] + b'#' + content[-1:])
        assert (compiled.package_digest(package) != before) is (module in counts), module
        (package / module).write_bytes(content)


def test_drift_is_told_and_chance_is_not() -> None:
    rows = [
        row('a1', 'a', '2026-01-01', 100.0),
        row('a2', 'a', '2026-02-01', 100.5),
        row('a3', 'a', '2026-03-01', 110.0, 'backlash'),
        row('b1', 'b', '2026-01-01', 100.2),
    ]
    summary = summarise(rows)
    assert [(x['bag'], x['against']) for x in summary['drifts']] == [('a3', 'a1')]
    assert summary['drifts'][0]['change'] == pytest.approx(0.1)
    assert {x['machine']: x['against'] for x in summary['machines']} == {'a': 'b'}
    assert summary['effects'] == {'backlash': ['a3: d']}


@pytest.mark.parametrize(
    ('values', 'told'),
    [
        # one machine that is off does not make the others differ
        ([(100.0, 1), (100.01, 1), (100.02, 1), (120.0, 1)], 'd'),
        # one that is hardly known does not hide how the others differ, one that is not known does
        ([(100.0, 1), (100.1, 1), (104.0, 1), (60.0, 60)], 'c'),
        ([(100.0, 1), (100.1, 1), (104.0, 1), (60.0, None)], ''),
        # less than a warm day makes
        ([(100.0, 1), (100.0, 1), (100.0, 1), (101.9, 1)], ''),
        ([(100.0, 1), (100.0, 1), (100.0, 1), (102.1, 1)], 'd'),
    ],
)
def test_machines_are_compared_with_the_median_of_all(values, told: str) -> None:
    rows = [row(name, name, '', mass) for name, (mass, _) in zip('abcd', values, strict=True)]
    for found, (mass, half) in zip(rows, values, strict=True):
        low, high = (None, None) if half is None else (mass - half, mass + half)
        found['parameters']['mass'].update(low=low, high=high)
    machines = summarise(rows)['machines']
    assert {(x['machine'], x['against']) for x in machines} == {
        (name, 'median of the machines') for name in told
    }


def test_of_equal_machines_known_unequally_well_hardly_any_differs() -> None:
    random = np.random.default_rng(3)
    told = 0
    for _ in range(200):
        rows = []
        for name, half in zip('abcd', 10.0 ** random.uniform(-1, 1, 4), strict=True):
            rows.append(row(name, name, '', 100.0 + float(random.normal()) * half / 1.96))
            value = rows[-1]['parameters']['mass']
            value.update(low=value['value'] - half, high=value['value'] + half)
        told += bool(summarise(rows)['machines'])
    assert told <= 20


def test_rows_are_compared_with_the_same_effects_in_the_model_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = {'a1': row('a1', 'a', '', 100.0), 'b1': row('b1', 'b', '', 150.0, 'backlash')}
    fitted = []

    def run(entry, how, known=None):
        if known is None:
            return {**rows[entry['name']], 'beside': []}
        fitted.append((entry['name'], known['common']))
        found = row(entry['name'], entry['machine'], '', 100.0)['parameters']
        return {**known, 'parameters': found, 'beside': known['common']}

    monkeypatch.setattr('ros2_ident.fleet.run.run_entry', run)
    listed = tmp_path / 'list.yaml'
    listed.write_text('{bags: [{bag: a1, machine: a}, {bag: b1, machine: b}], machine_file: m}')
    assert main(['fleet', str(listed), '--out', str(tmp_path / 'out'), '--quiet']) == 0
    assert capsys.readouterr().out.count('\nb1 ') == 1
    summary = json.loads((tmp_path / 'out/fleet.json').read_text())
    assert fitted == [('a1', [['backlash', 'd']]), ('b1', [['backlash', 'd']])]
    assert summary['machines'] == [] and summary['smallest']['mass']['change'] > 2.0
    # one that could not be fitted so is not compared
    rows['b1']['beside'] = [['backlash', 'd']]
    assert summarise([*rows.values()])['smallest'] == {}


def test_where_nothing_is_missing_the_values_of_the_identification_stay(listed: Path) -> None:
    entry = fleet.read_fleet(listed)[0]
    alone = fleet.run_entry(entry, {'diagnosed': False})
    diagnosed = fleet.run_entry(entry, {})
    assert diagnosed['effect'] == 'none'
    assert diagnosed['parameters'] == alone['parameters']


def test_unit_of_the_effort_and_effects_left_out_are_those_of_the_command(
    listed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = []
    monkeypatch.setattr(fleet, 'run_fleet', lambda entries, out, how, **_: told.append(how) or [])
    words = ['fleet', str(listed), '--out', str(tmp_path / 'out')]
    unit = ['--effort-unit', 'A', '--torque-constant', '0.5']
    assert main([*words, *unit, '--without', 'backlash']) == main(words) == 1
    good = fleet.read_fleet(listed)[0]
    given, plain = (fleet._request(good, how) for how in told)
    np.testing.assert_array_equal(given.machine.effort_scale, 0.5)
    assert (given.machine.effort_unit, given.without) == ('A', ('backlash',))
    assert plain.machine == load_machine(good['machine_file']) and plain.without == ()
    keys = {fleet.key_of(good, told[1] | {'effort': how['effort']}) for how in told}
    assert len(keys) == 2


def test_a_worker_with_other_sources_is_refused(listed: Path) -> None:
    entry = fleet.read_fleet(listed)[0]
    found = fleet.run_entry(entry, {}, here='other')
    assert (found['state'], found['code']) == ('failed', 'INVALID_GOAL')
    assert 'same version' in found['message']


def test_directory_needs_a_machine_file(listed: Path) -> None:
    with pytest.raises(IdentError, match='--machine') as caught:
        fleet.read_fleet(listed.parent)
    assert caught.value.code is ErrorCode.INVALID_GOAL
    names = [x['name'] for x in fleet.read_fleet(listed.parent, 'machine.yaml')]
    assert names == ['bad.mcap', 'good']


@pytest.mark.parametrize(
    'text', ['bags: []', 'bags: [{machine: x}]', 'bags: [{bag: x, day: 1}]', '[' * 1000]
)
def test_list_that_is_wrong_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / 'fleet.yaml'
    path.write_text(text)
    with pytest.raises(IdentError, match='fleet.yaml'):
        fleet.read_fleet(path, 'machine.yaml')
