# SPDX-License-Identifier: Apache-2.0
"""A new machine file: a template of every key, or from a description and a log of the machine."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
import itertools
from itertools import cycle, groupby, islice
import re
import textwrap
from typing import Any, cast
import xml.etree.ElementTree as ET

import numpy as np
import yaml

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.description import (
    declared,
    fall_of,
    floating,
    joints_in,
    judged_tree,
    own_physics,
    OWN_WORDS,
    SLIDE,
)
from ros2_ident.machine.keys import DESCRIPTION_TOPIC, digits, inline, Key, literal
from ros2_ident.machine.kind import Kind
from ros2_ident.machine.units import name_of, STATED_FOR
from ros2_ident.models.registry import KINDS, machine_from_mapping, make_model
from ros2_ident.models.serial.law import left_by_quarters
from ros2_ident.recording import Dataset, Recording, Stream
from ros2_ident.recording.align import align
from ros2_ident.recording.grid import cycle_of, sample_period, short_number
from ros2_ident.recording.motion import direction, fill_gaps, Motion, motion_of
from ros2_ident.recording.quality import standing
from ros2_ident.recording.streams import FloatArray, with_positions

# Parameters that an MJCF states: element, attribute, and which of its numbers.
_STATED = (
    ('armature', 'joint', 'armature', 0), ('damping', 'joint', 'damping', 0),
    ('frictionloss', 'joint', 'frictionloss', 0), ('kp', 'position', 'kp', 0),
    ('kp', 'general', 'gainprm', 0), ('kv', 'position', 'kv', 0), ('kv', 'general', 'biasprm', 2),
    ('force_limit', 'position', 'forcerange', 1), ('force_limit', 'general', 'forcerange', 1),
    ('force_limit', 'motor', 'forcerange', 1), ('force_limit', 'joint', 'actuatorfrcrange', 1),
)  # fmt: skip
# Quantities whose unit says whether a joint turns, the first that there is.
_TRAVELS = 'position', 'command_position', 'velocity', 'command_velocity'
# What to say beside a unit of the effort and that which fits the motion.
_ASKED = {
    ('N m', 'N'): ': 2 pi over the travel of a turn in m; where it turns, --travel rad',
    ('N', 'N m'): ': the lever in m; where it slides, --travel m',
    **dict.fromkeys(
        (('A', 'N m'), ('A', 'N')),
        ': of an ampere the motor constant, or 1 where it is not known and all is divided by it',
    ),
}
# Of each joint, by the name of the parameter.
_Boxes = dict[str, list[tuple[float, float, str]]]
# A box reaches to so many times what is stated, as those of the bundled examples do.
_ROOM = 4.0


def new_machine_file(
    kind: Kind,
    drives: Sequence[str] = (),
    description: str | None = None,
    named: str = DESCRIPTION_TOPIC,
    log: Recording | None = None,
) -> str:
    """Return the text of a machine file, as far filled in as is known.

    Args:
        drives: Joint names; where there are none, those that description and log have in common.
        description: URDF or MJCF.
        named: Where it can be found, for the file.
        log: A log of the machine, which also gives the period and the unit of the effort.

    Raises:
        IdentError: INVALID_GOAL where the kind has no description, description and log no joint
            in common, or the log efforts of several units; or as the kind's `joints`.
    """
    states = None if log is None else log.state
    known, boxes, slides, root = dict[str, str](), dict[str, str](), set[str](), None
    if description is not None:
        root = judged_tree(description)
        slides = {*joints_in(root, SLIDE)}
        known = {description_key(kind): inline(named)}
        known |= {key: digits(value) for key, value in _gravity(kind, root).items()}
        if kind.joints is not None:
            kind.joints(root)
        boxes = _boxes(kind, root)
    names = tuple(drives) or _joints(kind, root, states)
    if log is not None and states is not None:
        known['cycle'] = cycle_of(states.stamp)
        boxes |= _driven(kind, names, root, log)
    known |= _effort_unit(kind, log, names)
    # What slides asks its mass of its drive, what turns the moment alone.
    shown = kind.described[:1] if kind.extent and slides.intersection(names) else ()
    return machine_template(kind, names, known, boxes, shown)


def _effort_unit(kind: Kind, log: Recording | None, names: Sequence[str]) -> dict[str, str]:
    """Return what a file says of the unit in which a log states efforts, where it states one.

    Raises:
        IdentError: INVALID_GOAL where it states several.
    """
    found = [] if log is None else [log.units.get((name, 'effort'), '') for name in names]
    units = list(dict.fromkeys(filter(None, found)))
    if len(units) > 1:
        raise ErrorCode.INVALID_GOAL.error(
            f'the log states efforts in {" and ".join(units)}; a machine file has one unit: in '
            'the column map, give them a `scale` to one of these in place of the unit'
        )
    if not units:
        return {}
    constant = STATED_FOR.get(units[0])
    own = {x.name: literal(x) for x in kind.keys if (x.section, x.name) == ('', constant)}
    return {'effort_unit': units[0], **own}


def _gravity(kind: Kind, root: ET.Element) -> dict[str, float]:
    """Return what a file has to say of gravity where an MJCF's is not the usual one."""
    fall = np.array(fall_of(root))
    if kind.tilt is None:
        return {}
    size = float(np.linalg.norm(fall))
    stated = {'free_fall': size, **(kind.tilt(fall) if size else {})}
    usual = {key.name: key.default for key in kind.keys}
    return {key: y for key, x in stated.items() if (y := round(x, 9)) != usual[key]}


