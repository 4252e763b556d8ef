# SPDX-License-Identifier: Apache-2.0
"""/diagnostics for the usual monitors: how data, excitation, search, fit and gap are."""

from collections.abc import Mapping, Sequence
import math

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
import numpy as np
from ros2_ident_msgs.msg import Gap, IdentificationResult, Progress

from ros2_ident.errors import ErrorCode
from ros2_ident.identify.data import Data
from ros2_ident.ros.meter import StreamMeter

# Below this speed, as a share of the fastest, a drive counts as resting.
_SLOW = 0.02
# Fewer reversals than this leave Coulomb friction and constant loads alike.
_REVERSALS = 4


def _status(
    name: str, level: bytes, message: str, values: Mapping[str, object]
) -> DiagnosticStatus:
    return DiagnosticStatus(
        name=name,
        hardware_id='',
        level=level,
        message=message,
        values=[KeyValue(key=key, value=_text(value)) for key, value in values.items()],
    )


def _text(value: object) -> str:
    if isinstance(value, float):
        return 'unknown' if math.isnan(value) else f'{value:.6g}'
    return str(value)


class Diagnostics:
    """Collects what the node knows and makes one array of it.

    Args:
        name: The node's name, first in each status.
        missing_warning: Share of missing samples from which to warn.
    """

    def __init__(self, name: str, missing_warning: float) -> None:
        self.name = name
        self.missing_warning = missing_warning
        self.data: Data | None = None
        self.progress: Progress | None = None
        self.result: IdentificationResult | None = None
        self.gap: Gap | None = None
        self.state = ''

    def message(
        self,
        stamp: Time,
        meters: Mapping[str, StreamMeter],
        topics: Mapping[str, str],
        silence: str,
    ) -> DiagnosticArray:
        """Return the array.

        Args:
            stamp: Of the message, node clock.
            meters: How the streams arrive, by role.
            topics: Their topics, by role.
            silence: Why nothing arrives; empty where something does.
        """
        array = DiagnosticArray()
        array.header.stamp = stamp
        array.status = [
            self._data(meters, topics, silence),
            self._excitation(),
            self._search(),
            self._fit(),
            self._gap(),
        ]
        return array

    def _data(
        self, meters: Mapping[str, StreamMeter], topics: Mapping[str, str], silence: str
    ) -> DiagnosticStatus:
        values: dict[str, object] = {}
        worst = 0.0
        faults = []
        for role, meter in meters.items():
            values[f'{role}: topic'] = topics[role]
            values[f'{role}: received'] = meter.received
            values[f'{role}: rate [Hz]'] = meter.rate
            values[f'{role}: missing fraction'] = meter.missing_fraction
            values[f'{role}: segments'] = meter.backward + 1 if meter.received else 0
            values[f'{role}: latency p50 [ms]'] = 1e3 * meter.latency(50)
            values[f'{role}: latency p99 [ms]'] = 1e3 * meter.latency(99)
            if meter.missing_fraction > worst:
                worst = meter.missing_fraction
            if meter.malformed:
                faults.append(f'{meter.malformed} malformed messages on {topics[role]}')
            if meter.dropped:
                faults.append(f'{meter.dropped} messages of {topics[role]} beyond the buffer')
        if silence:
            return _status(f'{self.name}: data', DiagnosticStatus.WARN, silence, values)
        if worst > self.missing_warning:
            faults.append(f'{100 * worst:.3g} % of the samples are missing; read the bag directly')
        level = DiagnosticStatus.WARN if faults else DiagnosticStatus.OK
        return _status(f'{self.name}: data', level, '; '.join(faults) or 'complete', values)

    def _excitation(self) -> DiagnosticStatus:
        name = f'{self.name}: excitation'
        if self.data is None:
            return _status(name, DiagnosticStatus.OK, 'judged at the end of a run', {})
        values: dict[str, object] = {}
        poor = []
        for drive, (travel, speed, reversals) in excitation(self.data).items():
            values[f'{drive}: travel'] = travel
            values[f'{drive}: largest speed'] = speed
            values[f'{drive}: reversals'] = reversals
            if reversals < _REVERSALS:
                poor.append(drive)
        if poor:
            text = (
                f'{", ".join(poor)} reversed fewer than {_REVERSALS} times; friction is poorly '
                'determined'
            )
            return _status(name, DiagnosticStatus.WARN, text, values)
        return _status(name, DiagnosticStatus.OK, 'sufficient', values)

    def _search(self) -> DiagnosticStatus:
        values: dict[str, object] = {}
        if self.progress is not None:
            p = self.progress
            values = {
                'generation': f'{p.generation}/{p.generations}',
                'evaluations': p.evaluations,
                'evaluations per second': p.evaluations / p.elapsed if p.elapsed else math.nan,
                f'best cost [{p.cost_unit}]': p.best_cost,
                'spread': max(p.spread, default=math.nan),
                'elapsed [s]': p.elapsed,
                'to go [s]': p.eta,
            }
        return _status(f'{self.name}: search', DiagnosticStatus.OK, self.state, values)

    def _fit(self) -> DiagnosticStatus:
        name = f'{self.name}: fit'
        if self.result is None:
            return _status(name, DiagnosticStatus.OK, 'nothing identified yet', {})
        r = self.result
        values: dict[str, object] = {
            f'{drive}: residual [{r.cost_unit}]': rms
            for drive, rms in zip(r.drives, r.residual_rms, strict=False)
        }
        bound = [p.name for p in r.parameters if p.at_bound]
        loose = [p.name for p in r.parameters if not p.identifiable]
        values['at a bound'] = ', '.join(bound) or 'none'
        values['not identifiable'] = ', '.join(loose) or 'none'
        values |= _numbered(r.warnings)
        level = DiagnosticStatus.OK
        if r.error_code:
            level = DiagnosticStatus.ERROR
        elif bound or loose or r.warnings:
            level = DiagnosticStatus.WARN
        return _status(name, level, r.error_message or _with_first(r), values)

    def _gap(self) -> DiagnosticStatus:
        name = f'{self.name}: gap'
        g = self.gap
        if g is None:
            return _status(name, DiagnosticStatus.OK, 'nothing diagnosed yet', {})
        if not g.effect:
            return _status(name, DiagnosticStatus.ERROR, g.error_message, {})
        values: dict[str, object] = {
            'verdict': _place(g.effect, g.where),
            'probability': g.probability,
            'share closed': g.share_closed,
            'judged on': g.held_out,
        }
        largest, text = -1.0, 'no gap is known'
        for drive, before, floor in zip(
            g.drives, g.drive_before, g.drive_noise_floor, strict=True
        ):
            values[f'{drive}: gap [{g.unit}]'] = before
            values[f'{drive}: noise floor [{g.unit}]'] = floor
            if before > largest * floor:
                largest = before / floor if floor > 0.0 else math.inf
                text = f'largest gap {before:.3g} {g.unit} on {drive}, {largest:.2g} x the noise'
        if g.also:
            values['also'] = ', '.join(_place(a.effect, a.where) for a in g.also)
        values |= _numbered(g.warnings)
        if g.effect in (g.EFFECT_BOOKKEEPING, g.EFFECT_MODEL):
            return _status(name, DiagnosticStatus.ERROR, g.sentence, values)
        if g.error_code == ErrorCode.CANCELLED:
            text += '; cancelled'
        if g.effect == g.EFFECT_NONE:
            level = DiagnosticStatus.WARN if g.warnings else DiagnosticStatus.OK
            return _status(name, level, g.sentence, values)
        missing = 'something not in the catalogue'
        if g.effect != g.EFFECT_UNKNOWN:
            missing = _place(g.effect, g.where)
        elif g.error_code:
            missing = 'not found by then'
        return _status(name, DiagnosticStatus.WARN, f'{text}; missing: {missing}', values)


