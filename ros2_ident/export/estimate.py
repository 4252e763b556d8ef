# SPDX-License-Identifier: Apache-2.0
"""An estimate read back from the files of a run, whether an identification or a diagnosis."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.models import EffectAt
from ros2_ident.report.diagnosis import effects_in
from ros2_ident.report.files import DIAGNOSIS, JSON, load_diagnosis, load_result, YAML

# Half a 95 % interval in standard deviations.
_HALF = 1.96


@dataclass(frozen=True, eq=False)
class Estimate:
    """Parameters with their uncertainty.

    Attributes:
        values: By name.
        deviations: Standard deviations by name; inf where the log sets no limit.
        fixed: Parameters that were held.
        drives: Drives compared; all where empty.
        settings: What was asked for.
        source: Where the log was.
    """

    values: Mapping[str, float]
    deviations: Mapping[str, float]
    fixed: Mapping[str, float]
    drives: tuple[str, ...]
    settings: Mapping[str, Any]
    source: str

    def effects(self, nominal: Iterable[str]) -> tuple[EffectAt, ...]:
        """Return the effects whose parameters are here beside the nominal ones."""
        return effects_in(self.values, set(nominal))


def read_estimate(path: str | Path) -> Estimate:
    """Return the estimate of a run's directory, of a diagnosis where no other is there, or a file.

    Raises:
        IdentError: NO_DATA or BAD_VALUES as the files' readers; INVALID_GOAL where the estimate
            cannot stand for one machine.
    """
    folder = Path(path)
    whole = not folder.is_dir() or (folder / JSON).exists() or (folder / YAML).exists()
    diagnosis = folder.parent if folder.name == DIAGNOSIS else folder
    if diagnosis == folder and (whole or not (folder / DIAGNOSIS).exists()):
        found = _identified(folder)
    else:
        found = _found(diagnosis)
    several = [name for name in found.values if '@' in name]
    if several:
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            f'{several[0]} is the value of one recording; identify one recording without --each, '
            'or hold it with --fix, and export that',
        )
    broken = [name for name, value in found.values.items() if not math.isfinite(value)]
    if broken:
        raise IdentError(
            ErrorCode.INVALID_GOAL, f'{path} holds no value of {broken[0]}; identify again'
        )
    return found


def _identified(folder: Path) -> Estimate:
    result = load_result(folder)
    return Estimate(
        {p.name: p.value for p in result.parameters},
        {p.name: _deviation(p.low, p.high) for p in result.parameters},
        dict(result.fixed),
        result.drives,
        result.settings,
        result.provenance.source,
    )


def _found(folder: Path) -> Estimate:
    read = load_diagnosis(folder)
    values, settings = read.found.parameters, read.settings
    return Estimate(
        {name: v.value for name, v in values.items()},
        {name: _deviation(v.low, v.high) for name, v in values.items()},
        {name: float(value) for name, value in settings.get('fixed', {}).items()},
        tuple(settings.get('drives', ())),
        settings,
        read.provenance.source,
    )


def _deviation(low: float, high: float) -> float:
    half = 0.5 * (high - low)
    return math.inf if math.isnan(half) else half / _HALF