def driven_file(kind: Kind, drives: Sequence[str], log: Recording, travel: str = '') -> str | None:
    """Return the whole file of one joint, or of drives, that a recorded motion drives, by its log.

    No controller is in it: a log does not say its gains. Of several drives those whose position or
    effort stays the same are left out.

    Args:
        drives: Joint names; those of the log where there are none.
        log: A log with a measured motion.
        travel: Unit of its position, `rad` or `m`; empty for that which the log states.

    Returns:
        The text, its bounds from what alone would make the effort; None where the kind has no
        rigid drive or link, or several joints for one link.

    Raises:
        IdentError: INVALID_GOAL for a carriage whose effort follows gravity on a link, where the
            log states an effort that is no force of what slides, or torque of what turns, or
            where some drives turn and others slide; MISSING_STREAM without efforts, or where
            they or positions stay the same.
    """
    log, summed = with_positions(log, log.state.names if log.state else ())
    assert log.state is not None
    names = tuple(drives) or log.state.names
    keys = {key.name for key in kind.keys}
    links, rigid = 'link_moment' in keys, 'moving_mass' in keys
    if log.state.position is None or not (rigid or links and len(names) == 1):
        return None
    motions = {x: y for x in names if (y := motion_of(log, x)).effort is not None}
    if not motions:
        raise ErrorCode.MISSING_STREAM.error(
            f'the log holds no effort of {", ".join(names)}, from which masses and friction are '
            'told; log their current or torque, or name its topic or column; hobby servos under '
            'their set-points are the kind servo'
        )
    for quantity in 'position', 'effort':
        moved = {x: getattr(y, quantity) for x, y in motions.items()}
        moved = {x: y for x, y in moved.items() if np.nanmax(y) > np.nanmin(y)}
        if not moved:
            raise ErrorCode.MISSING_STREAM.error(
                f'the {quantity} of {next(iter(motions))} stays the same, so that the log tells '
                f'nothing of the drive; record a motion, or name another column as its {quantity}'
            )
        motions = {x: motions[x] for x in moved}
    read = {x: log.units.get((x, 'position'), '') for x in motions}
    still = standing({x: float(np.ptp(y.position)) for x, y in motions.items()}, ways=read)
    rows: dict[str, list[str]] = {}
    fit: set[str] = set()
    for name, motion in motions.items():
        assert motion.effort is not None
        stated = {quantity: unit for (own, quantity), unit in log.units.items() if own == name}
        unit = stated.get('effort', '')
        way = 'rad' if links else travel or next((stated[x] for x in _TRAVELS if x in stated), '')
        way = way or ('m' if unit == 'N' else '')
        fits = 'N' if way == 'm' else 'N m'
        if unit not in ('', fits):
            raise ErrorCode.INVALID_GOAL.error(
                f'the effort of {name} is in {unit}, and bounds of what '
                f'{"slides" if way == "m" else "turns"} are in {fits}; give it in the column map '
                f'a `scale`, how many {fits} one is, in place of the unit'
                f'{_ASKED.get((unit, fits), "")}'
            )
        # An integral of a speed comes back to no place; what holds a drive follows none.
        weight = 0.0 if way == 'm' or summed or name in still else _weight(motion, motion.effort)
        if rigid and weight:
            raise ErrorCode.INVALID_GOAL.error(
                f'the effort of {name} follows its position, up to {weight:.3g}, as that of a '
                f'joint under gravity, which a {kind.name} does not have; take --kind serial'
                f'{f" and --drives {name}" if len(names) > 1 else ""}, or --travel m where the '
                'position is a length'
            )
        fit.add(fits)
        most = float(np.nanmax(np.abs(motion.effort)))
        rates = motion.acceleration, motion.velocity
        mass, viscous = (2.0 * most / max(float(x.std()), 1e-12) for x in rates)
        units = ('kg', 'N', 'N s/m') if way == 'm' else ('kg m^2', 'N m', 'N m s/rad')
        for text in (
            f'moving_mass: 0.0, {mass:.3g}, {units[0]}',
            f'coulomb_friction: 0.0, {most:.3g}, {units[1]}',
            f'viscous_friction: 0.0, {viscous:.3g}, {units[2]}',
            f'constant_force: {-most:.3g}, {most:.3g}, {units[1]}',
        ):
            key, box = text.split(': ')
            rows.setdefault(key, []).append(box)
    if len(fit) > 1:
        raise ErrorCode.INVALID_GOAL.error(
            'some of these drives turn and others slide, and a machine file has one unit of '
            'efforts; name those that turn, or those that slide, by --drives'
        )
    head = f'machine: {kind.name}\ndrives: {inline([*motions])}'
    left = ', '.join(x for x in names if x not in motions)
    head += f'      # {left}: no motion or effort' if left else ''
    head += '\neffort_unit: N\n' if fit == {'N'} else '\n'
    period = f'controller: {{cycle: {cycle_of(log.state.stamp)}}}      # s, period of the log\n'
    # A commanded effort acts half a cycle after its stamp; a measured one is that much late.
    delay = f'  measurement_delay: [0.0, {2.0 * motion.period:.3g}, s]\n'
    if links:
        # The axis lies level; where the link hangs the two moments say.
        table = 'dh_a: [0], dh_alpha: [1.5707963], dh_d: [0], dh_theta: [0]'
        # near a swing's own frequency weight and inertia need no effort: what counts of the motion
        # is what the other one cannot have
        ways = np.stack([np.sin(motion.position), np.cos(motion.position)])
        change = motion.acceleration[None]
        pairs = (change, ways), (ways, change)
        least = (np.linalg.norm(x - x @ np.linalg.pinv(y) @ y, -2) for x, y in pairs)
        mass, pull = (2.0 * most * len(ways.T) ** 0.5 / max(float(x), 1e-12) for x in least)
        moment = pull / 9.81
        return (
            f'{head}geometry: {{{table}}}      # one joint with a level axis\n{period}'
            f'parameters:\n  link_moment: [{-moment:.3g}, {moment:.3g}, kg m]\n'
            f'  drive_inertia: [0.0, {mass:.3g}, kg m^2]\n'
            f'  coulomb_torque: [0.0, {most:.3g}, N m]\n'
            f'  viscous_torque: [0.0, {viscous:.3g}, N m s/rad]\n{delay}'
        )
    note = '' if way else '# of a joint that turns; a carriage: --travel m'
    apart, top = '\n  - ', f'parameters:                      {note}'.rstrip()
    lines = (
        f'  {key}:{apart if x[1:] else " "}{apart.join(f"[{y}]" for y in x)}\n'
        for key, x in rows.items()
    )
    return f'{head}{period}{top}\n{"".join(lines)}{delay}'


