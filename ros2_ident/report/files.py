# SPDX-License-Identifier: Apache-2.0
"""The files of a run, all but the overlay bag and the page.

An identification: `result.json`, `history.npz`, `signals.npz`. A diagnosis:
`diagnosis.json`, `diagnosis.npz`, and lines for the machine file that bring in what was found.
An estimate is read back from either.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from ros2_ident.arrays import NORMAL
from ros2_ident.change.result import Between, Comparison
from ros2_ident.effects import CATALOGUE
from ros2_ident.errors import ErrorCode
from ros2_ident.files import make_directory, regular, remove_file, write_arrays, write_json
from ros2_ident.gap.result import Cause, Diagnosis, Value
from ros2_ident.identify.data import Data
from ros2_ident.identify.outcome import provenance_of
from ros2_ident.identify.problem import Problem
from ros2_ident.identify.result import History, Identification, Outcome, ParameterEstimate
from ros2_ident.machine.keys import digits
from ros2_ident.machine.prior import Prior
from ros2_ident.models import EffectAt, Machine
from ros2_ident.models.drives.candidates import SLOTS
from ros2_ident.models.registry import KINDS
from ros2_ident.report.diagnosis import effects_in, SCHEMA, Written
from ros2_ident.report.diagnosis import from_mapping as diagnosis_from
from ros2_ident.report.diagnosis import to_mapping as diagnosis_mapping
from ros2_ident.report.schema import from_mapping, intact, read, to_mapping
from ros2_ident.report.signals import (
    read_arrays,
    signals_of_diagnosis,
    signals_of_problem,
    write_signals,
)
from ros2_ident.words.verdict import named, sentence

JSON, HISTORY, SIGNALS = 'result.json', 'history.npz', 'signals.npz'
DIAGNOSIS, DIAGNOSIS_SIGNALS = 'diagnosis.json', 'diagnosis.npz'
# What `ident fleet` and `ident diff` found, and the page that is made of the others.
FLEET, CHANGE, PAGE = 'fleet.json', 'change.json', 'report.html'
# What a run that was cut short goes on from.
CHECKPOINT, DIAGNOSIS_CHECKPOINT = 'identify.checkpoint', 'diagnose.checkpoint'
# What the two commands write, beside the overlay bag.
OF_RESULT = (JSON, HISTORY, SIGNALS, PAGE, CHECKPOINT)
OF_DIAGNOSIS = (DIAGNOSIS, DIAGNOSIS_SIGNALS, PAGE, DIAGNOSIS_CHECKPOINT)
# Causes after which no parameter of a diagnosis counts as known.
_UNSOUND = {Cause.CUT_SHORT, Cause.LOG, Cause.CONSTANT, Cause.MODEL, Cause.EVENTS}


def write_diagnosis(
    directory: str | Path,
    found: Diagnosis,
    machine: Machine,
    fit: Data,
    check: Data | None = None,
    settings: Mapping[str, object] | None = None,
) -> tuple[Path, Path]:
    """Write a diagnosis.

    Args:
        directory: Exists.
        fit: The recordings fitted to.
        check: The recordings it was judged on; None where those are blocks of the others.

    Returns:
        `diagnosis.json`, and `diagnosis.npz` with measured and simulated effort.
    """
    folder = Path(directory)
    data = {
        'format': 'ros2_ident.diagnosis',
        **diagnosis_mapping(found),
        'machine_lines': list(machine_lines(found, machine)),
        'settings': dict(settings or {}),
        'provenance': {
            **asdict(provenance_of(machine, fit)),
            'check_source': check.source if check else '',
            'check_sha256': check.sha256 if check else '',
        },
    }
    remove_file(folder / DIAGNOSIS_SIGNALS)  # nothing old beside the new after a crash
    return (
        write_json(folder / DIAGNOSIS, data),
        write_signals(folder / DIAGNOSIS_SIGNALS, signals_of_diagnosis(found)),
    )


def write_change(directory: str | Path, found: Comparison, asked: Mapping[str, object]) -> Path:
    """Write `change.json` into a directory that exists, with what was asked for."""
    data = {'format': 'ros2_ident.change', 'version': 1, **asdict(found), 'settings': dict(asked)}
    return write_json(Path(directory) / CHANGE, data)


def compared(rows: Iterable[Mapping[str, Any]]) -> list[Between]:
    """Return the comparisons among the rows of a fleet."""
    return [read(Between, row) for row in rows if 'found' in row]


def holds_results(path: str | Path) -> bool:
    """Return whether a directory holds what an identification or a diagnosis wrote."""
    return any((Path(path) / name).exists() for name in (JSON, DIAGNOSIS))


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


def load_diagnosis(directory: str | Path) -> Written:
    """Read what `write_diagnosis` wrote into `diagnosis.json`.

    Raises:
        IdentError: NO_DATA where there is none, BAD_VALUES where it cannot be read.
    """
    path = Path(directory) / DIAGNOSIS
    data = content(path, '`ident diagnose --out` wrote')
    if not isinstance(data, dict) or 'verdict' not in data or data.get('schema') != SCHEMA:
        raise ErrorCode.BAD_VALUES.error(
            f'{path}: is no diagnosis of version {SCHEMA}; write it anew with `ident diagnose`'
        )
    with intact(path):
        return diagnosis_from(data)


def write_result(
    directory: str | Path,
    result: Identification,
    problem: Problem | None = None,
    check: Problem | None = None,
) -> tuple[Path, ...]:
    """Write a result.

    Args:
        directory: Is made where it does not exist; older results in it are replaced.
        problem: What it solves, to write measured and simulated effort as well.
        check: The same problem on recordings that were held out.

    Returns:
        The files: the result as JSON, the candidates of the search as NPZ, and the
        efforts as NPZ where there is a problem and a candidate that did not diverge.

    Raises:
        IdentError: INVALID_GOAL where the directory cannot be written to.
    """
    folder = make_directory(directory)
    for old in (HISTORY, SIGNALS):  # nothing of it beside the new after a crash
        remove_file(folder / old)
    names = np.array([p.name for p in result.parameters])
    files = (
        write_json(folder / JSON, to_mapping(result), indent=2),
        write_arrays(folder / HISTORY, {'names': names, **vars(result.history)}),
    )
    if problem is None or not np.isfinite(result.theta).all():
        return files
    signals = signals_of_problem(problem, result.theta, check)
    return (*files, write_signals(folder / SIGNALS, signals))


def load_result(path: str | Path) -> Identification:
    """Read a result.

    Args:
        path: The directory `write_result` wrote to, or its JSON file.

    Returns:
        The result, with the candidates of the search where `history.npz` lies beside it.

    Raises:
        IdentError: NO_DATA where there is no result, BAD_VALUES where it cannot be read.
    """
    path = Path(path)
    if path.is_dir():
        path = path / JSON
    result = from_mapping(content(path, '`ident identify` wrote'), path)
    if not (history := path.with_name(HISTORY)).exists():
        return result
    arrays = read_arrays(history, 'the result stays readable')
    with intact(history):
        held = History(**{f.name: arrays[f.name] for f in fields(History)})
    return replace(result, history=held)


def content(path: Path, whose: str) -> Any:
    """Return what a file of JSON holds.

    Raises:
        IdentError: NO_DATA or BAD_VALUES, with whose directory is wanted.
    """
    try:
        with regular(path) as file:
            return json.loads(file.read().decode())
    except OSError as exc:
        raise ErrorCode.NO_DATA.error(
            f'{path}: cannot be read ({exc.strerror}); give a directory that {whose}'
        ) from None
    except (ValueError, RecursionError) as exc:
        said = ' '.join(str(exc).split())
        raise ErrorCode.BAD_VALUES.error(
            f'{path}: is damaged ({said}); write the result anew'
        ) from None


def machine_lines(found: Diagnosis, machine: Machine) -> tuple[str, ...]:
    """Return YAML for the machine file.

    Returns:
        Lines by section; none where no effect was found or the machine file has no key for it. A
        constant gets its new value. What the file does not know becomes a parameter to identify,
        searched up to twice the size found.
    """
    sections: dict[str, list[str]] = {}
    for at in named(found):
        for section, line in _lines(found, machine, at):
            sections.setdefault(section, []).append(line)
    return tuple(
        line for name, lines in sections.items() for line in (f'{name}:', *dict.fromkeys(lines))
    )


def _lines(found: Diagnosis, machine: Machine, at: EffectAt) -> Iterator[tuple[str, str]]:
    effect = CATALOGUE.get(at.effect)
    if effect is None or machine.kind not in KINDS:
        return
    size = next(p for p in effect.parameters if p.role == 'size')
    value = found.parameters.get(f'{at.prefix}{size.name}')
    if value is None or not math.isfinite(value.value):
        return
    # What fills the row of the kernel on which the effect acts.
    names = [name for name, slot in SLOTS.items() if size.target and slot.row == size.target]
    if any(name in machine.bounds for name in names):
        return
    keys = [key for key in KINDS[machine.kind].keys if key.name in names]
    for key in keys:
        if not key.constant:
            continue
        # its new value, of each drive where the effect sits on one
        old = machine.numbers(key.name).tolist()
        new = [
            (x * value.value if size.how == 'scale' else x + value.value)
            if at.where in ('all', drive)
            else x
            for drive, x in zip(machine.drives, old, strict=True)
        ]
        if all(map(math.isfinite, new)):
            said = [digits(float(f'{x:.5g}')) for x in new]
            text = said[0] if len(set(said)) == 1 else f'[{", ".join(said)}]'
            before = ', '.join(dict.fromkeys(digits(x) for x in old))
            yield key.section, f'  {key.name}: {text}  # {before} before'
        return
    fitting = [k for k in keys if value.unit in (k.unit, k.force_unit)]
    if fitting:
        key = max(fitting, key=lambda k: k.unit == value.unit)
        reach = digits(float(f'{2.0 * abs(value.value):.2g}'))
        low = f'-{reach}' if value.value < 0.0 else '0.0'
        yield key.section, f'  {key.name}: [{low}, {reach}, {value.unit}]'


@dataclass(frozen=True, eq=False)
class Estimate:
    """Parameters with their uncertainty.

    Attributes:
        deviations: Standard deviations by name; inf where the log sets no limit.
        drives: Drives compared; all where empty.
        source: Where the log was.
        prior: What a later run may take as known.
        doubt: Why it may not; empty where it may.
    """

    values: Mapping[str, float]
    deviations: Mapping[str, float]
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
        doubt = sentence(of.found) if of.found.facts.cause in _UNSOUND else ''
    deviations = {name: _deviation(v.low, v.high) for name, v in known.items()}
    noise = {name: _deviation(v.noise_low, v.noise_high) for name, v in known.items()}
    # Not every number of a diagnosis has an interval by noise.
    noise = {name: min(noise[name], x) for name, x in deviations.items()}
    found = Estimate(
        {name: v.value for name, v in known.items()},
        deviations,
        {name: float(value) for name, value in fixed.items()},
        drives,
        of.settings,
        of.provenance.source,
        Prior(
            str(path), of.provenance.sha256, {name: v.value for name, v in known.items()},
            deviations, noise, {name: v.unit for name, v in known.items()},
            tuple(map(tuple, correlation.tolist())),
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
