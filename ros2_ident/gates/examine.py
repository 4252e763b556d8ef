# SPDX-License-Identifier: Apache-2.0
"""All gates on all recordings of a machine."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
import math

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.gates.asked import fit_asked
from ros2_ident.gates.controller import check_law, check_swapped, of_one_drive
from ros2_ident.gates.finding import Gate, GateReport, Level, LEVELS
from ros2_ident.gates.law import fit_law, Law
from ros2_ident.gates.log import check_asked, check_effort, check_streams
from ros2_ident.gates.tracking import check_tracking, tracking_of
from ros2_ident.models import FullModel, Machine
from ros2_ident.models.registry import compared_of, follows, kind_of
from ros2_ident.recording import Dataset

NO_COMMAND = Gate(
    'command', '', 'warn', math.nan, '1',
    'there is no command, so the recorded motion drives the model: its noise biases masses and '
    'friction, and the controller stays unchecked; record the set-point too',
)  # fmt: skip


def examine(
    machine: Machine,
    datasets: Sequence[Dataset],
    drives: Sequence[str] | None = None,
    noise: Array | None = None,
) -> GateReport:
    """Ask every gate about every recording.

    Args:
        machine: The machine.
        datasets: Its recordings on the grid of controller cycles.
        drives: The drives looked at; all where None.
        noise: (D,) their noise floors, where known.

    Returns:
        The findings; of those that recordings share, each drive's worst.
    """
    chosen = tuple(drives or machine.drives)
    reports = [_of_one(machine, data, chosen, noise) for data in datasets]
    gates: dict[tuple[str, str], Gate] = {}
    streams: list[Gate] = []
    # A drive that is limited follows neither its set-point nor its law.
    limited = {gate.drive for report in reports for gate in report.of('limited')}
    for number, report in enumerate(reports, 1):
        for gate in report.gates:
            if gate.drive in limited and gate.gate in ('law', 'law_noise', 'offset'):
                continue
            if gate.gate in ('missing', 'jitter'):
                streams.append(gate)
                continue
            if gate.gate == 'not_asked':
                place = f'recording {number}: ' if len(reports) > 1 else ''
                streams.append(replace(gate, sentence=place + gate.sentence))
                continue
            other = gates.setdefault((gate.gate, gate.drive), gate)
            if LEVELS.index(gate.level) < LEVELS.index(other.level):
                gates[gate.gate, gate.drive] = gate
    laws = {law.drive: law for report in reversed(reports) for law in report.laws}
    asked = tuple(
        tuple(
            replace(found, pushes=tuple(replace(e, recording=number) for e in found.pushes))
            for found in (report.asked[0] if report.asked else ())
        )
        for number, report in enumerate(reports, 1)
    )
    return GateReport((*streams, *gates.values()), tuple(laws.values()), asked)


def examine_models(
    models: Sequence[FullModel], theta: Array | None = None, noise: Array | None = None
) -> GateReport:
    """Ask every gate about the recordings of models.

    Args:
        models: A model of each recording.
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
    if theta is None or noise is None:
        return report
    left = models[0].measured - models[0].simulate(np.atleast_2d(theta))[0]
    rms = dict(zip(models[0].places, np.sqrt(np.nanmean(left**2, axis=1)) / noise, strict=True))
    # What a model explains down to the noise has the model's sign.
    wrong = [g for g in report.of('sign') if g.level == 'fail' and rms[g.drive] < 2.0]
    return replace(report, gates=tuple(g for g in report.gates if g not in wrong))


def _of_one(
    machine: Machine, data: Dataset, drives: Sequence[str], noise: Array | None
) -> GateReport:
    """Ask every gate about one recording."""
    report = _of_motion(machine, data, drives, noise)
    report = replace(report, gates=(*report.gates, *_beyond_reach(machine, data)))
    if 'effort' not in compared_of(machine):
        return report
    asked = [found for drive in drives if (found := fit_asked(machine, data, drive))]
    said = [gate for found in asked for gate in check_asked(found, machine.model_unit)]
    return GateReport((*report.gates, *said), report.laws, (tuple(asked),))


def _beyond_reach(machine: Machine, data: Dataset) -> Iterator[Gate]:
    """Say what in the machine file, or in their unit, the recorded positions contradict."""
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
    machine: Machine, data: Dataset, drives: Sequence[str], noise: Array | None
) -> GateReport:
    """Ask what belongs to set-points of position, and to the log as a whole."""
    found = check_streams(data)
    if 'effort' not in compared_of(machine):
        # Signs, sizes and laws below are those of efforts, which such a log need not hold; and a
        # law without an integral part may follow late and stop short.
        return GateReport(tuple(found))
    for drive in drives:
        found += check_effort(machine, data, drive)
    tracking = tracking_of(data, drives)
    apart: list[Gate] = []
    if tracking is not None:
        told = check_tracking(tracking, data.cycle, machine.travel_unit)
        apart = [gate for gate in told if gate.gate == 'offset']
        found += [gate for gate in told if gate.gate != 'offset']
        if any(gate.level == 'fail' and gate not in apart for gate in told):
            # A law that is fed with another drive's motion, or in other units, says nothing new.
            return GateReport((*found, *apart))
    if data.command_position is None:
        # A kind that follows none needs none.
        missed = (NO_COMMAND,) if follows(machine) else ()
        return GateReport((*found, *missed))
    if not (machine.known('position_gain') and machine.known('velocity_gain')):
        return GateReport((*found, *apart))
    laws: list[Law] = []
    said: list[Gate] = []
    for number, drive in enumerate(drives):
        law = fit_law(machine, data, drive, 0.0 if tracking is None else tracking.late(drive))
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
    return GateReport((*found, *apart, *said, *swapped), tuple(laws))
