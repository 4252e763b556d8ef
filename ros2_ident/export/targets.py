# SPDX-License-Identifier: Apache-2.0
"""The kinds of files: their texts, what each cannot say, and how much of the gap that leaves."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
import json
import math
from pathlib import Path
import re
from typing import Any
import xml.etree.ElementTree as ET

import numpy as np

from ros2_ident.errors import ErrorCode
from ros2_ident.export.content import Content
from ros2_ident.files import make_directory, mark, require_ours, write_text
from ros2_ident.machine.keys import written
from ros2_ident.models.drives.joints import Gains, Joint
from ros2_ident.words.figures import joined

_ISAAC = (
    '# Keyword arguments of isaaclab.actuators.ImplicitActuatorCfg. Efforts in N m or N, as\n'
    '# Isaac Sim reads friction from version 5.0 on; what is missing is taken from the USD.\n'
)
_ROS2_CONTROL = (
    '# Gains of a joint_trajectory_controller that commands efforts, and limits of the joints.\n'
    '# Efforts at the joint, N m or N: where the hardware takes that of the motor, divide by the\n'
    '# gear factor.\n'
)


# ---------------------------------------------------------------------- texts


def urdf(text: str, content: Content) -> str:
    """Return a URDF with identified inertials, damping and friction; everything else as it was.

    Raises:
        IdentError: BAD_MACHINE_FILE where a joint or link is not in it.
    """
    root, remedy = _parsed(text), 'give the one that the machine file names'
    for name, mass, centre, inertia in content.inertials():
        new = ET.Element('inertial')
        ET.SubElement(new, 'origin', xyz=_numbers(centre), rpy='0 0 0')
        ET.SubElement(new, 'mass', value=_number(mass))
        upper = [(i, j) for i in range(3) for j in range(i, 3)]
        values = {f'i{"xyz"[i]}{"xyz"[j]}': _number(inertia[i, j]) for i, j in upper}
        ET.SubElement(new, 'inertia', values)
        _put_inertial(_named(root.findall('link'), 'link', name, remedy), new)
    for joint in content.joints:
        element = _named(root.findall('joint'), 'joint', joint.name, remedy)
        found = element.find('dynamics')
        if found is None:
            found = ET.SubElement(element, 'dynamics')
        found.set('damping', _number(joint.viscous))
        found.set('friction', _number(joint.coulomb))
    return _written(root)


def mjcf(text: str, content: Content) -> str:
    """Return an MJCF with identified inertials, joint attributes and position actuators.

    Raises:
        IdentError: BAD_MACHINE_FILE where a joint or body is not in it.
    """
    root, remedy = _parsed(text), 'name it there as the bag does'
    for compiler in root.findall('compiler'):
        # What is written has to count, whatever shapes the bodies have.
        if compiler.get('inertiafromgeom') == 'true':
            compiler.set('inertiafromgeom', 'auto')
    for name, mass, centre, inertia in content.inertials():
        full = [inertia[place] for place in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        new = ET.Element('inertial', pos=_numbers(centre), mass=_number(mass))
        new.set('fullinertia', _numbers(full))
        _put_inertial(_named(root.iter('body'), 'body', name, remedy), new)
    for joint in content.joints:
        element = _named(root.iter('joint'), 'joint', joint.name, remedy)
        element.set('damping', _number(joint.viscous))
        element.set('frictionloss', _number(joint.coulomb))
        element.set('armature', _number(joint.armature))
        if joint.gains is not None:
            _actuator(root, joint, joint.gains)
    return _written(root)


def _actuator(root: ET.Element, joint: Joint, gains: Gains) -> None:
    """Put a position actuator in the place of whatever drives a joint."""
    actuators = root.find('actuator')
    if actuators is None:
        actuators = ET.SubElement(root, 'actuator')
    name = joint.name
    for old in [a for a in actuators if a.get('joint') == joint.name]:
        name = old.get('name', name)
        actuators.remove(old)
    new = ET.SubElement(actuators, 'position', name=name, joint=joint.name)
    new.set('kp', _number(gains.p))
    new.set('kv', _number(gains.d))
    if math.isfinite(joint.limit):
        new.set('forcelimited', 'true')
        new.set('forcerange', _numbers((-joint.limit, joint.limit)))


def _parsed(text: str) -> ET.Element:
    """Return the root of a description that is judged, its comments kept."""
    return ET.fromstring(text, ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))


def _written(root: ET.Element) -> str:
    """Return the text of a description."""
    ET.indent(root)
    text = ET.tostring(root, encoding='unicode')
    return f"<?xml version='1.0' encoding='utf-8'?>\n<!-- {mark('export')} -->\n{text}\n"


def _number(value: float) -> str:
    """Return a number's text with all of its digits."""
    return repr(float(value))


def _numbers(values: Iterable[float]) -> str:
    """Return the text of several numbers, blanks between."""
    return ' '.join(_number(value) for value in values)


def _named(elements: Iterable[ET.Element], tag: str, name: str, remedy: str) -> ET.Element:
    """Return the element of a name, among those of a tag.

    Raises:
        IdentError: BAD_MACHINE_FILE with the remedy where there is none.
    """
    for element in elements:
        if element.get('name') == name:
            return element
    raise ErrorCode.BAD_MACHINE_FILE.error(f'the description has no {tag} {name}; {remedy}')


def _put_inertial(body: ET.Element, new: ET.Element) -> None:
    """Put an inertial into a body, in the place of the one it has."""
    old = body.find('inertial')
    if old is not None:
        body.remove(old)
    body.insert(0, new)


