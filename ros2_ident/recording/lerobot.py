# SPDX-License-Identifier: Apache-2.0
"""LeRobot folders, v2.1 and v3: one episode a recording, in units that are not stated."""

from collections.abc import Container, Iterator, Mapping
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from ros2_ident.errors import ErrorCode
from ros2_ident.files import read_small
from ros2_ident.recording.builder import RecordingBuilder
from ros2_ident.recording.limits import listed, printable, require_memory
from ros2_ident.recording.storage import damaged, digest
from ros2_ident.recording.streams import FloatArray, IntArray, Recording, ROLES

# Ends of each joint's travel by its name: low and high, rad.
Travel = Mapping[str, tuple[float, float]]

INFO = Path('meta/info.json')
# What positions can be: LeRobot's three, and radians, which its simulated robots log.
UNITS = {'rad': 'radians', 'deg': 'degrees', 'percent': '-100 to 100 of the travel'}
# What LeRobot's drivers turn into 0 to 100, whatever the unit of the other joints.
_GRIPPER = 'gripper'
# Counts of a turn, less one, as LeRobot's drivers divide.
_COUNTS = 4095
# Role and field of a feature, and of what its names end in.
_FEATURES = {
    'observation.state': ('state', 'position'),
    'observation.velocity': ('state', 'velocity'),
    'observation.effort': ('effort', 'effort'),
    'action': ('command', 'position'),
}
_ENDINGS = {'pos': 'position', 'vel': 'velocity'} | dict.fromkeys(
    ('effort', 'torque', 'current', 'load'), 'effort'
)
# Beyond its ends by this share of its travel a joint is not; through less of it none is moved.
_BEYOND, _MOVED = 0.05, 0.04
# What JSON of another content raises: a number may be too large for a float, too.
_UNFIT = (LookupError, TypeError, ValueError, AttributeError, RecursionError, OverflowError)
# Without ends: what is farther off than this was not logged in rad.
_TURN = 1.1 * math.tau


# What a number is: role, joint and field; and where it stands: feature and place.
_Columns = dict[tuple[str, str, str], tuple[str, int]]


def is_lerobot(path: Path) -> bool:
    """Say whether a path is a LeRobot folder."""
    return (path / INFO).is_file()


def read_lerobot(
    path: Path,
    roles: Container[str] = ROLES,
    unit: str = '',
    calibration: str = '',
    travel: Travel | None = None,
) -> list[Recording]:
    """Read the episodes of a LeRobot folder.

    Args:
        path: The folder with `meta/info.json`.
        roles: What to read: `state`, `effort`, and `command` for the action.
        unit: Of positions, one of `UNITS`; where empty, the one in which they stay within the
            ends of their joints.
        calibration: LeRobot's calibration file of the robot, which says how far joints turn.
        travel: Ends of the machine's joints, where its description has any.

    Returns:
        One recording an episode, positions in rad.

    Raises:
        IdentError: NO_DATA, MISSING_STREAM, DAMAGED_BAG or BAD_VALUES; WRONG_UNITS where more than
            one unit is possible, or none.
    """
    rate, columns = _described(path, roles)
    files = sorted(filter(Path.is_file, path.glob('data/*/*.parquet')))
    if not files:
        text = f'{path}: holds no data/*/*.parquet; fetch or record it again'
        raise ErrorCode.NO_DATA.error(text)
    parts = [_values(file, columns) for file in files]
    episode, frame, values = (np.concatenate(x) for x in zip(*parts, strict=True))
    ends = {**(travel or {}), **(_calibrated(Path(calibration)) if calibration else {})}
    said = _in_rad(path, unit, columns, values, ends)
    numbers = np.unique(episode)
    total = digest([path / INFO, *files])
    found = []
    for number in numbers.tolist():
        rows = np.flatnonzero(episode == number)
        rows = rows[np.argsort(frame[rows], kind='stable')]
        source = f'{path}/episode_{number:06d}' if numbers.size > 1 else str(path)
        builder = RecordingBuilder(source, total)
        clock = f'the number of the frame over {rate:g} Hz'
        builder.warn(f'LeRobot stamps are {clock}: jitter cannot be seen')
        for sentence in said:
            builder.warn(sentence)
        stamp = np.round(frame[rows] * (1e9 / rate)).astype(np.int64)
        builder.add_columns(stamp, dict(zip(columns, values[rows].T, strict=True)))
        found += builder.build()
    return found


