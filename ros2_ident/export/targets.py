# SPDX-License-Identifier: Apache-2.0
"""The kinds of files: their texts, what each cannot say, and how much of the gap that leaves."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from importlib import resources
import json
import math
from pathlib import Path
import re
from typing import Any

from ros2_ident.effects import get_effect
from ros2_ident.errors import ErrorCode
from ros2_ident.export.content import Content
from ros2_ident.export.descriptions import drake, followers, gazebo, is_urdf, massless, mjcf, urdf
from ros2_ident.export.laws import is_law
from ros2_ident.export.usd import can_write, usd
from ros2_ident.files import make_directory, mark, require_ours, write_text
from ros2_ident.machine.keys import written
from ros2_ident.models.drives.joints import Joint, PARTS
from ros2_ident.models.mujoco.plant import can_convert
from ros2_ident.words.figures import joined

_ISAAC = (
    '# Keyword arguments of isaaclab.actuators.ImplicitActuatorCfg of Isaac Lab 3. Efforts in\n'
    '# N m or N; friction too, in PhysX: in OVPhysX it is a coefficient. What is missing or null\n'
    '# is taken from the USD.\n'
)
_ROS2_CONTROL = (
    '# Gains of a joint_trajectory_controller that commands efforts, and limits of the joints.\n'
    '# Efforts at the joint, N m or N: where the hardware takes that of the motor, divide by the\n'
    '# gear factor.\n'
)


def loader(text: str, content: Content, name: str) -> str:
    """Return a module in Python that loads `robot.urdf` and adds what it has no place for.

    Args:
        text: The URDF.
        content: What was identified.
        name: Of a file in `loaders/`.
    """
    of = content.beside if 'laws' in TARGETS[name].holds else content.joints
    rows = {j.name: {part: float(getattr(j, part)) for part in PARTS} for j in of}
    joints = ''.join(f'    {joint!r}: {row},\n' for joint, row in rows.items())
    template = resources.files(__package__).joinpath(f'loaders/{name}.txt').read_text('utf-8')
    filled = template.replace(
        'JOINTS = {}', f'# N m s/rad, N m, kg m^2; N s/m, N, kg\nJOINTS = {{\n{joints}}}'
    )
    if is_urdf(text):
        filled = filled.replace('MASSLESS = []', f'MASSLESS = {[*massless(text)]}')
    laws = resources.files(__package__).joinpath('loaders/laws.txt').read_text('utf-8')
    filled = filled.replace('LAWS = []\n', laws.replace('LAWS = []', _laws(content)))
    return f'# {mark("export")}\n{filled}'


def _laws(content: Content) -> str:
    """Return functions of effects, and by joint what each is called with."""
    each = [(joint, law) for joint, laws in content.laws.items() for law in laws]
    functions = dict.fromkeys(f'\n\n{law.source}\n' for _, law in each)
    rows = ''.join(
        f'    ({joint!r}, {law.effect}, {law.takes!r}, {law.values!r}, {dict(law.state)!r}),\n'
        for joint, law in each
    )
    head = '# Joint, effect, its effort at the joint, N m or N, by value; parameters, constants.\n'
    return f'{"".join(functions)}\n\n{head}LAWS = [\n{rows}]' if each else 'LAWS = []'


def isaac(_: str, content: Content) -> str:
    """Return the actuators of a robot as Isaac Lab has them."""
    fields: dict[str, Callable[[Joint], float | None]] = {
        'joint_effort_limit': lambda j: j.limit if math.isfinite(j.limit) else None,
        'stiffness': lambda j: j.gains.p if j.gains else None,
        'damping': lambda j: j.gains.d if j.gains else None,
        'armature': lambda j: j.armature,
        'friction': lambda j: j.coulomb,
        'dynamic_friction': lambda j: j.coulomb,
        'viscous_friction': lambda j: j.viscous,
    }
    # All of these names are regular expressions.
    exact = {j.name: re.escape(j.name) for j in content.joints}
    data: dict[str, Any] = {'joint_names_expr': [*exact.values()]}
    for name, of in fields.items():
        values = {exact[j.name]: float(v) for j in content.joints if (v := of(j)) is not None}
        # Without a value the class wants a null there.
        data |= {name: values} if values else dict.fromkeys({name} & {'stiffness', 'damping'})
    return f'# {mark("export")}\n{_ISAAC}' + written(data)


def ros2_control(_: str, content: Content) -> str:
    """Return gains and limits as controllers of ros2_control read them."""
    gains = {j.name: j.gains for j in content.joints if j.gains is not None}
    controller = {
        'joints': [*gains],
        'command_interfaces': ['effort'],
        'state_interfaces': ['position', 'velocity'],
        # The controller's D sees the whole set-point's speed; what the machine's does not see of
        # it is taken off again.
        'gains': {
            name: {
                **{x: float(getattr(g, x)) for x in 'pid'},
                'ff_velocity_scale': float(g.d * (g.share - 1.0)),
            }
            for name, g in gains.items()
        },
    }
    data: dict[str, Any] = {'joint_trajectory_controller': {'ros__parameters': controller}}
    limits = {
        j.name: {'has_effort_limits': True, 'max_effort': float(j.limit)}
        for j in content.joints
        if math.isfinite(j.limit)
    }
    if limits:
        data['joint_limits'] = limits
    return f'# {mark("export")}\n{_ROS2_CONTROL}' + written(data)


# ---------------------------------------------------------------------- files


@dataclass(frozen=True)
class Target:
    """A kind of file.

    Attributes:
        title: What it is called in sentences.
        file: Name of the file.
        write: Its text, of a description (empty where it needs none) and what is exported.
        of: Descriptions that it is made of, `urdf` and `mjcf`; none where it needs none.
        holds: What it has a place for: of `PARTS`, and `p`, `i`, `d` and `f` (the set-point's
            speed) of a controller's gains.
        massless: What it makes of a URDF's links without mass.
        follows: What it makes of a URDF's joints that follow others.
        beside: Other targets whose files it reads.
    """

    title: str
    file: str
    write: Callable[[str, Content], str]
    of: frozenset[str]
    holds: frozenset[str]
    massless: str = ''
    follows: str = ''
    beside: tuple[str, ...] = ()


def _loaded(title: str, massless: str, follows: str, *holds: str) -> tuple[str, Target]:
    """Return a simulator that a module in Python loads `robot.urdf` into, and its name."""
    name = title.lower()
    return name, Target(
        title, f'load_{name}.py', partial(loader, name=name), _URDF,
        frozenset({'viscous', 'coulomb', *holds}), massless, follows, ('urdf',),
    )  # fmt: skip


_URDF, _ANY = frozenset({'urdf'}), frozenset({'urdf', 'mjcf'})
TARGETS = {
    'urdf': Target('URDF', 'robot.urdf', urdf, _URDF, frozenset({'viscous', 'coulomb'})),
    'mjcf': Target(
        'MuJoCo', 'robot.xml', mjcf, _ANY, frozenset({*PARTS, 'p', 'd', 'command_delay'}),
        'weigh 1e-9 kg', 'are coupled by a soft constraint',
    ),
    'mjcf_effects': Target(
        'MuJoCo with effects', 'load_mujoco.py', partial(loader, name='mjcf_effects'), _ANY,
        frozenset({*PARTS, 'p', 'd', 'command_delay', 'laws'}), beside=('mjcf',),
    ),
    'drake': Target(
        'Drake', 'drake.urdf', drake, _URDF, frozenset({'viscous', 'armature'}),
        'weigh 0 kg', 'are coupled, in discrete time only',
    ),
    'gazebo': Target(
        'Gazebo', 'gazebo.urdf', gazebo, _URDF, frozenset({'viscous', 'coulomb'}),
        'weigh 1e-5 kg', 'are coupled',
    ),
    **dict((
        _loaded('pinocchio', 'weigh 0 kg', 'move by themselves', 'armature', 'laws'),
        _loaded('PyBullet', 'weigh 0 kg', 'move by themselves'),
        _loaded('SAPIEN', 'weigh 1e-6 kg', 'are coupled wrongly', 'armature', 'laws'),
        _loaded('Genesis', 'weigh almost nothing', 'are coupled', 'armature'),
        _loaded('Newton', 'weigh 1e-6 kg', 'are coupled', 'armature', 'laws'),
    )),
    'usd': Target(
        'USD', 'robot.usda', usd, _URDF, frozenset({*PARTS, 'p', 'd'}),
        'weigh 1e-5 kg', 'are coupled',
    ),
    'isaac': Target(
        'Isaac Lab', 'isaac.yaml', isaac, frozenset(), frozenset({*PARTS, 'p', 'd'})
    ),
    'ros2_control': Target(
        'ros2_control', 'ros2_control.yaml', ros2_control, frozenset(), frozenset('pidf')
    ),
}  # fmt: skip
SUMMARY = 'export.json'


def fitting(content: Content, description: str) -> tuple[str, ...]:
    """Return the targets that this machine and description can fill, with what is installed."""
    return tuple(name for name in TARGETS if not _lack(name, content, description))


def _lack(name: str, content: Content, description: str) -> str:
    """Return why a target cannot be filled, with the remedy; empty where it can."""
    of, own = TARGETS[name].of, 'urdf' if is_urdf(description) else 'mjcf'
    if of and not (description and own in of):
        kinds = ' or '.join(sorted(of)).upper()
        return (
            f'there is no {kinds} to write into; give one with --into, or as '
            'geometry.description of the machine file'
        )
    if name == 'ros2_control' and not any(joint.gains for joint in content.joints):
        return 'the machine file knows no gains; add position_gain and velocity_gain to controller'
    if name == 'mjcf_effects' and not content.laws:
        return 'no effect was found that needs it; mjcf has all'
    if own == 'urdf' and name in ('mjcf', 'mjcf_effects') and not can_convert():
        return 'it needs MuJoCo; `pip install mujoco`'
    if name == 'usd' and not can_write():
        return 'it needs its converter; `pip install urdf-usd-converter`'
    return ''


def write(
    directory: str | Path, names: tuple[str, ...], content: Content, description: str
) -> dict[str, tuple[Path, tuple[str, ...]]]:
    """Write the files of some targets, and `export.json` with what they cannot say.

    Args:
        directory: Is made where it does not exist.
        names: Of `TARGETS`.
        description: URDF or MJCF to write into; empty where there is none.

    Returns:
        By target the file, and what it cannot say in sentences.

    Raises:
        IdentError: INVALID_GOAL or BAD_MACHINE_FILE with the remedy; nothing is written then. The
            description is not replaced, wherever it was read from.
    """
    for name in names:
        if why := _lack(name, content, description):
            raise ErrorCode.INVALID_GOAL.error(f'nothing can be written for {name}: {why}')
    names = tuple(dict.fromkeys(x for n in names for x in (*TARGETS[n].beside, n)))
    texts = {name: TARGETS[name].write(description, content) for name in names}
    paths = {name: Path(directory) / TARGETS[name].file for name in names}
    require_ours([*paths.values(), Path(directory) / SUMMARY])
    read = [x for x in paths.values() if x.is_file() and x.read_text('utf-8') == description]
    require_ours(read, read)
    folder = make_directory(directory)
    missed = {x: content.missed(TARGETS[x].holds) for x in names}
    told = {x: tuple(sentences(content, TARGETS[x], description, missed[x])) for x in names}
    links = content.links
    whole = {
        'schema': 'ros2_ident.export',
        'version': 1,
        'spread': content.spread if links else None,
        'mended': list(links.mended) if links else [],
        'targets': {
            x: {'file': TARGETS[x].file, 'left_out': told[x], 'joints': missed[x]} for x in names
        },
    }
    files = {name: write_text(paths[name], text) for name, text in texts.items()}
    write_text(folder / SUMMARY, json.dumps(whole, indent=1) + '\n')
    return {name: (files[name], told[name]) for name in names}


def sentences(
    content: Content, target: Target, description: str, missed: Mapping[str, Mapping[str, Any]]
) -> Iterator[str]:
    """Yield what a target cannot say of this machine, and how much that leaves.

    Args:
        missed: What `Content.missed` returns for it.
    """
    rows = missed if target.of else {}
    lacking = list(_lacking(content, target, rows))
    if lacking:
        yield f'{target.title} has no place for {joined(lacking)}'
    if rows and not target.beside:
        kept = {joint: _kept(row) for joint, row in rows.items()}
        least = min(kept, key=lambda joint: kept[joint])
        worse = [joint for joint in rows if kept[joint] < 0.0]
        says = f'it keeps {100 * kept[least]:.1f} % or more of the improvement on each joint'
        row = rows[least]
        yield (
            f'{f"it is worse than as described on {joined(worse)}" if worse else says}; '
            f'least on {least}, RMS in {row["unit"]}: {row["missed_as_described"]:.3g} as '
            f'described, {row["missed_as_exported"]:.3g} exported, '
            f'{row["missed_as_identified"]:.3g} identified'
        )
    if content.logged and not target.beside:
        logged = joined(sorted({at.effect for at in content.logged}))
        yield f'{logged}: left out, as it describes the log, not the machine'
    if content.effects and rows and not target.beside:
        yield (
            'friction of joints with effects is the best approximation of friction and effects '
            'together along this log'
        )
    if target.massless and is_urdf(description):
        if names := massless(description):
            yield f'links without mass {target.massless}: {joined(names)}'
        if names := followers(description):
            yield f'joints that follow others {target.follows}: {joined(names)}'


def _kept(missed: Mapping[str, Any]) -> float:
    """Return the share of the improvement over the description that a joint keeps.

    Below zero where it is worse than described.
    """
    described, exported, identified = (
        missed[f'missed_as_{x}'] ** 2 for x in ('described', 'exported', 'identified')
    )
    if described <= identified:
        return 1.0
    return min(float((described - exported) / (described - identified)), 1.0)


_PARTS = {
    'armature': 'the inertia of motors and gears',
    'coulomb': 'Coulomb friction',
    'viscous': 'viscous friction',
}


def _lacking(
    content: Content, target: Target, rows: Mapping[str, Mapping[str, Any]]
) -> Iterator[str]:
    """Yield what a target has no place for, with what it costs on the joint where most."""
    joints = content.identified
    for part in PARTS if target.of else ():
        if part in target.holds or not any(getattr(j, part) > 0.0 for j in content.joints):
            continue
        if not rows:
            yield _PARTS[part]
            continue
        most = max(rows, key=lambda name: rows[name]['cost'][part] / rows[name]['effort'])
        row = rows[most]
        yield (
            f'{_PARTS[part]} ({row["cost"][part]:.3g} of {row["effort"]:.3g} {row["unit"]} RMS on '
            f'{most}, the largest share)'
        )
    least = min(joints, key=lambda j: j.armature)
    if least.armature < 0.0:
        unit = 'kg m^2' if least.travel == 'rad' else 'kg'
        yield (
            'an inertia of motors and gears below zero, which makes up for links '
            f'({least.name} {least.armature:.3g} {unit}, the largest)'
        )
    shifted = max(joints, key=lambda j: abs(j.offset))
    if shifted.offset != 0.0:
        unit = 'N m' if shifted.travel == 'rad' else 'N'
        yield f'a constant in the effort ({shifted.name} {shifted.offset:.3g} {unit}, the largest)'
    for at in content.effects:
        if at.effect in target.holds or ('laws' in target.holds and is_law(get_effect(at.effect))):
            continue
        yield f'{at.effect} of {at.where}' if at.where != 'all' else at.effect
    if not target.holds & {*'pidf'}:
        return
    controlled = [j for j in joints if j.gains is not None]
    if 'i' not in target.holds and any(j.gains and j.gains.i for j in controlled):
        yield "the integral part of the controllers' law"
    ahead = [j for j in controlled if j.gains and j.gains.share * j.gains.d]
    if 'f' not in target.holds and ahead:
        yield "the set-point's speed in the controllers' law"
    known = {'command_delay'} & {*target.holds, *(at.effect for at in content.effects)}
    if content.delays and not known:
        yield 'how late controllers take their set-points up'
