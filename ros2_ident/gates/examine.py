# SPDX-License-Identifier: Apache-2.0
"""All gates on all recordings of a machine."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
import math

import numpy as np

from ros2_ident.arrays import Array, fast_noise
from ros2_ident.errors import IdentError
from ros2_ident.gates import scale
from ros2_ident.gates.added import added_to, without
from ros2_ident.gates.asked import Asked, fit_asked
from ros2_ident.gates.controller import check_law, check_swapped, of_one_drive
from ros2_ident.gates.finding import Gate, GateReport, Level, LEVELS
from ros2_ident.gates.law import fit_law, Law
from ros2_ident.gates.scale import figure, near
from ros2_ident.gates.signals import sane
from ros2_ident.gates.tracking import check_tracking, tracking_of
from ros2_ident.gates.weight import check_weight
from ros2_ident.models import FullModel, Machine
from ros2_ident.models.registry import compared_of, follows, kind_of, knows_gains
from ros2_ident.recording import Dataset
from ros2_ident.recording.motion import fill_gaps, motion_in, ROOM
from ros2_ident.recording.sign import effort_lag, SAID, sign_of, WRONG
from ros2_ident.recording.streams import StreamQuality

# Shares of samples missing from which on a log is suspect, and of no use. By hand.
MISSING, TOO_MANY_MISSING = 0.02, 0.2
# Motion up to this frequency is looked at where the log shows it, Hz. By hand.
SEEN = 50.0
NO_COMMAND = Gate(
    'command', '', 'warn', math.nan, '1',
    'no command is used, so the recorded motion drives the model: its noise biases masses and '
    'friction, and the controller stays unchecked; record the set-point that it takes',
)  # fmt: skip

NO_GAINS = replace(
    NO_COMMAND,
    gate='gains',
    sentence='the machine file states no gains, so the recorded motion drives the model, not a '
    'set-point; state position_gain and velocity_gain to simulate the controller too, or list '
    'them under parameters',
)


def examine(
    machine: Machine,
    datasets: Sequence[Dataset],
    drives: Sequence[str] | None = None,
    noise: Array | None = None,
) -> GateReport:
    """Ask every gate about every recording.

    Args:
        datasets: Its recordings on the grid of controller cycles.
        drives: The drives looked at; all where None.
        noise: (D,) their noise floors, where known.

    Returns:
        The findings; of those that recordings share, each drive's worst.
    """
    chosen = tuple(drives or machine.drives)
    reports = [_of_one(machine, x, chosen, noise, n) for n, x in enumerate(datasets, 1)]
    gates: dict[tuple[str, str], Gate] = {}
    streams: list[Gate] = []
    # A drive that is limited follows neither its set-point nor its law.
    limited = {gate.drive for report in reports for gate in report.of('limited')}
    for number, report in enumerate(reports, 1):
        for gate in report.gates:
            if gate.drive in limited and gate.gate in ('law', 'law_noise', 'offset'):
                continue
            if gate.gate == 'not_asked' and len(reports) > 1:
                gate = replace(gate, sentence=f'recording {number}: {gate.sentence}')
            if gate.gate in ('missing', 'jitter', 'not_asked'):
                streams.append(gate)
                continue
            key = gate.gate, gate.drive
            worst = min(gates.get(key, gate), gate, key=lambda g: LEVELS.index(g.level))
            gates[key] = worst
    laws = {law.drive: law for report in reversed(reports) for law in report.laws}
    asked = tuple(report.asked[0] if report.asked else () for report in reports)
    return GateReport((*streams, *gates.values()), tuple(laws.values()), asked)


def examine_models(
    models: Sequence[FullModel], theta: Array | None = None, noise: Array | None = None
) -> GateReport:
    """Ask every gate about the recordings of models.

    Args:
        theta: (N,) a candidate of the first one: what it explains has the model's sign.
        noise: (D,) noise floors of what is compared; the machine file's noise where None.
    """
    machine = models[0].machine
    report = GateReport()
    if machine is not None:
        # What the gates hold against noise is the effort.
        of_effort = models[0].outputs[0].quantity == 'effort'
        data = [m.data for m in models]
        report = examine(machine, data, models[0].places, noise if of_effort else None)
        report = replace(report, gates=(*report.gates, *_too_fast(models)))
    if theta is None or noise is None:
        return report
    left = models[0].measured - models[0].simulate(np.atleast_2d(theta))[0]
    rms = dict(zip(models[0].places, np.sqrt(np.nanmean(left**2, axis=1)) / noise, strict=True))
    # What a model explains down to the noise has the model's sign.
    wrong = [g for g in report.of('sign') if g.level == 'fail' and rms[g.drive] < 2.0]
    return replace(report, gates=tuple(g for g in report.gates if g not in wrong))


def _too_fast(models: Sequence[FullModel]) -> Iterator[Gate]:
    """Yield the drives of whose effort most is faster than what is compared, and no noise."""
    for o, output in enumerate(models[0].outputs):
        fast, whole = 0.0, 0.0
        for model in models:
            efforts = model.data.effort
            if not model.thinned or output.quantity != 'effort' or efforts is None:
                continue
            order = [model.data.names.index(x.place or x.name) for x in model.outputs]
            seen, compared = efforts[order], np.flatnonzero(np.isfinite(model.measured[o]))
            if not (compared.size > 1 and np.isfinite(seen).any(axis=1).all()):
                continue
            rows = np.stack([fill_gaps(row) for row in seen])
            kept = compared[[0, -1]]
            left = (rows - model.in_band(rows))[o, slice(*kept)]
            noise = fast_noise(seen[o, np.isfinite(seen[o])])
            fast += left.size * max(float(np.var(left)) - noise**2, 0.0)
            whole += left.size * float(np.var(rows[o, slice(*kept)]))
        if fast > 0.5 * whole:
            share = fast / whole
            drive = output.place or output.name
            text = (
                f'{drive}: {100.0 * share:.0f} % of what varies in the effort is faster than the '
                'recorded positions tell and is not compared, so that a ripple there has no name; '
                'record the motion slower, or the positions in finer steps'
            )
            yield Gate('too_fast', drive, 'warn', share, '1', text)


def _of_one(
    machine: Machine, data: Dataset, drives: Sequence[str], noise: Array | None, number: int
) -> GateReport:
    report = _of_motion(machine, data, drives, noise, number)
    report = replace(report, gates=(*report.gates, *_beyond_reach(machine, data)))
    if 'effort' not in compared_of(machine):
        return report
    weight, factors = check_weight(machine, data)
    gates = (_of_weight(gate, factors.get(gate.drive, math.nan)) for gate in report.gates)
    report = replace(report, gates=(*filter(None, gates), *weight))
    asked = [found for drive in drives if (found := fit_asked(machine, data, drive, number))]
    asked += report.asked[0] if report.asked else ()
    said = [gate for found in asked for gate in check_asked(found, machine.model_unit)]
    return GateReport((*report.gates, *said), report.laws, (tuple(asked),))


def _of_weight(gate: Gate, factor: float) -> Gate | None:
    """Return a gate; of a sign that only the description's weight shows what that says of it."""
    if (gate.gate, gate.cause) != ('sign', 'open') or math.isnan(factor):
        return gate
    text = f'{gate.drive}: the effort has the sign of what the description asks for'
    # what is no such effort has a finding of its own
    return replace(gate, cause='right', sentence=text) if near(factor, scale.ANOTHER) else None