def _weight(motion: Motion, logged: FloatArray) -> float:
    """Return the largest effort that follows a position's sine; 0 where it closes too little.

    It counts as an effect does, see `gap.rules`: where it closes half of what inertia, friction
    and a spring leave, and is a tenth of the effort. A small swing tells no sine from a spring,
    which no kind has: where inertia and friction leave most of the effort, half of that counts.
    """
    effort = motion.slowly(fill_gaps(logged))
    place, still = motion.position, np.ones(motion.position.size)
    plain = [motion.acceleration, motion.velocity, direction(motion.velocity), still]
    rows = motion.slowly(np.stack([np.sin(place), np.cos(place), *plain, place]))

    def fit(first: int, last: int) -> tuple[FloatArray, float]:
        own = rows[first:last]
        fitted = np.asarray(np.linalg.lstsq(own.T, effort, rcond=None)[0])
        return fitted, float(np.mean((effort - fitted @ own) ** 2))

    inert, without = fit(2, 6)
    # Below its own frequency a swing looks like one of a negative mass: there is none.
    alone = without if inert[0] > 0.0 else fit(3, 6)[1]
    most = float(effort.var())
    if alone < 0.5 * most:
        without = fit(2, 7)[1]
    fitted, left = fit(0, 6)
    closes = without - left
    return float(np.hypot(*fitted[:2])) if closes > left and closes > 0.1**2 * most else 0.0


