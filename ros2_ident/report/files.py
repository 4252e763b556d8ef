# SPDX-License-Identifier: Apache-2.0
"""The files of a run: `result.json`, `result.yaml`, `history.npz`, `diagnosis.json`."""

from collections.abc import Mapping
from dataclasses import replace
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.report.schema import from_mapping, to_mapping
from ros2_ident.result import History, Identification

JSON, YAML, HISTORY = 'result.json', 'result.yaml', 'history.npz'
DIAGNOSIS = 'diagnosis.json'


def make_directory(path: str | Path) -> Path:
    """Make the directory results go to, with its parents.

    Raises:
        IdentError: INVALID_GOAL where something else is there or it cannot be written to.
    """
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            f'{path}: cannot be made ({exc.strerror}); give another directory for the results',
        ) from None
    if not os.access(path, os.W_OK):
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            f'{path}: cannot be written to; give another directory for the results',
        )
    return path


def _replace(path: Path, text: str) -> Path:
    """Write a file such that a reader finds the old or the new one, never half of one."""
    partial = path.with_name(path.name + '.partial')
    partial.write_text(text, encoding='utf-8')
    return partial.replace(path)


def write_diagnosis(directory: str | Path, content: Mapping[str, Any]) -> Path:
    """Write a diagnosis.

    Args:
        directory: Exists.
        content: From `gap.diagnosis.to_mapping`.

    Returns:
        The file, `diagnosis.json`.
    """
    text = json.dumps(content, indent=1, allow_nan=False) + '\n'
    return _replace(Path(directory) / DIAGNOSIS, text)


def write_result(directory: str | Path, result: Identification) -> tuple[Path, ...]:
    """Write a result.

    Args:
        directory: Is made where it does not exist; older results in it are replaced.
        result: The result.

    Returns:
        The files: JSON and YAML of the same content, and the candidates of the search as NPZ.

    Raises:
        IdentError: INVALID_GOAL where the directory cannot be written to.
    """
    folder = make_directory(directory)
    data = to_mapping(result)
    history = folder / HISTORY
    partial = history.with_name(HISTORY + '.partial')
    with partial.open('wb') as file:
        np.savez_compressed(
            file,
            allow_pickle=False,
            names=np.array([p.name for p in result.parameters]),
            best_costs=result.history.best_costs,
            candidates=result.history.candidates,
            costs=result.history.costs,
            generations=result.history.generations,
        )
    partial.replace(history)
    return (
        _replace(folder / JSON, json.dumps(data, indent=2, allow_nan=False) + '\n'),
        _replace(folder / YAML, yaml.safe_dump(data, sort_keys=False, width=99)),
        history,
    )


def load_result(path: str | Path) -> Identification:
    """Read a result.

    Args:
        path: The directory `write_result` wrote to, or its JSON or YAML file.

    Returns:
        The result, with the candidates of the search where `history.npz` lies beside it.

    Raises:
        IdentError: NO_DATA where there is no result, BAD_VALUES where it cannot be read.
    """
    path = Path(path)
    if path.is_dir():
        path = path / (JSON if (path / JSON).exists() else YAML)
    try:
        text = path.read_text(encoding='utf-8')
    except OSError as exc:
        raise IdentError(
            ErrorCode.NO_DATA,
            f'{path}: cannot be read ({exc.strerror}); '
            'give a directory that `ident identify` wrote',
        ) from None
    except UnicodeDecodeError:
        raise IdentError(ErrorCode.BAD_VALUES, f'{path}: is no text; give a result file') from None
    result = from_mapping(_parsed(path, text), path)
    history = path.with_name(HISTORY)
    return replace(result, history=_history(history)) if history.exists() else result


def _parsed(path: Path, text: str) -> Any:
    try:
        return json.loads(text) if path.suffix == '.json' else yaml.safe_load(text)
    except (ValueError, yaml.YAMLError) as exc:
        said = ' '.join(str(exc).split())
        raise IdentError(
            ErrorCode.BAD_VALUES, f'{path}: is damaged ({said}); write the result anew'
        ) from None


def _history(path: Path) -> History:
    try:
        with np.load(path, allow_pickle=False) as file:
            return History(
                file['best_costs'], file['candidates'], file['costs'], file['generations']
            )
    except Exception as exc:  # zipfile, zlib and numpy each have their own
        raise IdentError(
            ErrorCode.BAD_VALUES,
            f'{path}: is damaged ({exc}); delete it, the result stays readable',
        ) from None