def _beyond_reach(machine: Machine, data: Dataset) -> Iterator[Gate]:
    """Yield contradictions of the recorded positions and the machine file, or their unit."""
    check_motion = kind_of(machine).check_motion
    if check_motion is None or data.position is None:
        return
    order = [data.names.index(name) for name in machine.drives]
    asked = data.command_position
    # A drive that does not follow set-points within reach is no fault of the file's.
    strayed = asked is not None and not any(check_motion(machine, asked[order]))
    for remark in check_motion(machine, data.position[order]):
        level: Level = 'fail' if remark.level == 'error' and not strayed else 'warn'
        key = remark.path[-1] if remark.path else ''
        yield Gate('reach', '', level, math.nan, '1', remark.text, level == 'fail', key)


def _of_motion(
    machine: Machine, data: Dataset, drives: Sequence[str], noise: Array | None, recording: int
) -> GateReport:
    """Ask the gates of position set-points, and those of the log as a whole."""
    found = check_streams(data)
    tracking = tracking_of(data, drives)
    told = check_tracking(tracking, data.cycle, machine.travel_unit) if tracking else []
    apart = [gate for gate in told if gate.gate == 'offset']
    wrong = [gate for gate in told if gate.level == 'fail' and gate not in apart]
    if 'effort' not in compared_of(machine):
        # Signs, sizes and laws below are those of efforts, which such a log need not hold; and a
        # law without an integral part may follow late and stop short.
        return GateReport((*found, *(gate for gate in wrong if gate.cause != 'factor')))
    for drive in drives:
        found += check_effort(machine, data, drive)
    found += [gate for gate in told if gate not in apart]
    if wrong:
        # A law that is fed with another drive's motion, or in other units, says nothing new.
        return GateReport((*found, *apart))
    if data.command_position is None:
        # Gains are of no use without set-points; a kind that follows none needs none.
        gains = data.goal is not None and not knows_gains(machine)
        missed = [NO_GAINS if gains else NO_COMMAND] if follows(machine) else []
        return GateReport((*found, *missed))
    if not (machine.known('position_gain') and machine.known('velocity_gain')):
        return GateReport((*found, *apart))
    laws: list[Law] = []
    said: list[Gate] = []
    added: list[Asked] = []
    for number, drive in enumerate(drives):
        late = 0.0 if tracking is None else tracking.late(drive)
        agree = _agree(data, drive)
        law = fit_law(machine, data, drive, late, agree)
        if law is not None and (more := added_to(machine, data, law, recording)):
            added.append(more)
            law = fit_law(machine, without(data, more), drive, late, agree) or law
        if law is not None:
            laws.append(law)
        level = None if noise is None else float(noise[number])
        said += check_law(machine, law, drive, level)
    said = of_one_drive(said, len(drives))
    swapped = check_swapped(machine, data, laws)
    if swapped:
        found = [gate for gate in found if gate.gate != 'sign']
        said = [gate for gate in said if gate.gate not in ('law', 'offset')]
    # The law tells by how much stamps lie apart, and whose.
    known = {gate.drive for gate in said if gate.gate == 'offset'}
    apart = [gate for gate in apart if gate.drive not in known and not swapped]
    return GateReport((*found, *apart, *said, *swapped), tuple(laws), (tuple(added),))


