# SPDX-License-Identifier: Apache-2.0
"""The kinds of files: their texts, what each cannot say, and how much of the gap that leaves."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from importlib import resources
from importlib.util import find_spec
import json
import math
from pathlib import Path
import re
from typing import Any

from ros2_ident.effects import get_effect
from ros2_ident.errors import ErrorCode
from ros2_ident.export import descriptions, usd
from ros2_ident.export.content import Content
from ros2_ident.export.laws import is_law
from ros2_ident.files import make_directory, mark, require_ours, write_text
from ros2_ident.machine.keys import written
from ros2_ident.models.drives.joints import Joint, PARTS
from ros2_ident.models.mujoco.model import Mujoco
from ros2_ident.models.mujoco.plant import can_convert
from ros2_ident.words.figures import joined


def _text(name: str) -> str:
    return resources.files(__package__).joinpath(f'texts/{name}.txt').read_text('utf-8')


def _marked(*parts: str) -> str:
    return ''.join((f'# {mark("export")}\n', *parts))


def _loader(text: str, content: Content, name: str) -> str:
    """Return a module in Python that loads a description and adds what it has no place for."""
    of = content.beside if 'laws' in TARGETS[name].holds else content.joints
    late = content.delays
    every = [(joint, law) for joint, laws in content.laws.items() for law in laws]
    functions = dict.fromkeys(f'\n\n{law.source}\n' for _, law in every)
    filled = _text(name).replace('LAWS = []\n', ''.join((*functions, _text('laws'))))
    massless = descriptions.odd(text)['links without mass']
    filled = filled.replace('MASSLESS = []', f'MASSLESS = {massless}')
    laws = [
        f'({joint!r}, {law.effect}, {law.takes!r}, {law.values!r}, {dict(law.state)!r})'
        for joint, law in every
    ]
    joints = [f'{j.name!r}: { {x: float(getattr(j, x)) for x in PARTS} }' for j in of]
    gains = [
        f'{j.name!r}: { {"p": g.p, "d": g.d, "limit": j.limit, "late": late.get(j.name, 0.0)} }'
        for j in content.joints
        if (g := j.gains) is not None
    ]
    for empty, rows in (('JOINTS = {}', joints), ('GAINS = {}', gains), ('LAWS = []', laws)):
        inside = ''.join(f'    {row},\n' for row in rows)
        filled = filled.replace(empty, f'{empty[:-1]}\n{inside}{empty[-1]}' if rows else empty)
    return _marked(filled)


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
    late = f'# Here, s: {content.delays}\n' if content.delays else ''
    return _marked(_text('isaac'), late, written(data))


def ros2_control(_: str, content: Content) -> str:
    """Return gains and limits as controllers of ros2_control read them."""
    gains = {
        # The controller's D sees the whole set-point's speed; what the machine's does not see of
        # it is taken off again.
        j.name: {'p': g.p, 'i': g.i, 'd': g.d, 'ff_velocity_scale': g.d * (g.share - 1.0)}
        for j in content.joints
        if (g := j.gains) is not None
    }
    controller = {
        'joints': [*gains],
        'command_interfaces': ['effort'],
        'state_interfaces': ['position', 'velocity'],
        'gains': gains,
    }
    data: dict[str, Any] = {'joint_trajectory_controller': {'ros__parameters': controller}}
    limits = {j.name: j.limit for j in content.joints if math.isfinite(j.limit)}
    if limits:
        data['joint_limits'] = {
            name: {'has_effort_limits': True, 'max_effort': most} for name, most in limits.items()
        }
    return _marked(_text('ros2_control'), written(data))


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
        alone: Whether the meshes are in it, not named by it.
    """

    title: str
    file: str
    write: Callable[[str, Content], str]
    of: tuple[str, ...]
    holds: tuple[str, ...]
    massless: str = ''
    follows: str = ''
    beside: tuple[str, ...] = ()
    alone: bool = False


def _loaded(title: str, massless: str, follows: str, *holds: str) -> Target:
    """Return a simulator that a module in Python loads `robot.urdf` into."""
    name, held = title.lower(), ('viscous', 'coulomb', *holds)
    load, file = partial(_loader, name=name), f'load_{name}.py'
    return Target(title, file, load, ('urdf',), held, massless, follows, beside=('urdf',))


