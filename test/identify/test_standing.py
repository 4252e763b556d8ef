# SPDX-License-Identifier: Apache-2.0
"""Logs in which some drives stand: nothing is asked of them, and their links count."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip('pinocchio', reason='pinocchio is not installed')

from ros2_ident.cli.main import main  # noqa: E402
from ros2_ident.errors import IdentError  # noqa: E402
from ros2_ident.gates.examine import check_effort  # noqa: E402
from ros2_ident.identify.data import Data, gather  # noqa: E402
from ros2_ident.identify.run import identify  # noqa: E402
from ros2_ident.identify.settings import IdentifySettings  # noqa: E402
from ros2_ident.models import machine_from_mapping, make_model  # noqa: E402
from ros2_ident.recording import Dataset  # noqa: E402
from ros2_ident.recording.quality import check  # noqa: E402
from ros2_ident.recording.streams import Recording, Stream  # noqa: E402

CYCLE, COUNT = 0.01, 1500
TIME = CYCLE * np.arange(COUNT)
WAVE = 0.6 * np.sin(1.3 * TIME) + 0.3 * np.sin(3.1 * TIME + 1.0)
ARM = machine_from_mapping(
    {
        'machine': 'serial',
        'drives': ['column', 'shoulder', 'elbow'],
        'geometry': {
            'dh_a': [0.0, 0.1, 0.4],
            'dh_alpha': [0.2, -1.5, 0.3],
            'dh_d': [0.3, 0.0, 0.1],
            'dh_theta': [0.0, 0.0, 0.0],
        },
        'controller': {'cycle': CYCLE},
        'parameters': {
            'link_moment': [-5.0, 5.0, 'kg m'],
            'link_inertia': [-5.0, 5.0, 'kg m^2'],
            'coulomb_torque': [0.0, 9.0, 'N m'],
            'viscous_torque': [0.0, 9.0, 'N m s/rad'],
        },
    }
)


def logged(*positions, noise=0.01):
    """Return a log of an arm of three links of 2 kg, with friction."""
    place = np.array([np.broadcast_to(p, COUNT) for p in positions])
    rng = np.random.default_rng(0)
    data = Dataset(ARM.drives, CYCLE, 0, None, None, place, None, np.zeros_like(place))
    model = make_model(ARM, data)
    links = np.tile([2.0, 0.4, 0.1, 0.2, 0.05, 0.0, 0.06, 0.0, 0.0, 0.07], (3, 1))
    speed = model.motion[1]
    effort = model.links_effort(links) + 0.5 * np.sign(speed) + 0.3 * speed
    # What holds a drive at rest is anything up to its friction.
    effort += np.where(np.ptp(place, axis=1) < 0.1, 0.4, 0.0)[:, None]
    return replace(data, effort=effort + rng.normal(0.0, noise, place.shape))


def found(data):
    return identify(ARM, Data((data,)), settings=IdentifySettings(method='algebraic'))


def test_of_one_joint_that_moves_the_answer_is_about_that_joint():
    jitter = 1e-5 * np.random.default_rng(1).normal(size=COUNT)
    result = found(logged(0.7 + jitter, WAVE, -0.4))
    assert result.drives == ('shoulder',)
    assert {p.name.partition('.')[0] for p in result.parameters} == {'shoulder'}
    values = {p.name.partition('.')[2]: p.value for p in result.parameters}
    assert values['coulomb_torque'] == pytest.approx(0.5, rel=0.02)
    assert values['viscous_torque'] == pytest.approx(0.3, rel=0.02)
    # Two moments and one inertia of all that hangs on it show, and gravity through the elbow.
    assert len(values) == 5
    assert result.residuals[0].rms < 0.012
    (said,) = [w for w in result.quality.warnings if 'stood still' in w]
    assert said.startswith('column, elbow stood still: ')
    assert np.isfinite([[p.value, p.low, p.high] for p in result.parameters]).all()


def test_what_stands_is_said_once_before_a_fit_and_is_no_error():
    stamp = np.round(TIME * 1e9).astype(np.int64)
    place = np.stack([np.full(COUNT, 0.7), WAVE, np.full(COUNT, -0.4)], axis=1)
    stream = Stream(ARM.drives, stamp, place, None, np.gradient(place, axis=0))
    said = [f for f in check([Recording(stream, None, None)]).findings if f.code == 'no_motion']
    assert [(f.level, f.subject) for f in said] == [('warn', 'column'), ('warn', 'elbow')]


@pytest.mark.parametrize('effort', [0.0, np.nan])
def test_what_nothing_drives_is_not_compared_and_counts_as_it_moves(effort):
    # It goes round: beside it the others would stand.
    other = 12.0 * TIME + 0.5 * np.sin(2.1 * TIME)
    whole = logged(0.8 * np.sin(0.7 * TIME), WAVE, other)
    data = replace(whole, effort=np.vstack([whole.effort[:2], np.full(COUNT, effort)]))
    result = found(data)
    assert result.drives == ('column', 'shoulder')
    values = {p.name: p.value for p in result.parameters}
    assert values['shoulder.coulomb_torque'] == pytest.approx(0.5, rel=0.05)
    assert 'elbow.link_inertia_zz' in values and 'elbow.coulomb_torque' not in values
    assert max(x.rms for x in result.residuals) < 0.015
    assert not any('stood still' in w for w in result.quality.warnings)
    (said,) = [w for w in result.quality.warnings if 'no effort' in w]
    assert said.startswith('elbow had no effort: ')
    with pytest.raises(IdentError, match='is 0 in every sample|no effort of elbow'):
        identify(ARM, gather([recorded(data)], ARM, ('elbow',)))
    dead = replace(data, effort=0.0 * data.effort)
    with pytest.raises(IdentError, match='is 0 in every sample|no effort of column'):
        gather([recorded(dead)], ARM)
    assert gather([recorded(data)], ARM).datasets[0].effort is not None
    said = check([recorded(data)])
    assert not said.of('no_motion')
    (code,) = said.of('effort_constant' if effort == 0.0 else 'nan')
    assert code.level == 'warn' and 'elbow' in code.sentence
    assert not any(x.drive == 'elbow' for x in check_effort(ARM, data, 'elbow')) or effort == 0.0


def recorded(data):
    """Return a recording of a log's positions and efforts."""
    stamp = np.round(TIME * 1e9).astype(np.int64)
    return Recording(Stream(data.names, stamp, data.position.T, None, data.effort.T), None, None)


@pytest.mark.parametrize('held', [0.0, 0.06])
def test_the_sign_of_what_holds_a_drive_is_not_asked_about(tmp_path, capsys, held):
    place, still = np.sin(2.0 * TIME), 1e-3 * np.sin(0.7 * TIME)
    effort = np.sign(np.cos(2.0 * TIME)) - 0.8 * place
    holding = held * np.abs(np.cos(0.7 * TIME))
    log, machine = tmp_path / 'log.csv', tmp_path / 'm.yaml'
    rows = np.stack([TIME, place, effort, still, holding], 1)
    np.savetxt(log, rows, delimiter=',', header='time,a_pos,a_torque,b_pos,b_torque', comments='')
    words = ['--kind', 'linear_axis', '--drives', 'a', '--bag', str(log), '--out', str(machine)]
    assert main(['new-machine', *words]) == 0
    text = machine.read_text().replace('drives: [a]', 'drives: [a, b]')
    machine.write_text(text)
    assert main(['check', str(log), '--machine', str(machine)]) == 0
    said = capsys.readouterr().out
    assert 'b: stood still, so nothing is found of what moves there' in said
    assert 'b: the effort' not in said