def _described(path: Path, roles: Container[str]) -> tuple[float, _Columns]:
    """Return the rate, Hz, and what is read, by `meta/info.json`."""
    file = path / INFO
    try:
        info = json.loads(read_small(file, 1 << 22))
        version, rate = str(info['codebase_version']), float(info['fps'])
        features = {k: v for k, v in info['features'].items() if k in _FEATURES}
        pairs = [x for k, v in features.items() for x in _columns(k, v) if x[0][0] in roles]
    except _UNFIT as exc:
        text = f'is no description of a LeRobot folder ({printable(str(exc), 80)})'
        raise damaged(file, f'{text}; fetch it again') from None
    if not version.startswith(('v2.', 'v3.')) or not 0.0 < rate < 1e6:
        raise damaged(file, f'says {printable(version)} at {rate:g} Hz; v2.1 and v3 are read')
    columns = dict(pairs)
    if not columns:
        text = f'{file}: names no joints of {" or ".join(_FEATURES)}; write them as `names`'
        raise ErrorCode.MISSING_STREAM.error(text)
    if len(columns) < len(pairs):
        raise damaged(file, 'names a joint twice in one feature; correct it')
    return rate, columns


def _columns(
    feature: str, about: Mapping[str, Any]
) -> Iterator[tuple[tuple[str, str, str], tuple[str, int]]]:
    """Yield what the numbers of a feature are; some robots list their names by group."""
    names = about['names'] or ()
    if isinstance(names, Mapping):
        names = [x for group in names.values() for x in group]
    role, standard = _FEATURES[feature]
    for place, name in enumerate(map(str, names)):
        joint, _, ending = name.rpartition('.')
        if ending not in _ENDINGS or not joint:
            joint, ending = name, ''
        field = _ENDINGS[ending] if ending and standard == 'position' else standard
        measured = role != 'command' and field == 'effort'
        yield ('effort' if measured else role, joint, field), (feature, place)


def _values(file: Path, columns: _Columns) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the episode and the frame of a file's rows (T,), and its columns (T, C)."""
    try:
        import pyarrow
        from pyarrow import parquet
    except ModuleNotFoundError as missing:
        text = f'a LeRobot folder needs {missing.name}; `pip install "ros2-ident[lerobot]"`'
        raise ErrorCode.INVALID_GOAL.error(text) from None
    features = dict.fromkeys(feature for feature, _ in columns.values())
    try:
        with parquet.ParquetFile(file) as opened:
            needed = 24 * opened.metadata.num_rows * (len(columns) + 2)
            require_memory(f'{file}: its values take', needed)
            table = opened.read([*features, 'episode_index', 'frame_index'])
        read = {}
        for name in features:
            rows = table[name].combine_chunks()
            flat = rows.flatten().to_numpy(zero_copy_only=False).astype(np.float64)
            width = max(place for feature, place in columns.values() if feature == name) + 1
            if rows.null_count or flat.size != width * len(rows):
                raise damaged(file, f'{name} has not {width} numbers in each row; correct it')
            read[name] = flat.reshape(len(rows), width)
        episode, frame = (
            table[x].to_numpy().astype(np.int64) for x in ('episode_index', 'frame_index')
        )
    except (pyarrow.ArrowException, KeyError, ValueError, AttributeError) as exc:
        text = f'cannot be read ({printable(str(exc), 120)}); fetch it again'
        raise damaged(file, text) from None
    return episode, frame, np.stack([read[x][:, n] for x, n in columns.values()], axis=1)


