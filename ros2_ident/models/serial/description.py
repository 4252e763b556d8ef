# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a description, in words: pinocchio says little, and drops inertias."""

from collections.abc import Iterator
import math
import xml.etree.ElementTree as ElementTree

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.shown import name_of

_INERTIAS = ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')


def require_readable(text: str) -> None:
    """Refuse what is neither URDF nor MJCF, and a URDF of which links or joints would be lost.

    Args:
        text: The description.

    Raises:
        IdentError: BAD_MACHINE_FILE with the first thing that is wrong.
    """
    problem = next(_problems(text), None)
    if problem is not None:
        raise IdentError(ErrorCode.BAD_MACHINE_FILE, f'geometry.description {problem}')


def _problems(text: str) -> Iterator[str]:
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        yield f'is no XML ({error}); give a URDF or an MJCF file'
        return
    if any('xacro' in element.tag for element in root.iter()):
        yield 'is a xacro; give what `xacro arm.urdf.xacro > arm.urdf` makes of it'
    elif root.tag == 'robot':
        yield from _of_urdf(root)
    elif root.tag != 'mujoco':
        yield (
            f'has the root element {name_of(root.tag)}; give a URDF (robot) or an MJCF file '
            '(mujoco)'
        )


def _of_urdf(root: ElementTree.Element) -> Iterator[str]:
    if root.find('link') is None:
        yield 'has no link; give the whole URDF'
    for link in root.iterfind('link'):
        for inertial in link.iterfind('inertial'):
            yield from _of_inertial(inertial, f'link {name_of(link.get("name"))}')
    for joint in root.iterfind('joint'):
        # An axis of 0 stands in many a fixed one.
        if joint.get('type') in ('revolute', 'continuous', 'prismatic'):
            yield from _of_axis(joint.find('axis'), f'joint {name_of(joint.get("name"))}')


def _of_inertial(inertial: ElementTree.Element, where: str) -> Iterator[str]:
    for place, names in (('mass', ('value',)), ('inertia', _INERTIAS)):
        part = inertial.find(place)
        given = dict(part.attrib) if part is not None else {}
        for name in names:
            if not _number(given.get(name)):
                yield (
                    f'has no number as {place} {name} of {where} ({name_of(given.get(name))}); '
                    'mend it, or leave out the whole inertial'
                )


def _of_axis(axis: ElementTree.Element | None, where: str) -> Iterator[str]:
    given = '1 0 0' if axis is None else axis.get('xyz', '1 0 0')
    parts = given.split()
    if len(parts) != 3 or not all(map(_number, parts)) or not any(map(float, parts)):
        yield f'has the axis "{name_of(given)}" of {where}; give its direction'


def _number(text: str | None) -> bool:
    try:
        return text is not None and math.isfinite(float(text))
    except ValueError:
        return False
