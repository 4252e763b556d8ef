# SPDX-License-Identifier: Apache-2.0
"""Every code of the catalogue is provoked from outside, with its sentence and its exit code."""

from collections.abc import Callable
from pathlib import Path
import re
import signal

from identify_cases import axis_bag, AXIS_FILE, ROOT
import numpy as np
import pytest

from ros2_ident.cli.main import main
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import Stream, write_bag

AXIS = ROOT / 'bags' / 'axis_reversals'
# In V s/m, without the force constant of 35.15 N/V.
WRONG_GAIN = 'velocity_gain: 243.45'
# Only a node can be busy; the test of that is this one.
BY_A_NODE = {ErrorCode.BUSY: ('ros/test_node.py', 'test_a_second_goal_is_refused_with_a_reason')}


def identify(bag: Path, folder: Path, *more: str, machine: Path = AXIS_FILE) -> list[str]:
    words = ['identify', str(bag), '--machine', str(machine), '--out', str(folder / 'out')]
    words += ['--no-overlay', '--no-report', '--population', '64', '--generations', '3']
    return [*words, *more]


def machine_with(folder: Path, old: str, new: str) -> Path:
    text = AXIS_FILE.read_text()
    assert text.count(old) == 1
    path = folder / 'machine.yaml'
    path.write_text(text.replace(old, new))
    return path


def bag_with_effort(folder: Path, effort: np.ndarray | None) -> Path:
    streams = dict(axis_bag().streams)
    old = streams.pop('/effort')
    if effort is not None:
        streams['/effort'] = Stream(
            old.names, old.stamp, effort=np.broadcast_to(effort, np.asarray(old.effort).shape)
        )
    return write_bag(folder / 'bag', streams)


def damaged(folder: Path) -> Path:
    path = folder / 'broken.mcap'
    path.write_bytes(b'\x89MCAP0\r\n' + bytes(100))
    return path


class CtrlC:
    """A progress meter that presses Ctrl-C, once, as soon as there is progress."""

    def __init__(self, **_: object) -> None:
        self.pressed = False

    def __enter__(self) -> 'CtrlC':
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def show(self, progress: object) -> None:
        if not self.pressed:
            self.pressed = True
            signal.raise_signal(signal.SIGINT)


PROVOKED: dict[ErrorCode, Callable[[Path], list[str]]] = {
    ErrorCode.OK: lambda folder: identify(AXIS, folder),
    ErrorCode.INVALID_GOAL: lambda folder: ['check'],
    ErrorCode.NO_DATA: lambda folder: ['check', '/nowhere'],
    ErrorCode.MISSING_STREAM: lambda folder: identify(bag_with_effort(folder, None), folder),
    ErrorCode.DAMAGED_BAG: lambda folder: ['check', str(damaged(folder))],
    ErrorCode.BAD_VALUES: lambda folder: identify(
        bag_with_effort(folder, np.array(np.nan)), folder
    ),
    ErrorCode.UNKNOWN_MODEL: lambda folder: identify(
        AXIS, folder, machine=machine_with(folder, 'machine: linear_axis', 'machine: rocket')
    ),
    ErrorCode.UNKNOWN_PARAMETER: lambda folder: identify(AXIS, folder, '--fix', 'mass=1'),
    ErrorCode.CANCELLED: lambda folder: identify(AXIS, folder),
    ErrorCode.DIVERGED: lambda folder: identify(
        AXIS,
        folder,
        machine=machine_with(folder, 'torque_limit: 351.5065', 'velocity_feedforward: 1.0e300'),
    ),
    ErrorCode.BAD_MACHINE_FILE: lambda folder: identify(
        AXIS, folder, machine=machine_with(folder, 'cycle:', 'cyle:')
    ),
    ErrorCode.WRONG_UNITS: lambda folder: identify(AXIS, folder, '--effort-unit', 'mA'),
    ErrorCode.CONTRADICTED: lambda folder: identify(
        AXIS, folder, machine=machine_with(folder, 'velocity_gain: 8557.4257475', WRONG_GAIN)
    ),
    ErrorCode.NOT_IDENTIFIABLE: lambda folder: identify(
        AXIS, folder, '--bounds', 'moving_mass=94.9999:95.0001'
    ),
}


@pytest.mark.parametrize('code', PROVOKED, ids=lambda code: code.name)
def test_a_code_is_provoked_with_its_sentence_and_its_exit_code(
    code, tmp_path, monkeypatch, capsys
):
    if code is ErrorCode.CANCELLED:
        monkeypatch.setattr('ros2_ident.cli.progress.Meter', CtrlC)
    assert main(PROVOKED[code](tmp_path)) == code.exit_code
    said = capsys.readouterr()
    text = said.out if code.exit_code < 2 else said.err
    last = text.strip().splitlines()[-2 if code.exit_code < 2 else -1]
    if code is ErrorCode.OK:
        assert not re.search(r'\[[A-Z_]+\]$', last)
    else:
        assert last.endswith(f' [{code.name}]'), text
    assert 'Traceback' not in said.err


def test_a_defect_is_said_to_be_one(monkeypatch, capsys):
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError('by hand')

    monkeypatch.setattr('ros2_ident.recording.read_bag', broken)
    assert main(['check', str(AXIS)]) == ErrorCode.INTERNAL.exit_code == 3
    said = capsys.readouterr().err
    assert 'ZeroDivisionError: by hand' in said
    assert 'please report it' in said.splitlines()[-1]
    assert said.endswith('[INTERNAL]\n')


def test_no_code_is_left_out():
    assert set(PROVOKED) | set(BY_A_NODE) | {ErrorCode.INTERNAL} == set(ErrorCode)
    for code, (file, name) in BY_A_NODE.items():
        text = (ROOT / 'test' / file).read_text()
        assert f'ErrorCode.{code.name}' in text[text.index(f'def {name}(') :].split('\n\n\n')[0]
    page = (ROOT / 'docs/errors.md').read_text()
    rows = re.findall(r'^\| (\d+) \| `(\w+)` \| .+\. \| .+\. \| (\d) \|$', page, re.MULTILINE)
    assert rows == [(str(int(x)), x.name, str(x.exit_code)) for x in ErrorCode]


def test_a_sentence_never_carries_what_a_terminal_obeys():
    error = IdentError(ErrorCode.NO_DATA, 'bag\x1b[31m\n\0 é: does not exist')
    assert error.message == r'bag\x1b[31m\n\x00 é: does not exist'
    assert str(error) == error.message
