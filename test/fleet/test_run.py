# SPDX-License-Identifier: Apache-2.0
"""Many bags as one job: resumed, compared, and one bad bag among them."""

import json
from pathlib import Path
import shutil

import numpy as np
import pytest

from ros2_ident import compiled
from ros2_ident.change.result import Between
from ros2_ident.cli.main import main
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.fleet import run as fleet
from ros2_ident.fleet.summary import pairs_of, Row
from ros2_ident.models import load_machine
from ros2_ident.report.schema import read
from ros2_ident.search.evidence import price_of

ROOT = Path(__file__).parents[2]


def row(name: str, machine: str, date: str, mass: float, effect: str = 'none') -> Row:
    return {
        'name': name,
        'machine': machine,
        'machine_file': 'm.yaml',
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


def test_bags_are_compared_with_the_earliest_and_machines_with_the_most_usual() -> None:
    rows = [
        row('a3', 'a', '2026-03-01', 100.1),
        row('a1', 'a', '2026-01-01', 100.0),
        row('b1', 'b', '2026-01-01', 100.2),
        row('c1', 'c', '2026-01-01', 120.0),
        row('d1', 'd', '2026-01-01', 100.3, 'wrong_machine_file'),
        {**row('e1', 'e', '2026-01-01', 100.0), 'machine_file': 'other.yaml'},
    ]
    rows[4]['code'] = 'CONTRADICTED'
    pairs = pairs_of(rows)
    assert [(x['kind'], x['machine'], x['after'], x['before']) for x in pairs] == [
        ('drift', 'a', 'a3', 'a1'), ('machine', 'a', 'a3', 'b1'), ('machine', 'c', 'c1', 'b1'),
    ]  # fmt: skip
    # a fourth one changes nothing for these, a fifth does
    assert {x['among'] for x in pairs} == {4}
    rows += [row('f1', 'f', '', 100.2), row('g1', 'g', '', 100.2)]
    assert {x['among'] for x in pairs_of(rows[:-1])} == {4}
    assert {x['among'] for x in pairs_of(rows)} == {8}
    assert pairs_of([]) == pairs_of(rows[:1]) == []


def test_what_differs_is_what_ident_diff_finds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    axis = str(ROOT / 'config/emps.yaml')
    for seed, (name, mass) in enumerate({'a_1': 75, 'a_2': 77, 'b_1': 75}.items()):
        words = ['simulate', str(tmp_path / name), '--machine', axis, '--motion', 'reversals']
        words += ['--seconds', '6', '--seed', str(seed), '--set', f'moving_mass={mass}']
        assert main(words) == 0
    listed, out = tmp_path / 'list.yaml', tmp_path / 'out'
    bags = '{bag: a_1, machine: a}, {bag: a_2, machine: a, date: b}, {bag: b_1, machine: b}'
    listed.write_text(f'{{bags: [{bags}], machine_file: {axis}}}')
    words = ['fleet', str(listed), '--out', str(out), '--no-diagnosis', '--quiet']
    assert main(words) == 0
    said = capsys.readouterr().out
    assert 'a, a_2 after a_1: Changed: emps_axis.moving_mass by' in said, said
    several = json.loads((out / 'fleet.json').read_text())['comparisons']
    drift, other = (read(Between, row) for row in several)
    assert (drift.kind, other.kind) == ('drift', 'machine')
    for found in (drift, other):
        more = 2.0 if found.after == 'a_2' else -2.0
        (size,) = found.found.changes[0].sizes
        assert size.low < more < size.high and found.found.price >= price_of(2)
    text = (out / 'report.html').read_text()
    assert 'a has drifted; ' in text and 'Inspect a, for its emps_axis.moving_mass' in text
    begun: list[str] = []
    how = {'diagnosed': False, 'seed': 1}
    again = fleet.run_fleet(
        fleet.read_fleet(listed), out, how, on_start=lambda x: begun.append(x['name'])
    )
    assert begun == [] and [x['name'] for x in again[3:]] == [
        f'{x.after}~{x.before}' for x in (drift, other)
    ]


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
