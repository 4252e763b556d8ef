# SPDX-License-Identifier: Apache-2.0
"""A machine file held against a bag of the machine: what in it cannot be, and on which line."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
import math

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.gates import examine
from ros2_ident.gates.controller import SET_POINT_LATE
from ros2_ident.gates.finding import sentences
from ros2_ident.identify.data import Data, gather
from ros2_ident.machine.file import MachineFile
from ros2_ident.machine.machine import Machine
from ros2_ident.models.registry import compared_of, kind_of
from ros2_ident.recording import check, Finding, Recording, Report, scale_effort
from ros2_ident.recording.quality import DriveSummary, Level

# What a finding on the bag may owe to the machine file.
_KEY_OF = {
    'effort_unit': ('effort_unit',),
    'limit': ('effort_unit',),
    'effort_gravity': ('geometry', 'gravity'),
    'effort_weight': ('drive', 'gear_factor'),
}
# Gates on the streams, of which the check of the recordings has more to say.
_STREAMS = {'missing', 'command'}
# No carriage goes further, m.
_LONG = 30.0
# Efforts at rest so many times off the machine's weight are worth a warning, and no torques.
# Static friction alone may take or give a good part of the weight.
_WEIGHT_WARN, _WEIGHT_ERROR = 1.6, 3.0


def check_machine(file: MachineFile) -> tuple[Finding, ...]:
    """Return what there is to change in a machine file by itself, each with its line."""
    found = [Finding(x.level, 'machine', '', file.sentence(x)) for x in file.remarks]
    machine = file.machine
    read = None if machine is None else kind_of(machine).read
    if machine is not None and read is not None:
        try:
            read(machine.described(None))
        except IdentError as error:
            # Where it is to be heard, or the library is not installed, there is nothing to judge.
            if error.code is ErrorCode.BAD_MACHINE_FILE:
                place = file.place(('geometry', 'description'))
                found.append(Finding('error', 'machine', '', f'{place}: {error.message}'))
    return tuple(found)


def check_both(
    recordings: Sequence[Recording], file: MachineFile, drives: Sequence[str] | None = None
) -> Report:
    """Judge recordings, the machine file, and whether they fit each other.

    Args:
        drives: Drives that are to be identified; all where None.

    Returns:
        The report; a finding that a line of the machine file can mend names it.
    """
    machine = file.machine
    aside = machine is not None and not kind_of(machine).follows(machine)
    if aside:
        recordings = [replace(recording, command=None) for recording in recordings]
    own = check_machine(file)
    if machine is None:
        report = check(recordings)
        return replace(report, findings=(*report.findings, *own))
    need = compared_of(machine)
    scaled = [scale_effort(recording, machine.effort_scales) for recording in recordings]
    report = check(scaled, machine.drives, need, machine.number('gravity'))
    found = [x for x in report.findings if not (aside and x.code == 'no_command')]
    found += [
        Finding(
            'warn', 'units', x.drive,
            f'{x.drive}: moves by {x.stroke:.4g} m; record positions of the carriage in m, not mm '
            'or the angle of the motor',
        )
        for x in report.drives if x.stroke > _LONG and machine.travel_unit == 'm'
    ]  # fmt: skip
    for number in range(len(recordings)) if 'effort' in need else ():
        found += _weight([x for x in report.drives if x.recording == number], machine)
    data: Data | None = None
    try:
        data = gather(recordings, machine, drives)
    except IdentError as error:
        found.append(Finding('error', error.code.name.lower(), '', error.message))
    for text in data.quality(0).warnings if data is not None else ():
        if all(text != x.sentence for x in found):
            found.append(Finding('warn', 'align', '', text))
    findings = [_with_line(x, file) for x in found] + [*own]
    if data is not None and all(x.level != 'error' for x in own):
        # The machine file shows which drives load each other: an arm's are not looked at alone.
        alone = {'effort_sign'}
        if kind_of(machine).joints and len(machine.drives) > 1:
            alone |= {'effort', 'effort_unexplained'}
        findings = [x for x in findings if x.code not in alone]
        logged = any(recording.sets_positions for recording in recordings)
        # Of a drive that stands, or has no effort, an identification asks nothing either.
        idle = {x.subject for x in report.findings if x.code in ('no_motion', 'effort_constant')}
        asked = [x for x in drives or machine.drives if x not in idle]
        gates = _gates(data, machine, file, asked)
        findings += (x for x in gates if logged or x.code != 'command')
        findings += _too_few(data, machine, drives)
    return replace(report, findings=tuple(findings))


def _too_few(data: Data, machine: Machine, drives: Sequence[str] | None) -> Iterator[Finding]:
    """Say where rest and turns leave a recorded motion fewer samples than there are parameters."""
    if any(x.command_position is not None for x in data.datasets):
        return
    from ros2_ident.identify.problem import problem_of

    try:
        problem_of(machine, data, drives=drives)
    except IdentError as error:
        # What else a model asks for, as a library, a check can do without.
        if error.code is ErrorCode.NO_DATA:
            yield Finding('error', 'no_data', '', error.message)


def _with_line(finding: Finding, file: MachineFile) -> Finding:
    path = _KEY_OF.get(finding.code)
    if path is None or finding.level == 'ok':
        return finding
    place = f'({file.place(path)}: {path[-1]})'
    return replace(finding, sentence=f'{finding.sentence} {place}')


def _gates(
    data: Data, machine: Machine, file: MachineFile, drives: Sequence[str] | None
) -> Iterator[Finding]:
    """Say what commands, positions and efforts say of each other, with the line to change."""
    constants = kind_of(machine).constants
    gates = examine(machine, data.datasets, drives).gates
    for gate in gates:
        if gate.gate in _STREAMS or (gate.gate, gate.level) in (('jitter', 'ok'), ('sign', 'ok')):
            continue
        path = next((key.path for key in constants if key.name == gate.key), ())
        place = f'{file.place(path)}: ' if path else ''
        spared = gate.level == 'fail' and gate.cause == SET_POINT_LATE
        level: Level = 'warn' if spared else 'error' if gate.level == 'fail' else gate.level
        found = Finding(level, gate.gate, gate.drive, f'{place}{gate.sentence}')
        yield _with_line(found, file)
    for text in sentences(x for x in gates if (x.gate, x.level) == ('sign', 'ok')):
        yield Finding('ok', 'sign', '', text)


def _weight(drives: Sequence[DriveSummary], machine: Machine) -> Iterator[Finding]:
    """Compare what the drives hold at rest with the weight of the machine.

    All drives raised by the same height raise the whole machine by it, so their forces at rest add
    up to its weight in every pose.
    """
    gravity = machine.number('gravity')
    held = [x for x in drives if x.drive in machine.drives]
    resting = bool(np.isfinite([x.effort_rest for x in held]).all())
    if not gravity or len(held) < len(machine.drives) or not resting:
        return
    carriages = sum(machine.number('rail_mass', name) for name in machine.drives)
    loads = [machine.bounds[x] for x in ('tool_mass', 'moving_mass') if x in machine.bounds]
    low = abs(gravity) * (carriages + sum(x[0] for x in loads))
    high = abs(gravity) * (carriages + sum(x[1] for x in loads))
    force = sum(x.effort_rest * machine.number('gear_factor', x.drive) for x in held)
    force = math.copysign(1.0, gravity) * force
    # nothing held or a reversed sign is said drive by drive
    if low <= 0.0 or force < 0.05 * low:
        return
    off = force / high if force > high else min(1.0, force / low)
    if 1.0 / _WEIGHT_WARN < off < _WEIGHT_WARN:
        return
    level: Level = 'warn' if 1.0 / _WEIGHT_ERROR < off < _WEIGHT_ERROR else 'error'
    text = (
        f'the efforts at rest hold {force:.3g} N, the machine weighs {low:.3g} to {high:.3g} N: '
        f'the effort is {off:.2g} times a torque; state effort_unit with torque_constant or '
        'rated_torque in the machine file, or correct its gear_factor and masses'
    )
    yield Finding(level, 'effort_weight', '', text)