def _calibrated(file: Path) -> dict[str, tuple[float, float]]:
    """Return how far joints turn, about their middle, by LeRobot's calibration."""
    try:
        motors = json.loads(read_small(file))
        turns = {k: (x['range_max'] - x['range_min']) / _COUNTS for k, x in motors.items()}
    except _UNFIT as exc:
        text = f'is no calibration of LeRobot ({printable(str(exc), 80)})'
        text = f'{file}: {text}; give the file with range_min and range_max of each motor'
        raise ErrorCode.INVALID_GOAL.error(text) from None
    return {name: (-0.5 * math.tau * x, 0.5 * math.tau * x) for name, x in turns.items()}


def _in_rad(
    path: Path, unit: str, columns: _Columns, values: FloatArray, ends: Travel
) -> list[str]:
    """Convert values (T, C) in place; return what to say of their unit."""
    said = []
    if not unit:
        unit = _unit_of(path, columns, values, ends)
        said = [f'LeRobot states no unit: positions are taken as {UNITS[unit]}, nothing else fits']
    unknown = []
    for (_, joint, field), row in zip(columns, values.T, strict=True):
        pair = _factor(unit, ends.get(joint), joint == _GRIPPER)
        if field != 'effort' and pair is None and joint != _GRIPPER:
            unknown.append(joint)
        elif field != 'effort' and pair is not None:
            row *= pair[0]
            row += pair[1] if field == 'position' else 0.0
    if unknown:
        text = f'-100 to 100 is the travel of {listed(dict.fromkeys(unknown))}, which nothing '
        text += "states; give LeRobot's calibration file by --columns, or a machine with limits"
        raise ErrorCode.WRONG_UNITS.error(f'{path}: {text}')
    return said


def _factor(
    unit: str, ends: tuple[float, float] | None, gripper: bool
) -> tuple[float, float] | None:
    """Return the factor to rad and what is added then; None where the ends are needed."""
    if unit == 'rad':
        return 1.0, 0.0
    if unit == 'deg' and not gripper:
        return math.pi / 180.0, 0.0
    if ends is None:
        return None
    low, high = ends
    if gripper:
        return (high - low) / 100.0, low
    return (high - low) / 200.0, 0.5 * (high + low)


def _unit_of(path: Path, columns: _Columns, values: FloatArray, ends: Travel) -> str:
    """Return the unit in which joints stay within their ends, and move more than a little.

    Raises:
        IdentError: WRONG_UNITS where several are possible, or none.
    """
    spans = {
        joint: (float(np.nanmin(row)), float(np.nanmax(row)))
        for (role, joint, field), row in zip(columns, values.T, strict=True)
        if (role, field) == ('state', 'position') and np.isfinite(row).any()
        if joint != _GRIPPER
    }
    found = [unit for unit in UNITS if spans and _fits(unit, spans, ends)]
    if len(found) == 1:
        return found[0]
    most = max((max(map(abs, x)) for x in spans.values()), default=0.0)
    able = ' or '.join(UNITS[x] for x in found) or 'none of them'
    text = f'{path}: LeRobot states no unit of its positions, which reach {most:.4g} and may be '
    text += f'{able}; give --position-unit {", ".join(UNITS)}'
    raise ErrorCode.WRONG_UNITS.error(text)


def _fits(unit: str, spans: Travel, ends: Travel) -> bool:
    """Say whether positions can be in a unit."""
    most = max(max(map(abs, x)) for x in spans.values())
    if most > {'rad': _TURN, 'deg': math.inf, 'percent': 100.01}[unit]:
        return False
    moved = []
    for joint, span in spans.items():
        pair = _factor(unit, ends.get(joint), False)
        if pair is None or joint not in ends:
            continue
        low, high = ends[joint]
        begin, end = (pair[0] * x + pair[1] for x in span)
        room = _BEYOND * (high - low)
        if begin < low - room or end > high + room:
            return False
        moved.append((end - begin) / (high - low))
    return not moved or max(moved) > _MOVED
