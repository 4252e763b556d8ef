# SPDX-License-Identifier: Apache-2.0
"""LeRobot folders, v2.1 and v3: one episode a recording, in units that are not stated."""

from collections.abc import Container, Iterator, Mapping
import json
import math
from pathlib import Path
import re
from typing import Any

import numpy as np

from ros2_ident.errors import ErrorCode
from ros2_ident.files import read_small
from ros2_ident.recording.builder import RecordingBuilder
from ros2_ident.recording.limits import listed, printable
from ros2_ident.recording.storage import damaged, digest, UNFIT
from ros2_ident.recording.streams import FloatArray, IntArray, Recording
from ros2_ident.recording.table import parquet_columns

# Ends of each joint's travel by its name: low and high, rad.
Travel = Mapping[str, tuple[float, float]]

INFO = Path('meta/info.json')
# What positions can be: LeRobot's three, and radians, which its simulated robots log.
UNITS = {'rad': 'radians', 'deg': 'degrees', 'percent': '-100 to 100 of the travel'}
# What LeRobot's drivers turn into 0 to 100, whatever the unit of the other joints: the last word
# of a name.
_GRIPPER = re.compile(r'(?:.*[_./-])?gripper')
# Counts of a turn, less one, as LeRobot's drivers divide. Those of 4096 are homed to the middle of
# a turn before their range is recorded, so that it reaches beyond 1023.
_COUNTS = (4095, 1023)
# Robots whose drivers pass over the calibration's drive_mode (Dynamixel).
_UNTURNED = ('koch', 'omx')
# Degrees lie on half counts of a turn: so near, in counts, and on so many different ones.
_NEAR, _DIFFERENT = 0.02, 10
# Role and field of a feature, and of what its names end in.
_FEATURES = {
    'observation.state': ('state', 'position'),
    'observation.velocity': ('state', 'velocity'),
    'observation.effort': ('effort', 'effort'),
    'action': ('command', 'position'),
}
_ENDINGS = {'pos': 'position', 'q': 'position', 'vel': 'velocity'}
_ENDINGS |= dict.fromkeys(('effort', 'torque', 'current', 'load'), 'effort')
# Beyond its ends by this share of its travel a joint is not; through less of it none is moved.
_BEYOND, _MOVED = 0.05, 0.04
# Without ends: what is farther off than this was not logged in rad.
_TURN = 1.1 * math.tau


# What a number is: role, joint and field; where it stands: feature and place; and its ending.
_Key = tuple[str, str, str]
_Place = tuple[str, int, str]
_Columns = dict[_Key, _Place]


def read_lerobot(
    path: Path, roles: Container[str], unit: str, calibration: str, travel: Travel | None
) -> list[Recording]:
    """Read the episodes of a LeRobot folder, one recording each, positions in rad.

    Args:
        roles: What to read: `state`, `effort`, and `command` for the action.
        unit: Of positions, one of `UNITS`; where empty, the one in which they stay within the
            ends of their joints.
        calibration: LeRobot's calibration file of the robot, which says how far joints turn; none
            where empty.
        travel: Ends of the machine's joints, where its description has any.

    Raises:
        IdentError: NO_DATA, MISSING_STREAM, DAMAGED_BAG or BAD_VALUES; WRONG_UNITS where more than
            one unit is possible, or none.
    """
    rate, robot, columns = _described(path, roles)
    files = sorted(filter(Path.is_file, path.glob('data/*/*.parquet')))
    if not files:
        raise ErrorCode.NO_DATA.at(path, 'holds no data/*/*.parquet; fetch or record it again')
    parts = [_values(file, columns) for file in files]
    episode, frame, values = (np.concatenate(x) for x in zip(*parts, strict=True))
    turned = not robot.startswith(_UNTURNED)
    own = _calibrated(Path(calibration), turned) if calibration else {}
    said = [f'LeRobot stamps are the number of the frame over {rate:g} Hz: jitter cannot be seen']
    said += _in_rad(path, unit, columns, values, {**(travel or {}), **own})
    asked = any(role == 'command' for role, *_ in columns)
    notes = ['the action is what was asked for, before the driver limits it'] * asked
    numbers, total = np.unique(episode), digest([path / INFO, *files])
    found = []
    for number in numbers.tolist():
        rows = np.flatnonzero(episode == number)
        rows = rows[np.argsort(frame[rows], kind='stable')]
        source = f'{path}/episode_{number:06d}' if numbers.size > 1 else str(path)
        builder = RecordingBuilder(source, total, notes, said)
        stamp = np.round(frame[rows] * (1e9 / rate)).astype(np.int64)
        pairs = zip(columns, values[rows].T, strict=True)
        builder.add_columns(stamp, {key: x for key, x in pairs if not np.isnan(x).all()})
        found += builder.build()
    return found