_URDF, _ANY, _DRY = ('urdf',), ('urdf', 'mjcf'), ('viscous', 'coulomb')
_SERVO = *PARTS, 'p', 'd'
TARGETS = {
    'urdf': Target('URDF', 'robot.urdf', descriptions.urdf, _URDF, _DRY),
    'mjcf': Target(
        'MuJoCo', 'robot.xml', descriptions.mjcf, _ANY, (*_SERVO, 'command_delay'),
        'weigh 1e-9 kg', 'are coupled by a soft constraint',
    ),
    'mjcf_effects': Target(
        'MuJoCo with effects', 'load_mujoco.py', partial(_loader, name='mjcf_effects'), _ANY,
        (*_SERVO, 'command_delay', 'laws'), beside=('mjcf',),
    ),
    'drake': Target(
        'Drake', 'drake.urdf', descriptions.drake, _URDF, ('viscous', 'armature'),
        'weigh 0 kg', 'are coupled, in discrete time only',
    ),
    'gazebo': Target(
        'Gazebo', 'gazebo.urdf', descriptions.gazebo, _URDF, _DRY,
        'weigh 1e-5 kg', 'are coupled',
    ),
    'pinocchio': _loaded('pinocchio', 'weigh 0 kg', 'move by themselves', 'armature', 'laws'),
    'pybullet': _loaded('PyBullet', 'weigh 0 kg', 'move by themselves', 'laws'),
    'sapien': _loaded('SAPIEN', 'weigh 1e-6 kg', 'are coupled wrongly', 'armature', 'laws'),
    'genesis': _loaded('Genesis', 'weigh almost nothing', 'are coupled', 'armature', 'laws'),
    'newton': _loaded(
        'Newton', 'weigh 1e-6 kg', 'are coupled', 'armature', 'laws', 'p', 'd', 'command_delay'
    ),
    'usd': Target(
        'USD', 'robot.usda', usd.usd, _ANY, _SERVO, 'weigh 1e-5 kg', 'are coupled',
        alone=True,
    ),
    'isaac': Target('Isaac Lab', 'isaac.yaml', isaac, (), _SERVO),
    'ros2_control': Target('ros2_control', 'ros2_control.yaml', ros2_control, (), tuple('pidf')),
}  # fmt: skip
SUMMARY = 'export.json'


def fitting(content: Content, description: str) -> tuple[str, ...]:
    """Return the targets that this machine and description can fill, with what is installed."""
    return tuple(name for name in TARGETS if not _lack(name, content, description))


def _lack(name: str, content: Content, description: str) -> str:
    """Return why a target cannot be filled, with the remedy; empty where it can."""
    if name not in ('mjcf', 'usd') and isinstance(content.model, Mujoco):
        return (
            f'a machine of the kind {content.model.name} goes back into its MJCF; give --to mjcf '
            'or usd'
        )
    of, own = TARGETS[name].of, 'urdf' if descriptions.is_urdf(description) else 'mjcf'
    if of and not (description and own in of):
        kinds = ' or '.join(reversed(of)).upper()
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
    if name == 'usd' and find_spec(converter := usd.CONVERTERS[own]) is None:
        return f'it needs its converter; `pip install {converter.replace("_", "-")}`'
    return ''