def followed_file(
    drives: Sequence[str], description: str, named: str, log: Recording
) -> str | None:
    """Return the whole file of an arm's joints that follow set-points, by their log.

    Bounds are what alone would make the largest effort: that of the log, or the description's
    limit; what an MJCF states lies in them, with room above. Of the controllers' laws it has the
    one that leaves least of a half of the log by the other's gains, see `Serial.regressed`.

    Args:
        drives: Joint names; those that description and log have in common where there are none.
        description: URDF or MJCF.
        named: Where it can be found, for the file.
        log: A log with a measured motion.

    Returns:
        The text; None where the log has no set-point, or an MJCF takes MuJoCo.

    Raises:
        IdentError: As `new_machine_file`, and as the model of the kind.
    """
    root = judged_tree(description)
    if not log.sets_positions:
        return None
    log, _ = with_positions(log, log.state.names if log.state else ())
    assert log.state is not None and log.command is not None
    kind = arm_kind(False)
    try:
        names = tuple(drives) or _joints(kind, root, log.state)
        if root.tag != 'robot':
            cast(Any, kind.extent)(root)
            if own_physics(root, names):
                return None
    except IdentError:
        if root.tag == 'robot':
            raise
        return None
    boxes, period = _boxes_of(names, root, log), sample_period(log.command.stamp)
    unit = _effort_unit(kind, log, names)
    if unit.get('effort_unit') in STATED_FOR:
        # no gain in N m is found by them
        log = replace(log, state=replace(log.state, effort=None), effort=None)
    head = f'machine: {kind.name}\ndrives: {inline([*names])}\n'
    head += ''.join(f'{key}: {value}\n' for key, value in unit.items())
    head += f'geometry: {inline({"description": named, **_gravity(kind, root)})}\n'
    data = align(log, names, period, need=('position',))
    stated = f'  cycle: {short_number(period)}      # s, how long a set-point holds\n'
    limits = _stated_by_joint(root).get('force_limit', {})
    if limits.keys() >= {*names}:
        stated += f'  torque_limit: {inline([limits[x] for x in names])}\n'
    found: dict[str, float] = {}
    for compensation, more in itertools.product(_COMPENSATIONS, _MORE):
        every = {**boxes, **{name: [_FURTHER[name]] * len(names) for name in more}}
        text = _followed(head, stated, compensation, every)
        gains, left = _model_by(text, description, data).regressed()
        for name, several in every.items():
            told = zip(several, gains[name].tolist(), strict=True)
            every[name] = [(low, max(high, _ROOM * x), unit) for (low, high, unit), x in told]
        text = _followed(head, stated, compensation, every)
        ahead = gains['velocity_feedforward'] * gains['velocity_gain']
        # Within a cycle a stiff drive has taken up its set-point, as if a part were fed forward.
        if 'velocity_feedforward' in more and (ahead < period * gains['position_gain']).all():
            continue
        found[text] = float(np.mean(left))
    # The plainest that leaves hardly more than the best; by hand.
    least = _HARDLY * min(found.values())
    text = next(text for text, left in found.items() if left <= least)
    wide = _boxes(kind, root)
    links = ''.join(f'  {name}: {wide[name]}\n' for name in kind.described[1:] if name in wide)
    if data.effort is not None and links and _weighs_else(text, links, description, data):
        text += f'  # The log is not of the links as described, but as far from them:\n{links}'
    if root.tag == 'robot' or not _steps_as_mujoco(text, names, description, named, data):
        return text
    return None


