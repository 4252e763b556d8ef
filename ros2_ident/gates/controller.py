# SPDX-License-Identifier: Apache-2.0
"""Is the controller in the log the machine file's: gains, scale and sign of the effort, stamps?"""

from dataclasses import replace
from itertools import permutations
import math

import numpy as np

from ros2_ident.gates import scale
from ros2_ident.gates.finding import Gate, Level
from ros2_ident.gates.law import fit_law, Gain, Law
from ros2_ident.gates.scale import near
from ros2_ident.gates.signals import LATEST_COMMAND
from ros2_ident.models import Machine
from ros2_ident.recording import Dataset

# A gain is spoken of where it is off by this share; nearer to a factor, it is that. By hand.
GAIN_OFF = 0.02
# What is stated as noise may be off by so much where no log has told it. By hand.
_STATED = 2.5
# An effort logged before it acts by more than a cycle and this, s, has other stamps. By hand.
_EARLY = 1e-3
# The cause that leaves a log of use: along its recorded motion, without the set-point.
SET_POINT_LATE = 'command early'


def check_law(
    machine: Machine, law: Law | None, drive: str, noise: float | None = None
) -> list[Gate]:
    """Judge a drive's controller law as its log shows it, and by its noise floor where known."""
    if law is None:
        text = (
            f'{drive}: the control law cannot be checked: that needs a moving set-point, position '
            'and effort'
        )
        return [Gate('law', drive, 'warn', math.nan, '1', text, cause='unread')]
    level = _STATED * machine.effort_noise if noise is None else noise
    unit = machine.model_unit
    clean = law.misfit <= scale.MORE * math.hypot(level, law.steps)
    # Where no other gains explain more than the stated ones the law ran, and something else is
    # between it and the log: an effort that does not belong to it would ask for other gains.
    ran = not law.stray and law.explained > scale.STRAYS
    # Other gains would explain the effort if the law ran; a drive that is limited follows none.
    if math.isfinite(law.limit) and law.explained < scale.OWN:
        text = (
            f'{drive}: the effort stays at about {law.limit:.3g} {unit} wherever the control law '
            'asks for more; something limits it there'
        )
        return [Gate('limited', drive, 'warn', law.limit, unit, text)]
    if law.explained < scale.FOLLOWS and not clean and not ran:
        text = (
            f'{drive}: the stated control law explains {100.0 * law.explained:.0f} % of the '
            'logged effort, whatever its gains; check that effort, command and position belong '
            'together'
        )
        # An effect in the controller or its sensor explains as little.
        lost = law.explained < scale.STRAYS
        how: Level = 'fail' if lost else 'warn'
        return [Gate('law', drive, how, law.explained, '1', text, lost, cause='any gains')]
    found = _late(machine, law, clean)
    if noise is not None and not clean:
        text = (
            f'{drive}: the control law leaves {law.misfit:.3g} {unit} of the logged effort where '
            f'the noise is {noise:.3g}, whatever its gains; something sits between controller and '
            'log: a filter, cross-talk, drift, a limit, or a reading of the position'
        )
        found.append(Gate('law_noise', drive, 'warn', law.misfit / noise, '1', text))
    return [*found, _gains(machine, law, noise, clean)]