def write(
    directory: str | Path,
    names: tuple[str, ...],
    content: Content,
    description: str,
    folder: Path | None = None,
) -> dict[str, tuple[Path, tuple[str, ...]]]:
    """Write the files of some targets, and `export.json` with what they cannot say.

    Args:
        directory: Is made where it does not exist.
        names: Of `TARGETS`.
        description: URDF or MJCF to write into; empty where there is none.
        folder: Where it lies, and the files that it names; None where that is not known.

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
    ways = {False: Path(directory), True: None}
    text = {
        alone: description if folder is None else descriptions.moved(description, folder, to)
        for alone, to in ways.items()
    }
    texts = {name: TARGETS[name].write(text[TARGETS[name].alone], content) for name in names}
    paths = {name: Path(directory) / TARGETS[name].file for name in names}
    require_ours([*paths.values(), Path(directory) / SUMMARY])
    read = [x for x in paths.values() if x.is_file() and x.read_text('utf-8') == description]
    require_ours(read, read)
    make_directory(directory)
    links = content.links
    missed = {x: content.missed(TARGETS[x].holds) for x in names}
    told = {x: tuple(sentences(content, TARGETS[x], description, missed[x])) for x in names}
    whole = {
        'schema': 'ros2_ident.export',
        'version': 1,
        'spread': content.spread if links else None,
        'mended': list(links.mended) if links else [],
        'targets': {
            x: {'file': TARGETS[x].file, 'left_out': told[x], 'joints': missed[x]} for x in names
        },
    }
    files = {x: (write_text(paths[x], text), told[x]) for x, text in texts.items()}
    write_text(Path(directory) / SUMMARY, json.dumps(whole, indent=1) + '\n')
    return files


def sentences(
    content: Content, target: Target, description: str, missed: Mapping[str, Mapping[str, Any]]
) -> Iterator[str]:
    """Yield what a target cannot say of this machine, and how much that leaves.

    Args:
        missed: What `Content.missed` returns for it.
    """
    rows = missed if target.of else {}
    if lacking := [*_lacking(content, target, rows)]:
        yield f'{target.title} has no place for {joined(lacking)}'
    if not target.beside:  # else the file beside it says so
        if rows:
            yield _improvement(rows)
        if content.logged:
            logged = joined(sorted({at.effect for at in content.logged}))
            yield f'{logged}: left out, as it describes the log, not the machine'
        if content.effects and rows:
            yield (
                'friction of joints with effects is the best approximation of friction and '
                'effects together along this log'
            )
    if target.massless:
        made = target.massless, target.follows
        for (kind, names), how in zip(descriptions.odd(description).items(), made, strict=True):
            if names:
                yield f'{kind} {how}: {joined(names)}'


def _improvement(rows: Mapping[str, Mapping[str, Any]]) -> str:
    """Say how much of the improvement over the description each joint keeps at least."""
    kept = {}
    for joint, row in rows.items():
        described, exported, identified = (
            row[f'missed_as_{x}'] ** 2 for x in ('described', 'exported', 'identified')
        )
        better = described - identified  # below zero: worse than described
        kept[joint] = min((described - exported) / better, 1.0) if better > 0.0 else 1.0
    least = min(kept, key=lambda joint: kept[joint])
    worse, row = [joint for joint in rows if kept[joint] < 0.0], rows[least]
    says = f'it keeps {100 * kept[least]:.1f} % or more of the improvement on each joint'
    return (
        f'{f"it is worse than as described on {joined(worse)}" if worse else says}; '
        f'least on {least}, RMS in {row["unit"]}: {row["missed_as_described"]:.3g} as '
        f'described, {row["missed_as_exported"]:.3g} exported, '
        f'{row["missed_as_identified"]:.3g} identified'
    )


_PARTS = {
    'armature': 'the inertia of motors and gears',
    'coulomb': 'Coulomb friction',
    'viscous': 'viscous friction',
}


def _lacking(
    content: Content, target: Target, rows: Mapping[str, Mapping[str, Any]]
) -> Iterator[str]:
    """Yield what a target has no place for, with what it costs on the joint where most."""
    joints, holds = content.identified, target.holds
    for part in PARTS if target.of else ():
        if part not in holds and any(getattr(j, part) > 0.0 for j in content.joints):
            price = ''
            if rows:
                most = max(rows, key=lambda name: rows[name]['cost'][part] / rows[name]['effort'])
                row = rows[most]
                told = f'{row["cost"][part]:.3g} of {row["effort"]:.3g} {row["unit"]}'
                price = f' ({told} RMS on {most}, the largest share)'
            yield f'{_PARTS[part]}{price}'
    below = 'an inertia of motors and gears below zero, which makes up for links'
    for what, values, units in (
        (below, [min(j.armature, 0.0) for j in joints], ('kg m^2', 'kg')),
        ('a constant in the effort', [j.offset for j in joints], ('N m', 'N')),
    ):
        size = max(values, key=abs, default=0.0)
        if size:
            joint = joints[values.index(size)]
            yield f'{what} ({joint.name} {size:.3g} {units[joint.travel == "m"]}, the largest)'
    for at in content.effects:
        if not (at.effect in holds or ('laws' in holds and is_law(get_effect(at.effect)))):
            yield f'{at.effect} of {at.where}' if at.where != 'all' else at.effect
    if not {*'pidf'} & {*holds}:
        return
    gains = [j.gains for j in joints if j.gains is not None]
    if 'i' not in holds and any(g.i for g in gains):
        yield "the integral part of the controllers' law"
    if 'f' not in holds and any(g.share * g.d for g in gains):
        yield "the set-point's speed in the controllers' law"
    if content.delays and 'command_delay' not in {*holds, *(at.effect for at in content.effects)}:
        yield 'how late controllers take their set-points up'
