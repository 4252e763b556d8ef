# SPDX-License-Identifier: Apache-2.0
"""Machine files: a new one works as it is, and what is wrong with one is said with its line."""

import os
from pathlib import Path
import re

from identify_cases import AXIS_FILE, ROOT
import numpy as np
import pytest
import yaml

from ros2_ident.cli.main import main
from ros2_ident.errors import IdentError
from ros2_ident.models import EffectAt, load_machine, machine_from_mapping, make_model
from ros2_ident.models.new_file import machine_template
from ros2_ident.models.registry import KINDS, read_machine_file
from ros2_ident.recording import Dataset

BAGS = {'tripod': ROOT / 'bags' / 'tripod_mixed', 'emps': ROOT / 'bags' / 'axis_reversals'}

MJCF = """<mujoco><worldbody><body><joint name="joint_1"/><geom size="1"/></body></worldbody>
<actuator><position joint="joint_1"/></actuator></mujoco>"""


@pytest.mark.parametrize('kind', KINDS)
def test_a_new_machine_file_loads_without_a_remark(kind, tmp_path, capsys):
    path = tmp_path / 'new.yaml'
    for key in KINDS[kind].keys:
        if key.file:
            (tmp_path / str(key.example)).write_text(MJCF)
    assert main(['new-machine', '--kind', kind, '--out', str(path)]) == 0
    assert f'written: {path}' in capsys.readouterr().out
    file = read_machine_file(path)
    assert file.machine is not None
    assert file.machine.kind == kind
    assert file.remarks == ()
    assert main(['check', '--machine', str(path)]) == 0
    assert 'every key is known and plausible' in capsys.readouterr().out


