# SPDX-License-Identifier: Apache-2.0
"""/diagnostics for the usual monitors: how data, excitation, search, fit, gap and changes are."""

from collections.abc import Mapping, Sequence
import math

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
import numpy as np
from ros2_ident_msgs.msg import Comparison, Gap, IdentificationResult, Progress

from ros2_ident.identify.data import Data
from ros2_ident.recording.motion import count_reversals
from ros2_ident.ros.capture import Capture, StreamMeter
from ros2_ident.ros.conversion import gap_sentence

# Fewer reversals than this leave Coulomb friction and constant loads alike.
_REVERSALS = 4
# Level, message and values of a status.
_Judged = tuple[bytes, str, Mapping[str, object]]
_OK, _WARN, _ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def _text(value: object) -> str:
    if isinstance(value, float):
        return 'unknown' if math.isnan(value) else f'{value:.6g}'
    return str(value)


class Diagnostics:
    """Collects what the node knows, and warns from a share of missing samples on."""

    def __init__(self, name: str, missing_warning: float) -> None:
        self.name = name
        self.missing_warning = missing_warning
        self.excitation: dict[str, tuple[float, float, int]] | None = None
        self.progress: Progress | None = None
        self.result: IdentificationResult | None = None
        self.gap: Gap | None = None
        self.comparison: Comparison | None = None
        self.state = ''

    def message(self, stamp: Time, capture: Capture, silence: str) -> DiagnosticArray:
        """Return the array; `silence` says why nothing arrives."""
        array = DiagnosticArray()
        array.header.stamp = stamp
        for name, (level, text, values) in {
            'data': self._data(capture.meters, capture.topics, silence),
            'excitation': self._excitation(),
            'search': (_OK, self.state, self._search()),
            'fit': self._fit(),
            'gap': self._gap(),
            'comparison': self._comparison(),
        }.items():
            array.status.append(
                DiagnosticStatus(
                    name=f'{self.name}: {name}',
                    level=level,
                    message=text,
                    values=[KeyValue(key=k, value=_text(v)) for k, v in values.items()],
                )
            )
        return array

    def _data(
        self, meters: Mapping[str, StreamMeter], topics: Mapping[str, str], silence: str
    ) -> _Judged:
        values: dict[str, object] = {}
        faults = []
        for role, meter in meters.items():
            numbers = {
                'topic': topics[role],
                'received': meter.received,
                'rate [Hz]': meter.rate,
                'missing fraction': meter.missing_fraction,
                'segments': meter.backward + 1 if meter.received else 0,
            }
            values |= {f'{role}: {name}': number for name, number in numbers.items()}
            if meter.malformed:
                faults.append(f'{meter.malformed} malformed messages on {topics[role]}')
            if meter.dropped:
                faults.append(f'{meter.dropped} messages of {topics[role]} beyond the buffer')
        if silence:
            return _WARN, silence, values
        worst = np.nanmax([0.0, *(meter.missing_fraction for meter in meters.values())])
        if worst > self.missing_warning:
            faults.append(f'{100 * worst:.3g} % of the samples are missing; read the bag directly')
        return _WARN if faults else _OK, '; '.join(faults) or 'complete', values

    def _excitation(self) -> _Judged:
        found = self.excitation
        if found is None:
            return _OK, 'judged at the end of a run', {}
        names = 'travel', 'largest speed', 'reversals'
        values: dict[str, object] = {
            f'{drive}: {name}': number
            for drive, numbers in found.items()
            for name, number in zip(names, numbers, strict=True)
        }
        poor = ', '.join(drive for drive, x in found.items() if x[2] < _REVERSALS)
        if not poor:
            return _OK, 'sufficient', values
        text = f'{poor} reversed fewer than {_REVERSALS} times; friction is poorly determined'
        return _WARN, text, values

    def _search(self) -> dict[str, object]:
        p = self.progress
        if p is None:
            return {}
        return {
            'generation': f'{p.generation}/{p.generations}',
            'evaluations': p.evaluations,
            'evaluations per second': p.evaluations / p.elapsed if p.elapsed else math.nan,
            f'best cost [{p.cost_unit}]': p.best_cost,
            'spread': max(p.spread, default=math.nan),
            'elapsed [s]': p.elapsed,
            'to go [s]': p.eta,
        }

    def _fit(self) -> _Judged:
        r = self.result
        if r is None:
            return _OK, 'nothing identified yet', {}
        values: dict[str, object] = {
            f'{drive}: residual [{r.cost_unit}]': rms
            for drive, rms in zip(r.drives, r.residual_rms, strict=False)
        }
        bound = [p.name for p in r.parameters if p.at_bound]
        loose = [p.name for p in r.parameters if not p.identifiable]
        values['at a bound'] = ', '.join(bound) or 'none'
        values['not identifiable'] = ', '.join(loose) or 'none'
        values |= _numbered(r.warnings)
        if r.error_code:
            return _ERROR, r.error_message, values
        said = str(r.outcome_sentence)
        if r.warnings:
            more = f' ({len(r.warnings) - 1} more)' if len(r.warnings) > 1 else ''
            said += f' Warning: {r.warnings[0]}{more}'
        return _WARN if bound or loose or r.warnings else _OK, said, values

    def _gap(self) -> _Judged:
        g = self.gap
        if g is None:
            return _OK, 'nothing diagnosed yet', {}
        if not g.effect:
            return _ERROR, g.error_message, {}
        values: dict[str, object] = {
            'verdict': _place(g.effect, g.where),
            'probability': g.probability,
            'share closed': g.share_closed,
            'judged on': g.held_out,
        }
        for drive, before, floor in zip(
            g.drives, g.drive_before, g.drive_noise_floor, strict=True
        ):
            values[f'{drive}: gap [{g.unit}]'] = before
            values[f'{drive}: noise floor [{g.unit}]'] = floor
        if g.also:
            values['also'] = ', '.join(_place(a.effect, a.where) for a in g.also)
        values |= _numbered(g.warnings)
        level = _WARN if g.warnings or g.effect != g.EFFECT_NONE else _OK
        contradicted = g.effect in (g.EFFECT_BOOKKEEPING, g.EFFECT_MODEL)
        return _ERROR if contradicted else level, gap_sentence(g), values

    def _comparison(self) -> _Judged:
        c = self.comparison
        if c is None:
            return _OK, 'nothing compared yet', {}
        if not c.sentence:
            return _ERROR, c.error_message, {}
        values = {'explained': c.explained, **_numbered(c.warnings)}
        return _WARN if c.changes or c.warnings else _OK, c.sentence, values


def _numbered(warnings: Sequence[str]) -> dict[str, object]:
    return {f'warning {number}': text for number, text in enumerate(warnings, 1)}


def _place(effect: str, where: Sequence[str]) -> str:
    return f'{effect} on {", ".join(where)}' if where else effect


def excitation(data: Data) -> dict[str, tuple[float, float, int]]:
    """Return each drive's travel, largest speed and number of reversals, over all segments."""
    found: dict[str, tuple[float, float, int]] = {}
    for dataset in data.datasets:
        ways = dataset.position if dataset.command_position is None else dataset.command_position
        for name, way in zip(dataset.names, () if ways is None else ways, strict=False):
            way = way[~np.isnan(way)]
            if len(way) < 3:
                continue
            velocity = np.gradient(way, dataset.cycle)
            travel, speed, turns = found.get(name, (0.0, 0.0, 0))
            found[name] = (
                max(travel, float(np.ptp(way))),
                max(speed, float(np.abs(velocity).max())),
                turns + count_reversals(velocity),
            )
    return found