def _gains(machine: Machine, law: Law, noise: float | None, clean: bool) -> Gate:
    """Judge the gains of a law that explains the effort.

    A number is given to write only where with it nothing but noise is left.
    """
    drive, unit = law.drive, machine.model_unit
    if not law.gains:
        text = f'{drive}: the gains are to be found, so the log cannot contradict them'
        return Gate('law', drive, 'ok', law.explained, '1', text)
    best = law.gains[0]
    if not law.stray or abs(best.ratio - 1.0) <= GAIN_OFF:
        text = (
            f'{drive}: the effort follows the stated control law to within '
            f'{law.misfit_file:.3g} {unit} RMS'
        )
        if noise is not None and law.misfit > scale.MORE * noise and law.steps > noise:
            text += f', no more than the steps of the logged position make ({law.steps:.3g})'
        return Gate('law', drive, 'ok', best.ratio, '1', text)
    if not law.fits(best.misfit):
        text = (
            f'{drive}: with the gains of the machine file the control law misses the logged '
            f'effort by {law.misfit_file:.3g} {unit}, with its gains free by {law.misfit:.3g}; no '
            'single gain is to blame, correct the machine file, or look whether the drive runs '
            'other gains'
        )
        return Gate('law', drive, 'warn', math.nan, '1', text, cause='several gains')
    another = not near(best.ratio, scale.ANOTHER)
    if best.ratio < 0.0:
        # A sign that is reversed leaves the size; another size is another cause.
        another = _of_all(law, best) and near(-best.ratio)
    return Gate(
        'law', drive, 'fail' if another else 'warn', best.ratio, '1',
        f'{drive}: {_correction(law, best, unit, machine.travel_unit)}',
        contradicts=another or (clean and best.ratio > 0.0),
        key='' if best.name == 'scale' else best.name,
        cause=best.name,
    )  # fmt: skip


def _of_all(law: Law, best: Gain) -> bool:
    """Whether a gain is a factor on the whole effort, not on a part of it."""
    return best.name == 'scale' or all(gain.name != 'scale' for gain in law.gains)


def _correction(law: Law, best: Gain, unit: str, travel: str) -> str:
    """Return the correction of the machine file or the driver, in words."""
    fits = f'fits the log to {best.misfit:.2g} {unit}'
    if best.ratio < 0.0 and _of_all(law, best):
        return (
            'the effort has the sign that drives the controller away from its set-point; negate '
            f'the effort, or position and set-point, in the driver ({best.ratio:.4g} times the '
            f'stated law {fits})'
        )
    for factor, name in scale.UNITS.get(travel, ()):
        if abs(best.ratio * factor - 1.0) <= GAIN_OFF and best.name in ('velocity_gain', 'scale'):
            return (
                f'position and set-point look logged in another unit, {name}: the stated law '
                f'times {best.ratio:.4g} {fits}; log {travel}'
            )
    if best.name == 'scale':
        return (
            f'the effort is {best.ratio:.4g} times what the stated law commands, which then '
            f'{fits}; correct effort_unit and its constant in the machine file'
        )
    other = ''
    scales = [gain for gain in law.gains if gain.name == 'scale']
    if best.name == 'velocity_gain' and all(law.fits(g.misfit) for g in scales):
        factor = scales[0].ratio if scales else best.ratio
        other = f', or the effort is logged {factor:.3g} times as large as it is: check its unit'
    return f'your {best.name} is {best.expected:.4g}; {best.value:.4g} {fits}{other}'


