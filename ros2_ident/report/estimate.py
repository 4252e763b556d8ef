# SPDX-License-Identifier: Apache-2.0
"""An estimate read back from the files of a run, whether an identification or a diagnosis."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

from ros2_ident.arrays import NORMAL
from ros2_ident.errors import ErrorCode
from ros2_ident.gap.result import Value
from ros2_ident.identify.result import Identification, ParameterEstimate
from ros2_ident.models import EffectAt
from ros2_ident.report.diagnosis import effects_in, Written
from ros2_ident.report.files import DIAGNOSIS, JSON, load_diagnosis, load_result


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
    whole = not folder.is_dir() or (folder / JSON).exists()
    diagnosis = folder.parent if folder.name == DIAGNOSIS else folder
    of: Identification | Written
    known: Mapping[str, ParameterEstimate | Value]
    if diagnosis == folder and (whole or not (folder / DIAGNOSIS).exists()):
        of = load_result(folder)
        known, fixed, drives = {p.name: p for p in of.parameters}, of.fixed, of.drives
    else:
        of = load_diagnosis(diagnosis)
        known, fixed = of.found.parameters, of.settings.get('fixed', {})
        drives = tuple(of.settings.get('drives', ()))
    found = Estimate(
        {name: v.value for name, v in known.items()},
        {name: _deviation(v.low, v.high) for name, v in known.items()},
        {name: float(value) for name, value in fixed.items()},
        drives,
        of.settings,
        of.provenance.source,
    )
    # Without --each an @ belongs to a joint's name.
    several = [name for name in found.values if of.settings.get('each') and '@' in name]
    if several:
        raise ErrorCode.INVALID_GOAL.error(
            f'{several[0]} is the value of one recording; identify one recording without --each, '
            'or hold it with --fix, and export that'
        )
    broken = [name for name, value in found.values.items() if not math.isfinite(value)]
    if broken:
        raise ErrorCode.INVALID_GOAL.error(f'{path} holds no value of {broken[0]}; identify again')
    return found


def _deviation(low: float, high: float) -> float:
    half = 0.5 * (high - low)
    return math.inf if math.isnan(half) else half / NORMAL
