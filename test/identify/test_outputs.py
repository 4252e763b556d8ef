# SPDX-License-Identifier: Apache-2.0
"""What is compared is chosen and weighted; constants of the machine file are identified."""

from identify_cases import (
    axis,
    axis_bag,
    AXIS_FILE,
    AXIS_TRUTH,
    recording_of,
    tripod_bag,
    TRIPOD_FILE,
    TRIPOD_TRUTH,
)
import numpy as np
import pytest
from values import parameter
import yaml

from ros2_ident.cli.main import main
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.identify.data import gather
from ros2_ident.identify.outputs import read_outputs
from ros2_ident.identify.result import Outcome
from ros2_ident.identify.run import identify, IdentifySettings
from ros2_ident.models import machine_from_mapping
from ros2_ident.recording import Stream
from ros2_ident.report.files import load_result
from ros2_ident.search import GeneticSettings

# The refinement finds these from anywhere near.
SMALL = IdentifySettings(
    genetic=GeneticSettings(initial_population=128, survivors=4, children=4, generations=4)
)
BOTH = {'effort': None, 'position': None}
FREE = {'position_gain': [20.0, 120.0, '1/s'], 'rail_mass': [0.3, 3.0, 'kg']}


def half_width(estimate):
    return 0.5 * (estimate.high - estimate.low)


def test_a_gain_and_a_mass_are_recovered_and_the_position_makes_them_sharp():
    content = yaml.safe_load(TRIPOD_FILE.read_text(encoding='utf-8'))
    truth = {
        'position_gain': content['controller'].pop('position_gain'),
        'rail_mass': content['drive'].pop('rail_mass'),
    }
    content['parameters'] |= FREE
    machine = machine_from_mapping(content)
    found = {}
    for name, outputs in (('effort', None), ('both', BOTH)):
        compared = tuple(outputs or ('effort',))
        data = gather([recording_of(tripod_bag())], machine, quantities=compared)
        found[name] = identify(machine, data, outputs=outputs, settings=SMALL, seed=1)
        assert found[name].outcome is Outcome.IDENTIFIED
    for drive in machine.drives:
        for name, value in (truth | {'drive_inertia': TRIPOD_TRUTH['drive_inertia']}).items():
            alone, both = (parameter(found[x], f'{drive}.{name}') for x in ('effort', 'both'))
            assert abs(alone.value - value) < 1.5 * half_width(alone), alone
            assert abs(both.value - value) < 0.02 * value, both
            assert half_width(both) < 0.5 * half_width(alone), name
    units = {x.drive: x.unit for x in found['both'].residuals}
    assert units['drive_1'] == '' and units['drive_1.position'] == 'm'


def without_effort():
    """Return a log of the axis that holds set-point and position only."""
    state = axis_bag().streams['/joint_states']
    bare = Stream(state.names, state.stamp, position=state.position)
    return recording_of(axis_bag(), state=bare, effort=None)


def test_a_log_without_effort_is_identified_by_its_position():
    data = gather([without_effort()], axis(), quantities=('position',))
    found = identify(axis(), data, outputs={'position': None}, settings=SMALL, seed=1)
    assert found.outcome is Outcome.IDENTIFIED
    assert found.cost.unit == 'm'
    # Its controller has no integral part: the axis stands off its set-point by what pulls at it.
    for name in ('moving_mass', 'viscous_friction', 'coulomb_friction', 'constant_force'):
        estimate = parameter(found, f'emps_axis.{name}')
        assert estimate.value == pytest.approx(AXIS_TRUTH[name], rel=0.01), name
    with pytest.raises(IdentError) as caught:
        gather([without_effort()], axis())
    assert caught.value.code is ErrorCode.MISSING_STREAM


@pytest.mark.parametrize(
    ('texts', 'said'),
    [
        (['torque'], "'torque' cannot be compared; choose from effort, position, velocity"),
        (['position=0'], 'the weight of position is 0; give a number above 0'),
        (['position=heavy'], "'position=heavy' is no output"),
    ],
)
def test_what_is_no_output_is_refused(texts, said):
    with pytest.raises(IdentError, match=said) as caught:
        read_outputs(texts)
    assert caught.value.code is ErrorCode.INVALID_GOAL


def test_the_recorded_motion_cannot_be_input_and_output():
    recording = recording_of(axis_bag(), command=None)
    data = gather([recording], axis(), quantities=('effort', 'position'))
    with pytest.raises(IdentError, match='cannot be compared with it'):
        identify(axis(), data, outputs=BOTH)


def test_the_command_takes_several_bags_and_outputs(tmp_path):
    bags = [str(tmp_path / name) for name in ('first', 'second', 'third')]
    set_ = [f'--set={name}={value}' for name, value in AXIS_TRUTH.items()]
    for seed, bag in enumerate(bags, 1):
        words = ['simulate', bag, '--machine', str(AXIS_FILE), '--seconds', '4', '--seed']
        assert main([*words, str(seed), *set_]) == 0
    common = ['--machine', str(AXIS_FILE), '--quiet', '--no-report', '--population', '128']
    common += ['--generations', '4', '--no-overlay', '--out']
    assert main(['identify', *bags, *common, str(tmp_path / 'all')]) == 0
    widths = []
    for bag in bags:
        assert main(['identify', bag, *common, str(tmp_path / 'one')]) == 0
        widths.append([half_width(p) for p in load_result(tmp_path / 'one').parameters])
    together = [half_width(p) for p in load_result(tmp_path / 'all').parameters]
    gain = np.mean(widths, axis=0) / together
    assert (gain > 1.4).all() and 1.4 < np.median(gain) < 2.1, gain  # about the root of three
    words = ['identify', *bags, '--each', 'constant_force', '--outputs', 'effort,position']
    assert main([*words, *common, str(tmp_path / 'each')]) == 0
    names = [p.name for p in load_result(tmp_path / 'each').parameters]
    assert names[-3:] == [f'emps_axis.constant_force@{x}' for x in ('first', 'second', 'third')]