def _described(path: Path, roles: Container[str]) -> tuple[float, str, _Columns]:
    """Return the rate, Hz, the type of the robot, and what is read, by `meta/info.json`."""
    file = path / INFO
    try:
        info = json.loads(read_small(file, 1 << 22))
        version, rate = str(info['codebase_version']), float(info['fps'])
        robot = str(info.get('robot_type') or '')
        features = {k: v for k, v in info['features'].items() if k in _FEATURES}
        pairs = [x for k, v in features.items() for x in _columns(k, v) if x[0][0] in roles]
    except UNFIT as exc:
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
    return rate, robot, columns


def _columns(feature: str, about: Mapping[str, Any]) -> Iterator[tuple[_Key, _Place]]:
    """Yield what the numbers of a feature are; some robots list names by group, called or not."""
    names = about['names'] or ()
    groups = names.values() if isinstance(names, Mapping) else names
    told = (x for group in groups for x in ([group] if isinstance(group, str) else group))
    role, standard = _FEATURES[feature]
    for place, name in enumerate(map(str, told)):
        joint, _, ending = name.rpartition('.')
        if ending not in _ENDINGS or not joint:
            joint, ending = name, ''
        field = _ENDINGS[ending] if ending and standard == 'position' else standard
        measured = role != 'command' and field == 'effort'
        yield ('effort' if measured else role, joint, field), (feature, place, ending)


def _values(file: Path, columns: _Columns) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the episode and the frame of a file's rows (T,), and its columns (T, C)."""
    features = dict.fromkeys(feature for feature, *_ in columns.values())
    table = parquet_columns(file, [*features, 'episode_index', 'frame_index'])
    for name in features:
        width = max(place for feature, place, _ in columns.values() if feature == name) + 1
        if table[name].dtype.kind not in 'biuf' or table[name].size != width * len(table[name]):
            have = table[name].size // max(1, len(table[name]))
            text = f'{INFO} names {width} numbers of {name}, its rows have {have}; correct one'
            raise damaged(file, text)
        table[name] = table[name].reshape(-1, width)
    episode, frame = (table[x].astype(np.int64) for x in ('episode_index', 'frame_index'))
    values = [table[x][:, n].astype(np.float64) for x, n, _ in columns.values()]
    return episode, frame, np.stack(values, axis=1)


def _calibrated(file: Path, turned: bool) -> dict[str, tuple[float, float]]:
    """Return how far joints turn, about their middle, by LeRobot's calibration.

    Where `turned`, a drive_mode of 1 turns -100 to 100 about: its ends then are the other way
    round, so that joints have the direction that they have in degrees.
    """
    ends = {}
    try:
        for name, x in json.loads(read_small(file)).items():
            counts = _COUNTS[x['range_max'] <= _COUNTS[1]]
            half = 0.5 * math.tau * (x['range_max'] - x['range_min']) / counts
            ends[name] = (half, -half) if turned and x.get('drive_mode') else (-half, half)
    except UNFIT as exc:
        text = f'is no calibration of LeRobot ({printable(str(exc), 80)})'
        text = f'{file}: {text}; give the file with range_min and range_max of each motor'
        raise ErrorCode.INVALID_GOAL.error(text) from None
    return ends