def _model_by(text: str, description: str, data: Dataset, compared: str = 'position') -> Any:
    """Return the model of a log by the text of a machine file and its description."""
    mapping = yaml.safe_load(text)
    mapping['geometry']['description'] = DESCRIPTION_TOPIC
    machine = machine_from_mapping(mapping).described(description)
    return make_model(machine, data, quantities=(compared,))


def _weighs_else(text: str, links: str, description: str, data: Dataset) -> bool:
    """Return whether a log's efforts tell other links than described, at half of the joints.

    Links are in the efforts of all joints before them, an effect in those of its own.

    Args:
        text: The machine file with the links as described.
        links: Lines of its parameters by which they may differ.
        description: URDF or MJCF.
        data: The log, of which the recorded motion counts.
    """
    moved = replace(data, command_position=None, command_velocity=None)
    described, other = (
        left_by_quarters(_model_by(x, description, moved, 'effort')) for x in (text, text + links)
    )
    return bool(np.mean(other * (1.0 + _MATERIAL**2) < described) >= 0.5)


def _steps_as_mujoco(
    text: str, names: Sequence[str], description: str, named: str, data: Dataset
) -> bool:
    """Return whether MuJoCo's own steps leave far less of a log than the text of a machine file.

    A log that MuJoCo simulated in steps that are long for its actuators' damping is no motion of
    the machine described. Both begin as a search would.
    """

    def left(model: Any) -> float:
        begin = model.suggested()
        return np.inf if begin is None else float(np.mean(model.residuals(begin[None]) ** 2))

    as_written = left(_model_by(text, description, data))
    try:
        other = new_machine_file(arm_kind(True), names, description, named)
        other = re.sub('( cycle: )[^ ]*', rf'\g<1>{short_number(data.cycle)}', other)
        simulator = _model_by(other, description, data)
    except IdentError:
        return False  # MuJoCo is not installed, or cannot simulate the description
    return left(simulator) < _FAR_LESS * as_written


# What may belong to an arm's law beside P and D, the plainest first; and by how much more than the
# least error a plainer one may leave.
_COMPENSATIONS = 'none', 'gravity', 'dynamics'
_FURTHER = {
    'velocity_feedforward': (0.0, 1.5, '1'),
    'integral_gain': (0.0, 1e5, 'N m/(rad s)'),
}
_MORE = [more for n in range(3) for more in itertools.combinations(_FURTHER, n)]
_HARDLY = 1.1
# Share of the mean square that is left where a log is one of MuJoCo's own steps; by hand.
_FAR_LESS = 0.25
# By how much described links may miss the effort of a joint, in what else is left: `material` of a
# diagnosis, see `gap.rules`.
_MATERIAL = 0.45