def _late(machine: Machine, law: Law, clean: bool) -> list[Gate]:
    """Judge when effort and set-point are logged."""
    lag, late = law.effort_delay, law.command_delay
    if 0.0 < late <= LATEST_COMMAND and lag >= -_EARLY:
        from ros2_ident.effects import shown_by

        effect = shown_by('late_set_point')
        # Less than a cycle is what noise makes of none.
        if effect is None or late < machine.number('cycle'):
            return []
        text = (
            f'{law.drive}: the controller takes up its set-point {1e3 * late:.2f} ms '
            f'late; a {effect.title} has to be in the model'
        )
        return [Gate(effect.id, law.drive, 'warn', late, 's', text)]
    if -_EARLY <= lag <= scale.LATEST_EFFORT and -_EARLY <= late <= LATEST_COMMAND:
        if lag < scale.LATE or not clean:
            return []
        from ros2_ident.models.drives.candidates import SLOTS

        delay = next(name for name, slot in SLOTS.items() if slot.row == 'log_delay')
        if delay in machine.bounds:
            return []
        text = (
            f'{law.drive}: the effort is logged {1e3 * lag:.3g} ms late, and no delay of the log '
            f'is to be identified; stamp it where it is sampled, or list {delay} under parameters'
        )
        return [Gate('offset', law.drive, 'warn', lag, 's', text, contradicts=True, cause='log')]
    if abs(lag + late) < abs(lag) and abs(lag + late) < abs(late):
        topic, by = 'position', late
    elif -_EARLY <= late <= LATEST_COMMAND:
        topic, by = 'effort', lag
    else:
        topic, by = 'command', -late
    cause = f'{topic} {"late" if by > 0.0 else "early"}'
    text = (
        f'{law.drive}: the stamps of the {topic} are {round(1e3 * abs(by), 1):g} ms '
        f'{"late" if by > 0.0 else "early"} against those of the others: so shifted, the control '
        'law explains the effort; stamp all topics with one clock where they are sampled'
    )
    if cause == SET_POINT_LATE:
        # Position and effort belong together: nothing has to be wrong with the stamps.
        text = (
            f'{law.drive}: the controller takes its set-point {round(-1e3 * by, 1):g} ms late'
            ', as behind a filter or a network, or the stamps of the command are early; '
            'log the set-point that it takes, or leave the command out: `--command-topic none`'
        )
    # Two cycles are lost where a set-point is differentiated, or a cycle is stated wrongly.
    apart = abs(by) >= 2.0 * machine.number('cycle')
    level: Level = 'fail' if apart else 'warn'
    return [Gate('offset', law.drive, level, by, 's', text, apart, cause=cause)]


def of_one_drive(gates: list[Gate], drives: int) -> list[Gate]:
    """Return findings of which those of only some drives contradict nothing.

    A file that states one gain for all drives would have it wrong for all, one message holds all
    drives under one stamp, and a law that explains the others is the one that ran: here the drive
    differs, and the diagnosis looks for why.

    """

    def shared(gate: Gate) -> bool:
        # A gain or scale with the wrong sign is a drive's own wiring.
        return gate.contradicts and (gate.gate == 'offset' or gate.number > 0.0)

    alike: dict[tuple[str, str], list[float]] = {}
    for gate in filter(shared, gates):
        alike.setdefault((gate.gate, gate.key), []).append(gate.number)

    def judged(gate: Gate) -> Gate:
        if not shared(gate):
            return gate
        numbers = alike[gate.gate, gate.key]
        if len(numbers) < drives:
            return replace(gate, level='warn', contradicts=False)
        # By one factor on every drive of several, it is the file that has it wrong.
        by_one = gate.gate == 'law' and drives > 1 and near(max(numbers) / min(numbers))
        return replace(gate, level='fail') if by_one else gate

    return [judged(gate) for gate in gates]


def check_swapped(machine: Machine, data: Dataset, laws: list[Law]) -> list[Gate]:
    """Look for efforts logged under another drive's name, where laws explain too little."""
    lost = [law.drive for law in laws if law.explained < scale.OWN]
    if len(lost) < 2 or data.effort is None:
        return []
    rows = {name: data.effort[data.names.index(name)] for name in lost}
    own = {law.drive: law for law in laws}
    owner = {}
    for drive, other in permutations(lost, 2):
        effort = np.array(data.effort)
        effort[data.names.index(drive)] = rows[other]
        law = fit_law(machine, replace(data, effort=effort), drive)
        if law is None:
            continue
        # What is far off on its own drive need not be near on the other one's.
        better = law.misfit_file < scale.SWAPPED * own[drive].misfit_file
        stated = better and law.followed > scale.STRAYS
        rest = 1.0 - own[drive].explained
        if stated or 1.0 - law.explained < min(1.0 - scale.OWN, 0.5 * rest):
            owner[drive] = other
    if len(owner) < 2 or len(set(owner.values())) != len(owner):
        return []
    pairs = ', '.join(f"{other}'s effort is {drive}'s" for drive, other in owner.items())
    text = (
        f'{pairs}: the names are swapped between the topics of effort and position; correct the '
        'names, or their order, where the two are published'
    )
    return [Gate('names', '', 'fail', float(len(owner)), '1', text, contradicts=True)]