@pytest.mark.parametrize('kind', KINDS)
def test_what_stands_behind_a_comment_can_be_taken_in(kind, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for key in KINDS[kind].keys:
        if key.file:
            Path(str(key.example)).write_text('<mujoco/>\n')
    template = machine_template(KINDS[kind])
    text = re.sub(r'^( *)# (\w+: [^#]*#)', r'\1\2', template, flags=re.MULTILINE)
    machine = machine_from_mapping(yaml.safe_load(text))
    known = {path[1] for path in KINDS[kind].by_path if path[0] == 'parameters'}
    assert set(machine.bounds) == known
    held = [machine.text(key.name) for key in KINDS[kind].keys if key.file]
    assert set(held) <= {'<mujoco/>\n'}


def test_drives_are_named(tmp_path, capsys):
    assert main(['new-machine', '--kind', 'tripod', '--drives', 'a,b,c']) == 0
    machine = machine_from_mapping(yaml.safe_load(capsys.readouterr().out))
    assert machine.drives == ('a', 'b', 'c')
    assert main(['new-machine', '--kind', 'tripod', '--drives', 'a,b']) == 2
    assert 'drives lists 2, and a tripod has 3' in capsys.readouterr().err


TURNING = """
machine: linear_axis
drives: [shoulder]
controller: {cycle: 2.0e-3}
parameters:
  moving_mass: [0.1, 20.0, kg m^2]
  viscous_friction: [0.0, 50.0, N m s/rad]
  coulomb_friction: [0.0, 30.0, N m]
"""


def test_a_joint_that_turns_is_said_in_radians():
    file = machine_from_mapping(yaml.safe_load(TURNING))
    time = np.arange(500) * 2e-3
    angle = (1.0 - np.cos(6.0 * time))[None]
    data = Dataset(('shoulder',), 2e-3, 0, None, None, angle, None, np.zeros_like(angle))
    effects = [EffectAt(name, 'shoulder') for name in ('asymmetric_friction', 'cable_spring')]
    model = make_model(file, data, effects=effects)
    assert (file.travel_unit, model.unit) == ('rad', 'N m')
    assert [p.unit for p in model.parameters] == [
        'kg m^2', 'N m s/rad', 'N m', 'N m', 'N m s/rad', 'N m/rad', 'rad',
    ]  # fmt: skip
    torque = model.simulated_effort(np.array([[2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]]))[0]
    ahead = time + 1e-3
    np.testing.assert_allclose(torque[50:-50], 72.0 * np.cos(6.0 * ahead)[50:-50], atol=0.02)


@pytest.mark.parametrize(
    ('old', 'new', 'said'),
    [
        ('N m s/rad', 'N s/m', "is in 'N s/m' but read as N m s/rad; convert the bounds"),
        ('30.0, N m]', '30.0, N]', "is in 'N' but read as N m; convert the bounds"),
        ('[shoulder]', '[shoulder]\neffort_unit: N', 'effort_unit N that it travels; state the'),
        ('[shoulder]', '[shoulder]\ndrive: {gear_factor: 9.0}', 'gear_factor that it travels; st'),
    ],
)
def test_a_joint_either_turns_or_travels(old, new, said):
    with pytest.raises(IdentError, match=re.escape(said)):
        machine_from_mapping(yaml.safe_load(TURNING.replace(old, new)))


def changed(path: Path, old: str, new: str, kind: str = 'linear_axis') -> tuple[str, int]:
    """Write a new machine file with one text replaced; return its path and the text's line."""
    text = machine_template(KINDS[kind])
    assert text.count(old) == 1, old
    path.write_text(text.replace(old, new))
    return str(path), text[: text.index(old)].count('\n') + 1


@pytest.mark.parametrize(
    ('old', 'new', 'code', 'said'),
    [
        (
            'machine: linear_axis ',
            'machine: polar ',
            'UNKNOWN_MODEL',
            "machine is 'polar'; write one",
        ),
        ('drives: [axis]', 'drives: axis', 'BAD_MACHINE_FILE', 'a list of different joint names'),
        ('drives: [axis]', f'drives: [0x{"f" * 5000}]', 'BAD_MACHINE_FILE', 'which is no text'),
        ('drives: [axis]', 'drives: [no]', 'BAD_MACHINE_FILE', 'False, which is no text; put it'),
        ('drives: [axis]', r'drives: ["a\nb"]', 'BAD_MACHINE_FILE', 'a line break or another'),
        ('unit: N m ', 'unit: Nm ', 'WRONG_UNITS', "effort unit is 'Nm'; write one of N m"),
        ('unit: N m ', 'unit: A ', 'WRONG_UNITS', 'effort unit A needs torque_constant'),
        ('unit: N m ', 'unit: percent ', 'WRONG_UNITS', 'percent needs rated_torque'),
        ('rail_mass: 3.5', 'rail_mass: heavy', 'BAD_MACHINE_FILE', 'write a number in kg'),
        ('rail_mass: 3.5', 'rail_mas: 3.5', 'BAD_MACHINE_FILE', 'write rail_mass, or remove the'),
        ('rail_mass: 3.5', 'rod_length: 3.5', 'BAD_MACHINE_FILE', "no key 'drive.rod_length'"),
        ('rail_mass: 3.5', 'rail_mass: 0', 'BAD_MACHINE_FILE', 'nothing has a mass: give drive.'),
        ('cycle: 0.001', 'cycle: -1', 'BAD_MACHINE_FILE', 'write a number above 0 in s'),
        ('torque_limit: 6.0', 'torque_limit: 0', 'BAD_MACHINE_FILE', 'is 0, by which nothing'),
        ('gear_factor: 78.54', 'gear_factor: 0', 'BAD_MACHINE_FILE', 'write a number above 0 in'),
        ('rail_mass: 3.5', 'gravity: 0', 'BAD_MACHINE_FILE', 'it belongs under geometry'),
        ('rail_mass: 3.5', 'gear_factor: 1', 'BAD_MACHINE_FILE', 'stands there twice'),
        ('  law: cascade_pi', '  law: pid', 'BAD_MACHINE_FILE', "law is 'pid'; write one of casc"),
        ('2.0, "1"', 'x, "1"', 'BAD_MACHINE_FILE', 'write [min, max, unit]'),
        ('2.0, "1"', '-1, "1"', 'BAD_MACHINE_FILE', 'min has to be below max'),
        ('0.05, s]', '0.05, ms]', 'WRONG_UNITS', "is in 'ms' but read as s; convert the bounds"),
        (
            'measurement_delay: ',
            'measurement_dely: ',
            'UNKNOWN_PARAMETER',
            'write measurement_delay, or remove the line',
        ),
    ],
)
def test_an_error_names_file_line_and_remedy(old, new, code, said, tmp_path, capsys):
    path, line = changed(tmp_path / 'my.yaml', old, new)
    with pytest.raises(IdentError) as caught:
        load_machine(path)
    assert caught.value.code.name == code
    assert caught.value.message.startswith(f'{path}:{line}: ')
    assert said in caught.value.message
    assert main(['check', '--machine', path]) == 1
    assert f'error {caught.value.message}\n' in capsys.readouterr().out


@pytest.mark.parametrize(
    ('kind', 'old', 'section', 'said'),
    [
        ('linear_axis', '  cycle: 0.001', 'controller', 'add the line `cycle: 0.001`'),
        ('linear_axis', '  drive_inertia: ', 'parameters', 'parameters lacks drive_inertia'),
        ('tripod', '  rod_length: 0.6', 'geometry', 'add the line `rod_length: 0.6`'),
        ('tripod', '  gear_stiffness: ', 'parameters', 'a tripod has elastic gears'),
        ('belt_drive', '  radius: 0.01', 'geometry', 'geometry.radius is missing'),
    ],
)
def test_what_is_missing_is_said_where_it_belongs(kind, old, section, said, tmp_path):
    path, _ = changed(tmp_path / 'my.yaml', old, '  # ', kind)
    lines = machine_template(KINDS[kind]).splitlines()
    line = next(i for i, text in enumerate(lines, 1) if text.startswith(f'{section}:'))
    with pytest.raises(IdentError) as caught:
        load_machine(path)
    assert caught.value.message.startswith(f'{path}:{line}: ')
    assert said in caught.value.message


@pytest.mark.parametrize(
    ('kind', 'old', 'new', 'said'),
    [
        (
            'linear_axis',
            'cycle: 0.001',
            'cycle: 1.0',
            'cycle is 1 s, 1e-06 to 0.05 would be',
        ),
        ('linear_axis', 'gear_factor: 78.54', 'gear_factor: 0.01', 'check value and unit'),
        ('linear_axis', '[1.0e+4, 3.0e+5', '[-1.0e+4, 3.0e+5', 'gear_stiffness is [-10000, 30'),
        ('linear_axis', 'unit: N m', 'unit: N', 'a force needs none; leave it out, or state'),
        ('linear_axis', '# travel_per_turn: 0.08', 'travel_per_turn: 0.04', 'one turn is 0.08 m'),
        ('linear_axis', '  gear_factor: ', '  # ', 'but drive.gear_factor is missing; add it in'),
        ('tripod', '4.1887902]', '240]', 'write the angles in rad'),
        ('tripod', 'law: cascade_pi', 'law: cascade_p', 'integral_gain has no meaning under'),
    ],
)
def test_what_is_implausible_is_a_warning_and_loads(kind, old, new, said, tmp_path, capsys):
    path, _ = changed(tmp_path / 'my.yaml', old, new, kind)
    load_machine(path)
    assert main(['check', '--machine', path]) == 0
    (warning,) = [x for x in capsys.readouterr().out.splitlines() if x.startswith('warn')]
    assert said in warning
    assert f'{path}:' in warning


def test_a_file_that_may_never_end_is_not_read(tmp_path):
    fifo = tmp_path / 'fifo.yaml'
    os.mkfifo(fifo)
    large = tmp_path / 'large.yaml'
    large.write_text('# nothing\n' * 30_000)
    for path, said in (
        (fifo, 'it is no regular file'),
        ('/dev/null', 'it is no regular file'),
        (large, 'it has 300000 bytes and may have 262144'),
    ):
        with pytest.raises(IdentError, match=f'cannot be read .{said}'):
            read_machine_file(path)


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('a: &x [1, 2]\nb: [*x, *x]\n', r'my.yaml:2: is no YAML \(the alias \*x; write out'),
        ('a: &x [*x]\n', r'my.yaml:1: is no YAML \(the alias \*x'),
        ('machine: tripod\ndrives: [a, b\ngeometry:\n', r'my.yaml:3: is no YAML'),
        ('[' * 1000 + ']' * 1000, 'is nested too deeply'),
        ('{a: ' * 1000, 'is nested too deeply'),
    ],
)
def test_what_is_no_yaml_or_stands_for_much_is_refused(tmp_path, text, said):
    path = tmp_path / 'my.yaml'
    path.write_text(text)
    with pytest.raises(IdentError, match=said):
        load_machine(path)