def _boxes_of(names: Sequence[str], root: Any, log: Recording) -> _Boxes:
    """Return boxes of gains, rotors and friction by name, one of each joint."""
    stated = _stated_by_joint(root)
    boxes: _Boxes = {}
    effort = any(x is not None and x.effort is not None for x in (log.state, log.effort))
    for name, motion, most in _efforts(names, root, log):
        most = most or 100.0
        data = align(log, [name], motion.period, need=('position',))
        assert data.command_position is not None and data.position is not None
        apart = float(np.nanstd(data.command_position - data.position))
        alone = _alone(motion, most)
        ends = {
            'position_gain': (0.02, 20.0 * most / max(apart, 1e-4), 'N m/rad'),
            'velocity_gain': alone['viscous_torque'],
            **alone,
        }
        if not effort:
            del ends['viscous_torque']
        for word, key in OWN_WORDS.items():
            # Without an effort two parameters are one.
            low, high, unit = ends[key if key in ends else 'velocity_gain']
            high = max(high, _ROOM * stated.get(word, {}).get(name, 0.0))
            ends[key if key in ends else 'velocity_gain'] = low, high, unit
        for key, box in ends.items():
            boxes.setdefault(key, []).append(box)
    return boxes


def _efforts(
    names: Sequence[str], root: Any, log: Recording
) -> Iterator[tuple[str, Motion, float]]:
    """Yield each joint, its motion, and its largest effort by the log or a description, N m.

    It is 0 where neither states it: a current or a share of something bounds no torque.
    """
    limits: dict[str, float] = {}
    if root is not None:
        limits = {
            joint.get('name', ''): float(limit.get('effort', 0.0))
            for joint in root.iterfind('joint')
            for limit in joint.iterfind('limit')
        } | _stated_by_joint(root).get('force_limit', {})
    for name in names:
        motion = motion_of(log, name)
        foreign = log.units.get((name, 'effort')) in STATED_FOR
        known = None if foreign else motion.effort
        logged = 0.0 if known is None else float(np.nanmax(np.abs(known)))
        yield name, motion, logged or limits.get(name) or max(limits.values(), default=0.0)


def _alone(motion: Motion, most: float) -> dict[str, tuple[float, float, str]]:
    """Return boxes of what alone would make the largest effort of a joint, N m."""
    acceleration, speed = (
        max(float(x.std()), 1e-3) for x in (motion.acceleration, motion.velocity)
    )
    return {
        'drive_inertia': (0.0, most / acceleration, 'kg m^2'),
        'coulomb_torque': (0.0, most, 'N m'),
        'viscous_torque': (0.0, 5.0 * most / speed, 'N m s/rad'),
    }


def _driven(kind: Kind, names: Sequence[str], root: Any, log: Recording) -> dict[str, str]:
    """Return boxes of rotors and friction as YAML, an entry for each joint.

    None where the log or the description does not tell the effort of every joint, or where the
    kind has other coordinates than its joints.
    """
    if kind.joints is None:
        return {}
    log, _ = with_positions(log, names)
    try:
        found = [_alone(motion, most) for _, motion, most in _efforts(names, root, log) if most]
    except IdentError:  # too few samples, or a joint that is not in the log
        return {}
    if not found or len(found) < len(names):
        return {}
    rows = {key: [x[key] for x in found] for key in found[0]}
    return {
        key.name: ''.join(f'\n  - [{a:g}, {b:.3g}, {unit}]' for a, b, unit in rows[key.name])
        for key in kind.keys
        if key.name in rows
    }


def _stated_by_joint(root: Any) -> dict[str, dict[str, float]]:
    """Return the sizes of what an MJCF states of `_STATED` by name and joint; of a URDF none."""
    found: dict[str, dict[str, float]] = {}
    for name, tag, attribute, column in _STATED:
        for joint, numbers in declared(root, tag, attribute).items():
            if len(numbers) > column:
                found.setdefault(name, {})[joint] = abs(numbers[column])
    return found


