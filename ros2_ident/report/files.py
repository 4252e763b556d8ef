# SPDX-License-Identifier: Apache-2.0
"""The files of a run by name, and those of an identification but the overlay bag and the page."""

from dataclasses import fields, replace
import json
from pathlib import Path
from typing import Any

import numpy as np

from ros2_ident.errors import ErrorCode
from ros2_ident.files import make_directory, regular, remove_file, write_arrays, write_json
from ros2_ident.identify.problem import Problem
from ros2_ident.identify.result import History, Identification
from ros2_ident.report.schema import from_mapping, intact, to_mapping
from ros2_ident.report.signals import read_arrays, signals_of_problem, write_signals

JSON, HISTORY, SIGNALS = 'result.json', 'history.npz', 'signals.npz'
DIAGNOSIS, DIAGNOSIS_SIGNALS = 'diagnosis.json', 'diagnosis.npz'
# What `ident fleet` and `ident diff` found, and the page that is made of the others.
FLEET, CHANGE, PAGE = 'fleet.json', 'change.json', 'report.html'
# What a run that was cut short goes on from.
CHECKPOINT, DIAGNOSIS_CHECKPOINT = 'identify.checkpoint', 'diagnose.checkpoint'
# What the two commands write, beside the overlay bag.
OF_RESULT = (JSON, HISTORY, SIGNALS, PAGE, CHECKPOINT)
OF_DIAGNOSIS = (DIAGNOSIS, DIAGNOSIS_SIGNALS, PAGE, DIAGNOSIS_CHECKPOINT)


def holds_results(path: str | Path) -> bool:
    """Return whether a directory holds what an identification or a diagnosis wrote."""
    return any((Path(path) / name).exists() for name in (JSON, DIAGNOSIS))


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
