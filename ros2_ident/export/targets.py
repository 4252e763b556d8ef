# SPDX-License-Identifier: Apache-2.0
"""The kinds of files, what each cannot say in sentences, and how much of the gap that leaves."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
import json
from pathlib import Path

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.export.content import Content
from ros2_ident.export.texts import isaac, mjcf, ros2_control, urdf
from ros2_ident.files import make_directory, require_ours, write_text
from ros2_ident.words.figures import joined


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
# Where consistent links leave this much more of a joint's effort, it is said; and what of the
# description's error is nothing.
_WORSE, _NOTHING = 1.05, 1e-2


def fitting(content: Content, description: str) -> tuple[str, ...]:
    """Return the targets that this machine and description can fill."""
    own = 'urdf' if '<robot' in description else 'mjcf'
    gains = any(joint.gains for joint in content.joints)
    return tuple(
        name
        for name, target in TARGETS.items()
        if (name == own and description if target.described else name != 'ros2_control' or gains)
    )


def require_fitting(name: str, content: Content, description: str) -> None:
    """Refuse a target that cannot be filled.

    Raises:
        IdentError: INVALID_GOAL with the remedy.
    """
    if name in fitting(content, description):
        return
    target = TARGETS[name]
    why = (
        f'there is no {target.title} to write into; give one with --into, or as '
        'geometry.description of the machine file'
        if target.described
        else 'the machine file knows no gains; add position_gain and velocity_gain to controller'
    )
    raise IdentError(ErrorCode.INVALID_GOAL, f'nothing can be written for {name}: {why}')


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
        require_fitting(name, content, description)
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
                'joints': _numbers(content, name),
            }
            for name in names
        },
    }
    files = {name: write_text(paths[name], text) for name, text in texts.items()}
    write_text(folder / SUMMARY, json.dumps(whole, indent=1) + '\n')
    return {name: (files[name], told[name]) for name in names}


def _numbers(content: Content, name: str) -> dict[str, dict[str, float | str]]:
    return {
        m.joint: {
            'unit': m.unit,
            'missed_as_described': m.described,
            'missed_as_exported': m.exported,
            'missed_with_consistent_links': m.consistent,
            'missed_as_identified': m.identified,
        }
        for m in content.missed(armature=TARGETS[name].armature)
    }


def sentences(content: Content, target: Target) -> Iterator[str]:
    """Yield what a target cannot say of this machine, and how much that leaves."""
    lacking = list(_lacking(content, target))
    rows = content.missed(armature=target.armature)
    if lacking:
        yield f'{target.title} has no place for {joined(lacking)}'
    if rows and target.described:
        least = min(rows, key=lambda m: m.closed if np.isfinite(m.closed) else 1.0)
        worse = max(rows, key=lambda m: m.consistent - _WORSE * m.identified)
        if worse.consistent > _WORSE * worse.identified + _NOTHING * worse.described:
            yield (
                'physically consistent links miss more than the fit, most on '
                f'{worse.joint}: {worse.consistent:.3g} instead of {worse.identified:.3g} '
                f'{worse.unit} RMS'
            )
        yield (
            f'it keeps {100 * least.closed:.1f} % or more of the improvement on each joint; '
            f'least on {least.joint}, RMS in {least.unit}: {least.described:.3g} as described, '
            f'{least.exported:.3g} exported, {least.identified:.3g} identified'
        )
    if content.logged:
        names = joined(sorted({at.effect for at in content.logged}))
        yield f'{names}: left out, as it describes the log, not the machine'
    if content.effects and content.links is not None and target.described:
        yield (
            'friction of joints with effects is the best approximation of friction and effects '
            'together along this log'
        )


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