def _followed(head: str, stated: str, compensation: str, boxes: _Boxes) -> str:
    lines = [f'  {key}:' for key in boxes]
    for n, several in enumerate(boxes.values()):
        for low, high, unit in several:
            lines[n] += f'\n  - [{digits(low)}, {high:.3g}, {inline(unit)}]'
    if 'viscous_torque' not in boxes:
        one = 'viscous friction and velocity_gain are one'
        lines.append(f'  # Without an effort in the log, {one}.')
    added = '' if compensation == 'none' else f'  compensation: {compensation}\n'
    return (
        f'{head}'
        'controller:      # torque position_gain (set-point - position) - velocity_gain velocity\n'
        f'{stated}{added}'
        '  # What is known of the gains, torque_limit, set_point_delay belongs here, a value for\n'
        '  # all or a list, and then not below.\n'
        'parameters:      # of joints that slide: N/m, N s/m, kg, N\n' + '\n'.join(lines) + '\n'
    )


def arm_kind(simulator: bool) -> Kind:
    """Return the kind of an arm, that which MuJoCo simulates or that of this package."""
    return next(x for x in KINDS.values() if x.joints and (x.extent is None) is simulator)


def ways(kind: Kind, log: Recording, freely: bool) -> str:
    """Return in which ways a log lets an arm be simulated, the file's first."""
    effort = any(x is not None and x.effort is not None for x in (log.state, log.effort))
    points = log.sets_positions
    along = 'along its recorded motion (--kind serial), by the logged effort'
    free = 'freely under its controllers, by the logged set-points'
    if (freely or kind.extent is None) and points:
        if not effort:
            return f'this log lets the arm run {free}; along its recorded motion needs an effort'
        both = '; compare both, --outputs position,effort' if kind.extent is None else ''
        return f'this log lets the arm run {free}{both}; also {along}'
    if effort:
        more = f'also {free}' if points else 'for a free run log the set-points (joint_command)'
        return f'this log lets the arm run {along}; {more}'
    return 'this log allows neither way: log an effort, or the set-points'


def _boxes(kind: Kind, root: ET.Element) -> dict[str, str]:
    """Return boxes that hold what a description says.

    How far links can be from it is bounded by all of it at its reach. Of a kind that takes an
    MJCF alone what its joints and actuators state lies in the box, with room above.
    """
    if kind.extent is None:
        keys = {key.name: key for key in kind.keys if key.section == 'parameters'}
        most = {name: max(x.values()) for name, x in _stated_by_joint(root).items()}
        out = {}
        for name, value in most.items():
            low, high = cast(tuple[float, float], keys[name].example)
            if value > high / _ROOM:
                out[name] = f'[{low:g}, {_ROOM * value:.3g}, {keys[name].unit}]'
        return out
    mass, reach = kind.extent(root)
    if not mass * reach > 0.0:
        return {}
    links = (mass, 'kg'), (mass * reach, 'kg m'), (mass * reach**2, 'kg m^2')
    return {
        name: f'[{-x:.2g}, {x:.2g}, {unit}]'
        for name, (x, unit) in zip(kind.described, links, strict=True)
    }


def held(kind: Kind, description: str) -> str:
    """Return what is said of an MJCF's floating bases under a kind that holds them, else empty."""
    bodies = [] if kind.extent is None else floating(judged_tree(description))
    names = ', '.join(
        name_of(x.get('name')) for x, _ in bodies if x.find('.//body/joint') is not None
    )
    if not names:
        return ''
    return (
        f'{names}: floats in the description and is held as drawn, which is right where it stands '
        'still; --kind mujoco lets it float'
    )


def description_key(kind: Kind) -> str:
    """Return the key that names a machine's description.

    Raises:
        IdentError: INVALID_GOAL where the kind has none.
    """
    key = next((key for key in kind.keys if key.file), None)
    if key is None:
        raise ErrorCode.INVALID_GOAL.error(
            f'a {kind.name} is not described by a URDF or an MJCF; leave out --description'
        )
    return key.name