def isaac(_: str, content: Content) -> str:
    """Return the actuators of a robot as Isaac Lab has them."""
    fields: dict[str, Callable[[Joint], float | None]] = {
        'effort_limit_sim': lambda j: j.limit if math.isfinite(j.limit) else None,
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
        data |= {name: values} if values else {}
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
                'p': float(g.p),
                'i': float(g.i),
                'd': float(g.d),
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
        described: Whether it is a description with these values written into it.
        armature: Whether it has a place for the inertia of motor and gear.
        gains: Whether it has a place for a controller's gains, and which parts of it.
    """

    title: str
    file: str
    write: Callable[[str, Content], str]
    described: bool
    armature: bool
    gains: frozenset[str]


TARGETS = {
    'urdf': Target('URDF', 'robot.urdf', urdf, True, False, frozenset()),
    'mjcf': Target('MJCF', 'robot.xml', mjcf, True, True, frozenset('pd')),
    'isaac': Target('Isaac Lab', 'isaac.yaml', isaac, False, True, frozenset('pd')),
    'ros2_control': Target(
        'ros2_control', 'ros2_control.yaml', ros2_control, False, False, frozenset('pidf')
    ),
}
SUMMARY = 'export.json'


def fitting(content: Content, description: str) -> tuple[str, ...]:
    """Return the targets that this machine and description can fill."""
    own = 'urdf' if '<robot' in description else 'mjcf'
    gains = any(joint.gains for joint in content.joints)
    return tuple(
        name
        for name, target in TARGETS.items()
        if (name == own and description if target.described else name != 'ros2_control' or gains)
    )


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
    wrong = next((name for name in names if name not in fitting(content, description)), None)
    if wrong is not None:
        why = (
            f'there is no {TARGETS[wrong].title} to write into; give one with --into, or as '
            'geometry.description of the machine file'
            if TARGETS[wrong].described
            else 'the machine file knows no gains; add position_gain and velocity_gain to '
            'controller'
        )
        raise ErrorCode.INVALID_GOAL.error(f'nothing can be written for {wrong}: {why}')
    texts = {name: TARGETS[name].write(description, content) for name in names}
    paths = {name: Path(directory) / TARGETS[name].file for name in names}
    require_ours([*paths.values(), Path(directory) / SUMMARY])
    read = [x for x in paths.values() if x.is_file() and x.read_text('utf-8') == description]
    require_ours(read, read)
    folder = make_directory(directory)
    told = {name: tuple(sentences(content, TARGETS[name])) for name in names}
    links = content.links
    whole = {
        'schema': 'ros2_ident.export',
        'version': 1,
        'spread': content.spread if links else None,
        'mended': list(links.mended) if links else [],
        'targets': {
            name: {
                'file': TARGETS[name].file,
                'left_out': told[name],
                'joints': content.missed(armature=TARGETS[name].armature),
            }
            for name in names
        },
    }
    files = {name: write_text(paths[name], text) for name, text in texts.items()}
    write_text(folder / SUMMARY, json.dumps(whole, indent=1) + '\n')
    return {name: (files[name], told[name]) for name in names}


def sentences(content: Content, target: Target) -> Iterator[str]:
    """Yield what a target cannot say of this machine, and how much that leaves."""
    lacking = list(_lacking(content, target))
    rows = content.missed(armature=target.armature)
    if lacking:
        yield f'{target.title} has no place for {joined(lacking)}'
    if rows and target.described:
        kept = {joint: _kept(row) for joint, row in rows.items()}
        least = min(kept, key=lambda joint: kept[joint] if np.isfinite(kept[joint]) else 1.0)
        row = rows[least]
        yield (
            f'it keeps {100 * kept[least]:.1f} % or more of the improvement on each joint; '
            f'least on {least}, RMS in {row["unit"]}: {row["missed_as_described"]:.3g} as '
            f'described, {row["missed_as_exported"]:.3g} exported, '
            f'{row["missed_as_identified"]:.3g} identified'
        )
    if content.logged:
        names = joined(sorted({at.effect for at in content.logged}))
        yield f'{names}: left out, as it describes the log, not the machine'
    if content.effects and content.links is not None and target.described:
        yield (
            'friction of joints with effects is the best approximation of friction and effects '
            'together along this log'
        )


def _kept(row: Mapping[str, Any]) -> float:
    """Return the share of what was identified beyond the description that a target keeps."""
    before = row['missed_as_described'] ** 2 - row['missed_as_identified'] ** 2
    after = row['missed_as_described'] ** 2 - row['missed_as_exported'] ** 2
    return float(np.clip(after / before, 0.0, 1.0)) if before > 0.0 else float('nan')


def _lacking(content: Content, target: Target) -> Iterator[str]:
    """Yield what a target has no place for."""
    joints = content.identified
    heavy = [j.name for j in joints if j.armature > 0.0]
    if heavy and not target.armature and target.described:
        yield f'the inertia of motors and gears ({joined(heavy)})'
    shifted = [j for j in joints if j.offset != 0.0]
    if shifted:
        most = max(shifted, key=lambda j: abs(j.offset))
        unit = 'N m' if most.travel == 'rad' else 'N'
        yield f'a constant in the effort ({most.name} {most.offset:.3g} {unit}, the largest)'
    for at in content.effects:
        yield f'{at.effect} of {at.where}' if at.where != 'all' else at.effect
    if not target.gains:
        return
    controlled = [j for j in joints if j.gains is not None]
    if 'i' not in target.gains and any(j.gains and j.gains.i for j in controlled):
        yield "the integral part of the controllers' law"
    ahead = [j for j in controlled if j.gains and j.gains.share * j.gains.d]
    if 'f' not in target.gains and ahead:
        yield "the set-point's speed in the controllers' law"
