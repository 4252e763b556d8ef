# SPDX-License-Identifier: Apache-2.0
"""An earlier result, of an identification, a diagnosis or both, as what is known of a machine."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
import math
from pathlib import Path
from typing import Any

import numpy as np

from ros2_ident.arrays import NORMAL
from ros2_ident.effects import CATALOGUE
from ros2_ident.errors import ErrorCode
from ros2_ident.gap.result import Cause, Value
from ros2_ident.identify.result import Identification, Outcome, ParameterEstimate
from ros2_ident.machine.prior import Prior
from ros2_ident.models import EffectAt
from ros2_ident.report.diagnosis import effects_in, load_diagnosis, Written
from ros2_ident.report.files import DIAGNOSIS, holds_results, JSON, load_result
from ros2_ident.words.verdict import sentence

# Causes after which no parameter of a diagnosis counts as known.
_UNSOUND = {Cause.CUT_SHORT, Cause.LOG, Cause.CONSTANT, Cause.MODEL, Cause.EVENTS}


def load(directory: str | Path) -> tuple[Identification | None, Written | None]:
    """Read the identification and the diagnosis of a directory; None for one that it lacks.

    Raises:
        IdentError: NO_DATA where it holds neither, BAD_VALUES where a file cannot be read.
    """
    folder = Path(directory)
    if not holds_results(folder):
        raise ErrorCode.NO_DATA.error(
            f'{folder}: holds neither {JSON} nor {DIAGNOSIS}; give a directory that '
            '`ident identify` or `ident diagnose` wrote'
        )
    result = load_result(folder) if (folder / JSON).exists() else None
    return result, load_diagnosis(folder) if (folder / DIAGNOSIS).exists() else None


@dataclass(frozen=True, eq=False)
class Estimate:
    """Parameters with their uncertainty.

    Attributes:
        drives: Drives compared; all where empty.
        prior: What a later run may take as known.
        doubt: Why it may not; empty where it may.
    """

    values: Mapping[str, float]
    fixed: Mapping[str, float]
    drives: tuple[str, ...]
    settings: Mapping[str, Any]
    source: str
    prior: Prior = field(default_factory=Prior)
    doubt: str = ''

    def effects(self, nominal: Iterable[str]) -> tuple[EffectAt, ...]:
        """Return the effects whose parameters are here beside the nominal ones."""
        return effects_in(self.values, set(nominal))

    @property
    def catalogued(self) -> tuple[EffectAt, ...]:
        """Effects of the catalogue whose parameters are here."""
        found = self.effects(name for name in self.values if '.' not in name)
        return tuple(at for at in found if at.effect in CATALOGUE)


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
        correlation = of.correlation
        doubt = 'several minima fit almost alike' if of.rival else ''
        if of.outcome not in (Outcome.IDENTIFIED, Outcome.NOT_IDENTIFIABLE):
            doubt = of.outcome.value
    else:
        of = load_diagnosis(diagnosis)
        # Numbers of the machine file are none of its parameters.
        stated = {c.key for c in of.found.facts.constants}
        known = {n: v for n, v in of.found.parameters.items() if n not in stated}
        fixed = of.settings.get('fixed', {})
        drives = tuple(of.settings.get('drives', ()))
        correlation = np.full((len(known), len(known)), np.nan)
        count = len(of.found.correlation)
        correlation[:count, :count] = of.found.correlation
        doubt = sentence(of.found) if of.found.facts.cause in _UNSOUND else ''
    values = {name: v.value for name, v in known.items()}
    deviations = {name: _deviation(v.low, v.high) for name, v in known.items()}
    noise = {name: _deviation(v.noise_low, v.noise_high) for name, v in known.items()}
    # Not every number of a diagnosis has an interval by noise.
    noise = {name: min(noise[name], x) for name, x in deviations.items()}
    found = Estimate(
        values,
        {name: float(value) for name, value in fixed.items()},
        drives,
        of.settings,
        of.provenance.source,
        Prior(
            str(path), of.provenance.sha256, values, deviations, noise,
            {name: v.unit for name, v in known.items()}, tuple(map(tuple, correlation.tolist())),
        ),
        doubt,
    )  # fmt: skip
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
    """Return the standard deviation behind a 95 % interval; inf where it is not known."""
    return math.inf if math.isnan(high - low) else 0.5 * (high - low) / NORMAL