def _in_rad(
    path: Path, unit: str, columns: _Columns, values: FloatArray, ends: Travel
) -> list[str]:
    """Convert values (T, C) in place, NaN where they are left out; return what to say of it."""
    said = []
    if not unit:
        unit, why = _unit_of(path, columns, values, ends)
        said = [f'LeRobot states no unit: positions are taken as {UNITS[unit]}, {why}']
    unknown, shut, bases = dict[str, None](), dict[str, None](), dict[str, None]()
    placed = {joint for _, joint, field in columns if field == 'position'}
    for ((_, joint, field), (*_, ending)), row in zip(columns.items(), values.T, strict=True):
        gripper = _GRIPPER.fullmatch(joint) is not None
        pair = _factor(unit, ends.get(joint), gripper)
        if field == 'effort' or ending == 'q':
            continue
        if joint in placed and pair is not None:
            row *= pair[0]
            row += pair[1] if field == 'position' else 0.0
        else:
            row[:] = np.nan
            # a velocity alone is of a mobile base, in m/s and in a unit of its own
            (bases if joint not in placed else shut if gripper else unknown)[joint] = None
    if unknown:
        text = f'-100 to 100 is the travel of {listed(unknown)}, which nothing states; give '
        text += "LeRobot's calibration file by --columns, or a machine with limits"
        raise ErrorCode.WRONG_UNITS.at(path, text)
    if shut:
        text = f'{listed(shut)}: left out, 0 to 100 of a travel that nothing states; give '
        said.append(f"{text}LeRobot's calibration file by --columns, or a machine with it")
    if bases:
        text = 'left out, a velocity without a position, as of a mobile base'
        said.append(f'{listed(bases)}: {text}')
    return said


def _factor(
    unit: str, ends: tuple[float, float] | None, gripper: bool
) -> tuple[float, float] | None:
    """Return the factor to rad and what is added then; None where the ends are needed."""
    if unit == 'rad' or (unit == 'deg' and not gripper):
        return (1.0 if unit == 'rad' else math.pi / 180.0), 0.0
    if ends is None:
        return None
    low, high = ends
    return ((high - low) / 100.0, low) if gripper else ((high - low) / 200.0, 0.5 * (high + low))


def _unit_of(path: Path, columns: _Columns, values: FloatArray, ends: Travel) -> tuple[str, str]:
    """Return the unit of positions, and what tells it.

    Degrees are told by their steps, which are those of a servo's counts, and so is a share of a
    travel in counts. Else joints stay within their ends in one unit only, and move more than a
    little.

    Raises:
        IdentError: WRONG_UNITS where several are possible, or none.
    """
    rows = {}
    for ((role, joint, field), (*_, ending)), row in zip(columns.items(), values.T, strict=True):
        known = row[np.isfinite(row)]
        asked = (role, field) == ('state', 'position') and ending != 'q'
        if asked and known.size and not _GRIPPER.fullmatch(joint):
            rows[joint] = known
    if not rows and any(ending == 'q' for *_, ending in columns.values()):
        return 'rad', 'as names that end in .q are'
    for able in ('deg', 'percent'):
        pairs = [(x, _factor(able, ends.get(joint), False)) for joint, x in rows.items()]
        angles = [np.unique(x) * pair[0] + pair[1] for x, pair in pairs if pair]
        for counts in _COUNTS if len(angles) == len(pairs) > 0 else ():
            steps = np.concatenate(angles) * (2 * counts / math.tau)
            whole = np.rint(steps)
            if (np.abs(steps - whole) < _NEAR).all() and np.unique(whole).size >= _DIFFERENT:
                return able, f'their steps are those of {counts + 1} counts a turn'
    spans = {joint: (float(x.min()), float(x.max())) for joint, x in rows.items()}
    found = [unit for unit in UNITS if spans and _fits(unit, spans, ends)]
    if len(found) == 1:
        return found[0], 'nothing else fits'
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
        low, high = sorted(ends[joint])
        begin, end = sorted(pair[0] * x + pair[1] for x in span)
        room = _BEYOND * (high - low)
        if begin < low - room or end > high + room:
            return False
        moved.append((end - begin) / (high - low))
    return not moved or max(moved) > _MOVED