def _agree(data: Dataset, drive: str) -> bool:
    """Return whether a drive's motion explains its effort without a shift of their stamps."""
    if data.position is None or data.effort is None:
        return False
    try:
        lag, _ = effort_lag(motion_in(data, drive), data.effort[data.names.index(drive)])
    except IdentError:
        return False
    return lag <= scale.LATE


def late_set_point(machine: Machine, data: Dataset, drives: Sequence[str]) -> str:
    """Return that a drive follows its set-point later than loop and model can; or nothing.

    Said only where position and effort are stamped together, and gains are stated.
    """
    gains, tracking = ('position_gain', 'velocity_gain'), tracking_of(data, drives)
    stated = all(map(machine.known, gains)) and not {*gains} & set(machine.bounds)
    if not stated or tracking is None or 'effort' not in compared_of(machine):
        return ''
    for drive in drives:
        position, velocity = (sane(machine.number(gain, drive)) for gain in gains)
        # Of a cascade the first is 1/s.
        own = (1.0 if 'law' in machine.constants else velocity) / max(position, 1e-12)
        behind = tracking.late(drive)
        if behind <= 1.5 * own:
            continue
        from ros2_ident.effects import shown_by

        effect = shown_by('late_set_point')
        longest = effect.parameters[0].high if effect else 0.0
        if behind > 1.5 * own + longest and _agree(data, drive):
            return (
                f'{drive}: the position follows its set-point {1e3 * behind:.2g} ms behind, where '
                f'the stated gains make {1e3 * own:.2g} ms: the controller takes another one, '
                'behind a filter or a network, so it is not used; log the set-point that it takes'
            )
    return ''