def _numbered(warnings: Sequence[str]) -> dict[str, object]:
    """Return warnings as values of a status."""
    return {f'warning {number}': text for number, text in enumerate(warnings, 1)}


def _with_first(result: IdentificationResult) -> str:
    """Return a result's sentence and, where there are some, the first of its warnings."""
    count = len(result.warnings)
    if not count:
        return str(result.outcome_sentence)
    more = f' ({count - 1} more)' if count > 1 else ''
    return f'{result.outcome_sentence} Warning: {result.warnings[0]}{more}'


def _place(effect: str, where: Sequence[str]) -> str:
    return f'{effect} on {", ".join(where)}' if where else effect


def excitation(data: Data) -> dict[str, tuple[float, float, int]]:
    """Return each drive's travel, largest speed and number of reversals, over all segments."""
    found: dict[str, tuple[float, float, int]] = {}
    for dataset in data.datasets:
        path = (
            dataset.command_position if dataset.command_position is not None else dataset.position
        )
        if path is None:
            continue
        for name, row in zip(dataset.names, path, strict=True):
            row = row[~np.isnan(row)]
            if len(row) < 3:
                continue
            speed = np.diff(row) / dataset.cycle
            fastest = float(np.abs(speed).max())
            moving = np.sign(speed[np.abs(speed) > _SLOW * fastest])
            travel, before, turns = found.get(name, (0.0, 0.0, 0))
            found[name] = (
                max(travel, float(row.max() - row.min())),
                max(before, fastest),
                turns + int((np.diff(moving) != 0).sum()),
            )
    return found