def _joints(kind: Kind, root: ET.Element | None, states: Stream | None) -> tuple[str, ...]:
    """Return the joints that description and log have in common; none where neither is given."""
    logged = None if states is None else states.names
    if root is None or kind.joints is None:
        return logged or ()
    known = kind.joints(root)
    common = tuple(name for name in known if logged is None or name in logged)
    if not common and ('drive', 'joint') in kind.by_path:
        return logged or ()  # the file says which joint is which
    if not common:
        perhaps = ''
        if known and logged and len(logged) == len(known):
            perhaps = f'; in their order {logged[0]} would be {known[0]}'
        raise ErrorCode.INVALID_GOAL.error(
            f'the log holds {", ".join(logged or ()) or "no joint"} and the description '
            f'{", ".join(known) or "no joint that moves"}; name the joints of the log as the '
            'description does: in its column map (--columns), or where they have numbers or no '
            f'names by --drives or --joint-names{perhaps}'
        )
    return common


_WIDTH = 99
_COMMENT = 42


def machine_template(
    kind: Kind,
    drives: Sequence[str] = (),
    known: Mapping[str, str] | None = None,
    boxes: Mapping[str, str] | None = None,
    shown: Collection[str] = (),
) -> str:
    """Return the text of a machine file.

    Args:
        drives: Joint names; those of the example where there are none.
        known: Values of keys by name, as YAML. Beside a file that describes it, a machine needs
            nothing of that section which belongs to single drives or has no default.
        boxes: Boxes of parameters by name, likewise.
        shown: Parameters that are to be found, beside those of the example.

    Returns:
        YAML that `load_machine` reads. Optional keys that the example does without stand behind
        a `#`.
    """
    given = {**(known or {})}
    if drives:
        given['drives'] = inline([*drives])
    described = {key.section for key in kind.keys if key.file and key.name in given}
    lines = [
        '# SPDX-License-Identifier: Apache-2.0',
        f'# Machine file of a {kind.name}: {kind.title}.',
        '# Every value is an example: put those of your machine in their place. SI units.',
        '# A line behind a # is an alternative, or for what this example has no need of.',
        '# Under drive, controller and parameters, a list holds one entry for each drive.',
        '# `ident check --machine THIS_FILE` says what is missing or implausible, with the line.',
    ]
    for section, keys in groupby(kind.keys, key=lambda key: key.section):
        indent, boxed = '  ' if section else '', section == 'parameters'
        if section:
            note = '  # to be found; name: [least, largest, unit]' if boxed else ''
            lines += ['', f'{section}:{note}']
        for key in keys:
            if (value := (boxes or {} if boxed else given).get(key.name)) is not None:
                key = replace(key, shown=key.shown or not boxed or key.name in shown)
                lines += _lines(key, indent, value)
                continue
            if key.section in described and key.absent and (key.each or key.default is None):
                key = replace(key, shown=False)
            if drives and key.each and key.constant and isinstance(key.example, tuple):
                # The example machine has another number of drives.
                key = replace(key, example=tuple(islice(cycle(key.example), len(drives))))
            lines += _lines(key, indent, literal(key))
    return '\n'.join(lines) + '\n'


def _lines(key: Key, indent: str, value: str) -> list[str]:
    """Return a key's line, and below it what its comment needs more."""
    unit = '' if key.section == 'parameters' else key.unit
    text = '; '.join(filter(None, (unit, key.meaning, key.absent)))
    mark = '' if key.shown else '# '
    value, *entries = value.split('\n')
    start = f'{indent}{mark}{key.name}: {value}'
    first, *more = textwrap.wrap(text, _WIDTH - _COMMENT - 2)
    notes = (f'{"":<{_COMMENT}}# {rest}' for rest in more)
    return [f'{start:<{_COMMENT - 1}} # {first}', *notes, *entries]