def check_streams(data: Dataset) -> list[Gate]:
    """Judge missing samples and the jitter of the stamps of every stream."""
    found = []
    # What is in one message comes with its losses and its stamp.
    alike: dict[StreamQuality, list[str]] = {}
    for role, stream in data.streams.items():
        alike.setdefault(stream, []).append(role)
    for stream, roles in alike.items():
        name, share = ' and '.join(roles), stream.missing_share
        uneven = stream.missing is None
        level: Level = 'warn' if uneven or share > MISSING else 'ok'
        level = 'fail' if share > TOO_MANY_MISSING else level
        text = f'{name}: {stream.samples} samples at {stream.rate:.6g} Hz'
        if uneven:
            text += ' come unevenly; log at a fixed rate, stamped where they are taken'
        elif level == 'ok':
            text += f', {stream.missing} missing' if stream.missing else ', none missing'
        else:
            text += (
                f', {100.0 * share:.2g} % are missing; record on the machine itself, or with a '
                'larger cache'
            )
        found.append(Gate('missing', '', level, share, '1', text))
        period = 1.0 / stream.rate if stream.rate else math.inf
        # A share of its period, by hand. Uneven samples keep to no cycle.
        loose = stream.jitter > 0.15 * period and not uneven
        text = f'{name}: stamps scatter by {1e3 * stream.jitter:.2g} ms about the grid'
        if loose and not stream.stride:
            text = (
                f'{name}: the samples keep to no multiple of the controller cycle, and straight '
                'lines between them count; state a cycle that divides their period'
            )
        elif loose:
            text += '; a shorter delay cannot be seen: stamp samples where they are taken'
        if 'state' in roles and (cutoff := ROOM * stream.rate) < SEEN:
            slow = (
                f'positions come at {stream.rate:.4g} Hz, so motion is smoothed at {cutoff:.3g} '
                'Hz: what is faster does not show and looks like a gap; log at '
                f'{SEEN / ROOM:g} Hz or more'
            )
            found.append(Gate('rate', '', 'warn', stream.rate, 'Hz', slow))
        found.append(Gate('jitter', '', 'warn' if loose else 'ok', stream.jitter, 's', text))
    return found


def check_effort(machine: Machine, data: Dataset, drive: str) -> list[Gate]:
    """Judge whether a drive's effort has the sign and the size of a torque that moves it."""
    d = data.names.index(drive)
    if data.effort is None or data.position is None or np.isnan(data.effort[d]).all():
        return []
    found = []
    limit = machine.number('torque_limit', drive)
    top = float(np.nanmax(np.abs(data.effort[d])))
    if math.isfinite(limit):
        bad = top > scale.MORE * limit
        text = f'{drive}: the effort reaches {top:.4g}, the limit is {limit:.4g}'
        if bad:
            text += '; state the unit of the log as effort_unit, or the true torque_limit'
        found.append(Gate('limit', drive, 'fail' if bad else 'ok', top / limit, '1', text, bad))
    try:
        # The other links of an arm may drive a joint against its own friction.
        sign = sign_of(motion_in(data, drive), alone=not kind_of(machine).follows(machine))
    except IdentError:
        return found
    bad = sign in WRONG
    level: Level = 'fail' if bad else 'ok'
    text = f'{drive}: {SAID[sign]}'
    return [*found, Gate('sign', drive, level, math.nan, '1', text, bad, cause=sign)]


def check_asked(found: Asked, unit: str) -> list[Gate]:
    """Judge how a drive makes the effort that it is asked for.

    Args:
        found: From `fit_asked`.
        unit: Unit of an effort.
    """
    drive = found.drive
    off = not near(found.factor)
    text = (
        f'{drive}: makes {found.factor:.3g} times the effort that it is asked for, '
        f'{1e3 * found.late:.0f} ms late, to within {found.usual:.2g} {unit}'
    )
    if off:
        text += '; check the torque constants of log and controller'
    said = [Gate('asked', drive, 'warn' if off else 'ok', found.factor, '1', text)]
    if math.isnan(found.factor):
        said = []  # a law asks for it, which has a gate of its own
    if math.isfinite(found.limit):
        text = (
            f'{drive}: the effort stays at about {found.limit:.3g} {unit} where the command asks '
            'for more; something limits it there'
        )
        said.append(Gate('limited', drive, 'warn', found.limit, unit, text))
    if found.pushes:
        at = ', '.join(f'{p.when} ({figure(p.effort, "+")} {unit})' for p in found.pushes)
        text = (
            f'{drive}: effort that was not commanded: {at}; look for another source of commands, '
            'contact with a person or an object, or a fault of the drive'
        )
        said.append(Gate('not_asked', drive, 'warn', found.pushes[0].time, 's', text))
    return said
