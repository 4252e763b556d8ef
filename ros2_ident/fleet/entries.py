# SPDX-License-Identifier: Apache-2.0
"""The list of a fleet: which bags of which machines."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import os
from pathlib import Path
import re
from typing import Any

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import read_yaml
from ros2_ident.identify.layout import Conditions
from ros2_ident.identify.settings import IdentifySettings
from ros2_ident.recording import Topics

_LARGEST = 1 << 24  # of a list, bytes
# What was found in a bag, as its file holds it.
Row = dict[str, Any]
_KEYS = {'bag', 'check', 'machine_file', 'machine', 'date', 'labels'}


@dataclass(frozen=True)
class Wish:
    """How every bag of a fleet is run; fields as of a `jobs.Request`.

    Attributes:
        diagnosed: Whether to diagnose, too.
    """

    diagnosed: bool = True
    topics: Topics = field(default_factory=Topics)
    conditions: Conditions = Conditions()
    fixed: Mapping[str, float] = field(default_factory=dict)
    settings: IdentifySettings = field(default_factory=IdentifySettings)
    seed: int = 1


@dataclass(frozen=True)
class Entry:
    """One bag of a fleet.

    Attributes:
        name: Of its row and file; unique.
        bag: Path of the bag. All paths are absolute: a worker may run in another folder.
        machine_file: Path of the machine file.
        check: Path of a second bag to judge the diagnosis on; empty for none.
        more: Paths of further bags of the same machine, for the same fit.
        machine: Which machine it was recorded on.
        date: When, in a form that sorts, as 2026-01-31; empty where unknown.
        labels: Whatever else the list says.
    """

    name: str
    bag: str
    machine_file: str
    check: str = ''
    machine: str = ''
    date: str = ''
    labels: Mapping[str, str] = field(default_factory=dict)
    more: tuple[str, ...] = ()


def read_fleet(path: str | Path, machine_file: str | None = None) -> list[Entry]:
    """Read a list file, or take the bags of a directory.

    Args:
        path: A YAML file, paths in it relative to it, or a directory of bags.
        machine_file: For bags whose entry names none.

    Returns:
        The entries, in the order of the list or of their names.

    Raises:
        IdentError: NO_DATA or INVALID_GOAL naming the entry and the remedy.
    """
    path = Path(path)
    if path.is_dir():
        bags = sorted(x for x in path.iterdir() if _is_bag(x))
        listed: Any = [{'bag': x.name, 'machine': x.stem} for x in bags]
        base = path
    else:
        base = path.parent
        try:
            content = read_yaml(path, _LARGEST)
        except ValueError as error:
            raise IdentError(
                ErrorCode.NO_DATA,
                f'{path}: {error}; give a YAML list of bags or a directory of them',
            ) from None
        listed = content.get('bags') if isinstance(content, Mapping) else None
        if isinstance(content, Mapping) and 'machine_file' in content:
            machine_file = str(base / str(content['machine_file']))
    if not isinstance(listed, list) or not listed:
        raise IdentError(
            ErrorCode.NO_DATA, f'{path}: holds no bag; write them in a list below `bags:`'
        )
    entries: list[Entry] = []
    for number, given in enumerate(listed, 1):
        entries.append(_entry(path, base, number, given, machine_file, entries))
    return entries


def _is_bag(path: Path) -> bool:
    return path.suffix in ('.mcap', '.db3', '.bag') or (
        path.is_dir() and any(x.suffix in ('.mcap', '.db3', '.zstd') for x in path.iterdir())
    )


def _entry(
    path: Path,
    base: Path,
    number: int,
    given: Any,
    machine_file: str | None,
    before: Sequence[Entry],
) -> Entry:
    where = f'{path}: entry {number}'
    if not isinstance(given, Mapping) or not given.get('bag') or set(given) - _KEYS:
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            f'{where} is not understood; give it `bag`, and of {", ".join(sorted(_KEYS))} what '
            'you know',
        )
    own = given.get('machine_file')
    file = str(base / str(own)) if own else machine_file
    if not file:
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            f'{where} names no machine file; add `machine_file` to it or to the list, or give '
            '--machine',
        )
    bag, *more = map(str, given['bag'] if isinstance(given['bag'], list) else [given['bag']])
    stem = re.sub(r'[^\w.-]+', '_', bag).strip('._') or 'bag'
    taken = {x.name for x in before}
    name = next(n for n in (stem, *(f'{stem}_{k}' for k in range(2, 10**6))) if n not in taken)
    return Entry(
        name,
        os.path.abspath(base / bag),
        os.path.abspath(file),
        os.path.abspath(base / str(given['check'])) if given.get('check') else '',
        str(given.get('machine') or Path(bag).stem),
        str(given.get('date') or ''),
        {str(k): str(v) for k, v in (given.get('labels') or {}).items()},
        tuple(os.path.abspath(base / x) for x in more),
    )