def test_shipped_machine_files_have_nothing_to_change():
    for path in ROOT.glob('config/*.yaml'):
        if path.name != 'identifier.yaml':
            assert read_machine_file(path).remarks == (), path


# ------------------------------------------------------------------ beside a bag


@pytest.mark.parametrize(
    ('machine', 'level', 'old', 'new', 'key', 'said'),
    [
        ('tripod', 'error', 'length: 0.60', 'length: 0.3005', 'rod_length', 'rods of 0.3005 m do'),
        ('tripod', 'error', 'factor: 78.', 'factor: 7.8', 'gear_factor', 'the machine weighs'),
        ('tripod', 'warn', 'gravity: 9.81', 'gravity: -9.81', 'gravity', 'has to hold the drive'),
        ('emps', 'error', 'limit: 351.5', 'limit: 3.5', 'effort_unit', '78.72, the limit is'),
    ],
)
def test_what_does_not_fit_the_bag_names_the_line(
    machine, level, old, new, key, said, tmp_path, capsys
):
    text = (ROOT / 'config' / f'{machine}.yaml').read_text()
    assert text.count(old) == 1
    path = tmp_path / 'my.yaml'
    path.write_text(text.replace(old, new))
    lines = enumerate(text.splitlines(), 1)
    line = next(i for i, x in lines if x.strip().startswith(f'{key}:'))
    code = main(['check', str(BAGS[machine]), '--machine', str(path)])
    assert code == (1 if level == 'error' else 0)
    out = capsys.readouterr().out.splitlines()
    assert any(x.startswith(level) and said in x and f'{path}:{line}: ' in x for x in out)


def test_a_good_pair_has_no_warning(capsys):
    for machine, bag in BAGS.items():
        file = ROOT / 'config' / f'{machine}.yaml'
        assert main(['check', str(bag), '--machine', str(file)]) == 0
        said = capsys.readouterr().out
        assert '\nwarn' not in said
    assert main(['check', str(bag)]) == 0


@pytest.mark.parametrize(
    ('kind', 'old', 'new'),
    [
        ('linear_axis', r'effort_noise: *[\d.e-]+', f'effort_noise: 0x{"f" * 5000}'),
        ('linear_axis', r'moving_mass: *\[[^,]*,', f'moving_mass: [1{"0" * 5000},'),
        ('linear_axis', r'machine: *\w+', 'machine: "\\e[31mred"'),
        ('linear_axis', r'machine: *\w+', f'machine: {"x" * 5000}'),
        ('linear_axis', r'effort_noise:', f'"\\e{"y" * 500}": 1\neffort_noise:'),
        ('serial', r'geometry:', f'geometry:\n  description: {"é" * 300}.urdf'),
        ('serial', r'geometry:', f'geometry:\n  description: 0x{"f" * 5000}'),
    ],
)
def test_what_a_file_says_is_shown_short_and_without_escapes(tmp_path, kind, old, new):
    path = tmp_path / 'my.yaml'
    text = (ROOT / 'config' / 'ur10.yaml' if kind == 'serial' else AXIS_FILE).read_text()
    assert re.search(old, text)
    path.write_text(re.sub(old, lambda _: new, text, count=1))
    with pytest.raises(IdentError) as info:
        load_machine(path)
    assert info.value.message.isprintable()
    assert len(info.value.message) < 500
