# SPDX-License-Identifier: Apache-2.0
"""A URDF or an MJCF as plain XML, judged before a library in C++ sees it.

Such a library recurses as deep as a description goes, passes over what it does not understand, and
does not name what it refuses.
"""

from collections.abc import Collection, Iterator
import math
from pathlib import Path
import re
import xml.etree.ElementTree as ET

import numpy as np

from ros2_ident.errors import ErrorCode
from ros2_ident.files import read_small
from ros2_ident.machine.units import name_of, shown
from ros2_ident.recording.limits import unfit

_BYTES, _ELEMENTS, _BODIES, _DEPTH, _JOINTS, _FILES = 1 << 24, 100_000, 1_000, 250, 6, 100
# MuJoCo 4.0 knows 38 of an element `general`, the most of all.
_ATTRIBUTES = 100
# Types of joints that turn about one axis, or slide along it.
_TURN, SLIDE = ('revolute', 'continuous', 'hinge'), ('prismatic', 'slide')
_ATTRIBUTE = re.compile(r"""=\s*("[^"]*"|'[^']*')""")
# SI units: a limit of none is 1e16, squares are far from overflow; what may be a rounded 0.
_LARGEST, _NOTHING = 1e30, -1e-9
# Attributes of an MJCF of which an element has one: how it is turned, how a servo is damped.
_ONE_OF = ('quat', 'euler', 'axisangle', 'xyaxes', 'zaxis'), ('kv', 'dampratio')
_INERTIAS = ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')
_NEEDED = {'inertial/mass': ('value',), 'inertial/inertia': _INERTIAS}
_NUMBERS = frozenset((
    *_INERTIAS, 'value', 'xyz', 'rpy', 'lower', 'upper', 'effort', 'velocity', 'mass', 'density',
    'diaginertia', 'fullinertia', 'pos', 'quat', 'euler', 'axis',
))  # fmt: skip
# How many of their numbers, the first ones, cannot be below 0.
_FROM_ZERO = {
    'ixx': 1, 'iyy': 1, 'izz': 1, 'mass': 1, 'density': 1, 'diaginertia': 3, 'fullinertia': 3,
}  # fmt: skip


def description_text(path: Path) -> str:
    """Return what a description's file holds.

    Raises:
        IdentError: BAD_MACHINE_FILE where it cannot be read or is no text, or as `judged_tree`.
    """
    text = _read(path)
    if '<include' in text:
        root = _tree(text, path)
        _include(root, path.parent, path.parent, {path.resolve()})
        text = ET.tostring(root, encoding='unicode')
    judged_tree(text, path)
    return text


def _read(path: Path) -> str:
    try:
        return read_small(path, _BYTES).decode()
    except (OSError, ValueError) as error:
        reason = getattr(error, 'strerror', None) or 'it is no text in UTF-8'
        raise ErrorCode.BAD_MACHINE_FILE.error(
            f'{path}: cannot be read ({reason}); give a URDF or an MJCF file'
        ) from None


def _include(element: ET.Element, folder: Path, top: Path, read: set[Path]) -> None:
    """Put the files that an MJCF includes in their places, as MuJoCo does.

    Args:
        folder: Of the file that it stands in.
        top: Of the description: nothing outside of it is read.
        read: The files read so far; none is read twice, and their number is bounded.
    """
    for child in list(element):
        if child.tag != 'include':
            _include(child, folder, top, read)
            continue
        name = child.get('file', '')
        path = next((x for x in (folder / name, top / name) if x.is_file()), folder / name)
        known = path.resolve()
        if not known.is_relative_to(top.resolve()) or known in read or len(read) > _FILES:
            raise ErrorCode.BAD_MACHINE_FILE.error(
                f'{path}: is included and not read: from outside of {top}, twice, or after '
                f'{_FILES} others; give one MJCF, as mujoco.mj_saveLastXML writes it'
            )
        read.add(known)
        root = _tree(_read(path), path)
        _include(root, path.parent, top, read)
        at = list(element).index(child)
        element[at : at + 1] = list(root)


def judged_tree(
    text: str, named: object = 'geometry.description', shapes: bool = True, floats: bool = True
) -> ET.Element:
    """Return the root of a description in which nothing is found wrong; of a URDF its dynamics.

    Args:
        named: What to call it in messages.
        shapes: Whether the files of an MJCF's shapes are of use; what needs them, or is for the
            eye alone, is left out where not.
        floats: Whether its bodies may float; they are held as drawn where not.

    Raises:
        IdentError: BAD_MACHINE_FILE with the first thing that is wrong.
    """
    return judged(_tree(text, named), named, shapes, floats)


def judged(
    root: ET.Element, named: object = 'geometry.description', shapes: bool = True,
    floats: bool = True,
) -> ET.Element:  # fmt: skip
    """Return the root that it is given, if nothing is wrong in it, else as `judged_tree`."""
    problem = None
    if root.tag != 'robot':
        _state_defaults(root)
        _state_turns(root)
        for body, joint in floating(root) if not floats else ():
            body.remove(joint)
        if not shapes:
            problem = next(_of_shapes(root), None)
            _leave_out_shapes(root)
    problem = problem or next(_problems(root, shapes), None)
    if problem is not None:
        raise ErrorCode.BAD_MACHINE_FILE.error(f'{named} {problem}')
    return root


def _tree(text: str, named: object) -> ET.Element:
    """Return the root of a text that is bounded, and XML."""
    problem = next(_of_text(text), None)
    if problem is None:
        try:
            return ET.fromstring(text)  # noqa: S314 - without entities, and bounded
        except (ET.ParseError, ValueError) as error:
            problem = f'is no XML ({error}); give a URDF or an MJCF file'
    raise ErrorCode.BAD_MACHINE_FILE.error(f'{named} {problem}')


def declared(root: ET.Element, tag: str, name: str) -> dict[str, list[float]]:
    """Return the numbers of an attribute of an MJCF's joints, or of actuators, by the joint.

    Those for which neither they nor their class of defaults state it are left out.
    """
    return {
        element.get('joint', element.get('name', '')): [
            float(x) for x in element.attrib[name].split()
        ]
        for _, element in _elements(root)
        if element.tag == tag and element.get(name)
    }


def fall_of(root: ET.Element) -> tuple[float, float, float]:
    """Return the free fall along x, y and z that a description states, m/s^2; else the usual.

    Raises:
        IdentError: BAD_MACHINE_FILE where these are no three numbers.
    """
    stated = ['0', '0', '-9.81']
    for option in root.iterfind('option'):
        stated = option.get('gravity', ' '.join(stated)).split()
    if any(x.get('gravity') == 'disable' for x in root.iterfind('option/flag')):
        return 0.0, 0.0, 0.0
    if len(stated) != 3 or not all(_number(x, -_LARGEST) for x in stated):
        text = f'has the gravity {name_of(" ".join(stated))}; write three numbers'
        raise ErrorCode.BAD_MACHINE_FILE.error(f'geometry.description {text}')
    return float(stated[0]), float(stated[1]), float(stated[2])


def _elements(root: ET.Element) -> Iterator[tuple[list[ET.Element], ET.Element]]:
    """Yield what is in the bodies of an MJCF and among its actuators, after the bodies about it.

    These are the outermost first.
    """
    bodies: list[tuple[ET.Element, list[ET.Element]]] = [
        (x, []) for x in root if x.tag in ('worldbody', 'actuator')
    ]
    while bodies:
        body, about = bodies.pop()
        inside = [*about, body]
        for child in body:
            if child.tag in ('body', 'frame'):
                bodies.append((child, inside))
            else:
                yield inside, child


def _state_defaults(root: ET.Element) -> None:
    """Write into the elements of an MJCF what their classes of defaults state for them."""
    classes: dict[str, dict[str, dict[str, str]]] = {'': {}}
    # The outermost ones are one class, whatever it is called.
    level = [(x, '', '') for x in root.iterfind('default')]
    while level:
        default, name, above = level.pop(0)
        own = {tag: dict(stated) for tag, stated in classes[above].items()}
        for child in default:
            if child.tag != 'default':
                own[child.tag] = {**own.get(child.tag, {}), **child.attrib}
        classes[name] = own
        level += [(x, x.get('class', ''), name) for x in default.findall('default')]
    for about, element in _elements(root):
        usual = next((x.get('childclass', '') for x in reversed(about) if x.get('childclass')), '')
        stated = classes.get(element.get('class', usual), classes['']).get(element.tag, {})
        told = {x for group in _ONE_OF if {*group} & {*element.attrib} for x in group}
        for key, value in stated.items():
            if key != 'class' and key not in told:
                element.attrib.setdefault(key, value)


def _state_turns(root: ET.Element) -> None:
    """Write as quaternions the turns of an MJCF by an axis and an angle, or about fixed axes."""
    stated = {key: x for part in root.iterfind('compiler') for key, x in part.attrib.items()}
    unit = 1.0 if stated.get('angle') == 'radian' else math.pi / 180.0
    sequence = stated.get('eulerseq', 'xyz')
    if not re.fullmatch('[xyzXYZ]{3}', sequence):
        return  # no reader takes it
    for element in root.iter():
        name = 'axisangle' if 'axisangle' in element.attrib else 'euler' * (not sequence.islower())
        numbers = element.get(name, '').split()
        told = len(numbers) == 3 + (name == 'axisangle') and element.tag != 'replicate'
        if not (told and all(_number(x, -_LARGEST) for x in numbers)):
            continue  # wrong, or by how much copies turn
        from scipy.spatial.transform import Rotation  # hardly any description needs it

        values, whole = np.array(numbers, dtype=float), Rotation.identity()
        order = ['xyz'.index(x) for x in sequence.lower()]
        axes = np.eye(3)[order] if name == 'euler' else values[None, :3]
        for letter, axis, angle in zip(sequence, axes, values[-len(axes) :], strict=False):
            own = Rotation.from_rotvec(unit * angle * axis / max(np.linalg.norm(axis), 1e-300))
            # A lower letter is an axis that has turned along, an upper one stays.
            whole = whole * own if letter.islower() else own * whole
        del element.attrib[name]
        element.set('quat', ' '.join(map(repr, np.roll(whole.as_quat(), 1).tolist())))


def floating(root: ET.Element) -> list[tuple[ET.Element, ET.Element]]:
    """Return the bodies of an MJCF that float, with their free joints."""
    return [
        (body, x) for body in root.iter('body') for x in body
        if x.tag == 'freejoint' or (x.tag, x.get('type')) == ('joint', 'free')
    ]  # fmt: skip


def name_all(root: ET.Element) -> None:
    """Give the bodies and joints of an MJCF that have no name one by their place in it."""
    for path in ('.//body', './/body/joint'):
        for number, element in enumerate(root.iterfind(path), 1):
            element.attrib.setdefault('name', f'{element.tag} {number}')


def _of_shapes(root: ET.Element) -> Iterator[str]:
    """Judge whether a moving body's mass is that of a shape in a file."""
    for bodies, geom in _elements(root):
        mesh = geom.get('mesh') if geom.tag == 'geom' else None
        body = next((x for x in reversed(bodies) if x.tag != 'frame'), root)
        moves = any(x.tag in ('joint', 'freejoint') for y in bodies for x in y)
        if mesh and moves and body.find('inertial') is None:
            yield (
                f'has body {name_of(body.get("name"))}, whose mass is that of the mesh '
                f'{name_of(mesh)}, which is not read; give it an inertial, or <compiler '
                'saveinertial="true"/> and take the MJCF that mujoco.mj_saveLastXML then writes'
            )


def _leave_out_shapes(root: ET.Element) -> None:
    """Take out of an MJCF what needs files of its own, or has no part in the motion."""
    gone = {'mesh', 'texture', 'material', 'hfield', 'skin', 'light', 'camera'}
    for tag in ('visual', 'statistic', 'keyframe', 'sensor'):
        for element in root.findall(tag):
            root.remove(element)
    names = set()
    for parent in list(root.iter()):
        for child in list(parent):
            child.attrib.pop('material', None)
            shape = child.tag == 'geom' and ('mesh' in child.attrib or 'hfield' in child.attrib)
            if shape or child.tag in gone:
                names.add(child.get('name') if shape else None)
                parent.remove(child)
    for contact in root.iterfind('contact'):
        for pair in contact.findall('pair'):
            if {pair.get('geom1'), pair.get('geom2')} & (names - {None}):
                contact.remove(pair)


# Words of an MJCF for what a joint and its actuator have, and this package's.
OWN_WORDS = {
    'armature': 'drive_inertia', 'damping': 'viscous_torque', 'frictionloss': 'coulomb_torque',
    'kp': 'position_gain', 'kv': 'velocity_gain',
}  # fmt: skip
# Actuators whose effort is that of a position by its gains, or of a controller outside.
_PLAIN = frozenset(('general', 'motor', 'position'))
# Attributes of joints and actuators that say nothing at these values.
_SILENT = (('joint', 'stiffness', 0.0), *((tag, 'gear', 1.0) for tag in sorted(_PLAIN)))


def own_physics(root: ET.Element, joints: Collection[str]) -> str:
    """Return what of an MJCF acts on joints beside links, friction and PD; empty for nothing.

    Contacts are not looked at; other joints than those given, and bases, stand still.
    """
    still = frozenset[str]()
    # The joints that move a body or a site, by its name; the world has none.
    moved: dict[str | None, frozenset[str]] = {None: still}
    level = [(body, still) for body in root.iterfind('worldbody')]
    while level:
        body, before = level.pop()
        now = before | {x.get('name', '') for x in body.findall('joint')} & {*joints}
        moved |= {x.get('name'): now for x in (body, *body.findall('site')) if x.get('name')}
        level += [(x, now) for x in body if x.tag in ('body', 'frame')]
        loose = body.get('gravcomp') or any(x.get('type') == 'ball' for x in body)
        if loose and any(x.get('name') in joints for x in body.iter('joint')):
            return f'body {name_of(body.get("name"))}, which floats'
    for tie in (*root.iterfind('equality/*'), *root.iterfind('tendon/*')):
        tied = {tie.get('joint1'), tie.get('joint2'), *(x.get('joint') for x in tie)}
        kinds = [kind for kind in ('body', 'site') if tie.get(f'{kind}1')]
        ends = [tie.get(f'{kind}{n}') for kind in kinds for n in (1, 2)]
        ends += [x.get('site') for x in tie.findall('site')]
        if tied & {*joints} or len({moved.get(x, still) for x in ends}) > 1:
            kind = 'tendon' if tie.tag in ('fixed', 'spatial') else tie.tag
            return f'the {kind} {name_of(tie.get("name"))}'
    for actuator in root.iterfind('actuator/*'):
        if actuator.get('joint') in joints and actuator.tag not in _PLAIN:
            return f'the actuator {actuator.tag}'
    for tag, name, silent in _SILENT:
        for joint, numbers in declared(root, tag, name).items():
            if joint in joints and numbers[0] != silent:
                return f'the {name} of {joint}'
    return ''


def joints_in(root: ET.Element, types: Collection[str] = (*_TURN, *SLIDE)) -> tuple[str, ...]:
    """Return the joints of a description that turn about or slide along one axis.

    Args:
        root: Of a URDF or an MJCF, see `judged_tree`.
        types: Of joints, as either calls them.
    """
    found = root.iterfind('joint' if root.tag == 'robot' else './/worldbody//joint')
    return tuple(
        joint.get('name', '') for joint in found
        if joint.get('name') and joint.get('type', 'hinge') in types
    )  # fmt: skip


def _of_text(text: str) -> Iterator[str]:
    """Judge a description before it becomes a tree."""
    if '<!DOCTYPE' in text:
        yield 'has a DOCTYPE, whose entities can stand for text without end; remove it'
    if text.count('<') > 2 * _ELEMENTS:
        yield f'has more than {_ELEMENTS} elements; leave out what is not the machine'
    # No value holds a <, so that between two of them there is one element, or less.
    elif any(len(_ATTRIBUTE.findall(part)) > _ATTRIBUTES for part in text.split('<')):
        yield f'has an element of more than {_ATTRIBUTES} attributes; leave some out'


def _problems(root: ET.Element, shapes: bool) -> Iterator[str]:
    level = [root]
    for _ in range(_DEPTH):
        level = [child for element in level for child in element]
    if level:
        yield f'has elements {_DEPTH} deep inside each other; leave out what is not the machine'
    if any('xacro' in element.tag for element in root.iter()):
        yield 'is a xacro; give what `xacro arm.urdf.xacro > arm.urdf` makes of it'
    elif not re.fullmatch('robot|mujoco', root.tag):
        yield (
            f'has the root element {name_of(root.tag)}; give a URDF (robot) or an MJCF file '
            '(mujoco)'
        )
    for tag in ('link', 'body', 'joint'):
        count = sum(1 for _ in root.iter(tag))
        if count > _BODIES:
            yield f'has {count} elements {tag} and may have {_BODIES}; leave some out'
    for body in root.iter('body'):
        # A body moves in six directions; pinocchio's memory grows with joints in a row squared.
        count = len(body.findall('joint'))
        if count > _JOINTS:
            yield (
                f'has a body {name_of(body.get("name"))} of {count} joints and may have '
                f'{_JOINTS}; leave some out'
            )
    if root.tag == 'robot':
        yield from _of_urdf(root)
    for joint in root.iter('joint'):
        name = joint.get('name', '')
        # In an MJCF a joint needs no name.
        if (name or root.tag == 'robot') and (why := unfit(name)):
            yield f'names a joint {shown(name)}, {why}'
    for element in root.iter():
        file = next((name for name in element.attrib if name.startswith('file')), None)
        if element.tag == 'include' or file and not shapes:
            yield (
                f'names the file {name_of(element.get(file or "file"))} ({name_of(element.tag)}), '
                'which is not read; give an MJCF without files of its own'
            )
    yield from _of_numbers(root)


def _of_urdf(root: ET.Element) -> Iterator[str]:
    # Shapes, sensors and controllers have no part in the dynamics.
    root[:] = [element for element in root if element.tag in ('link', 'joint')]
    below: dict[str | None, list[str | None]] = {}
    for link in root.iterfind('link'):
        link[:] = link.findall('inertial')
        below[link.get('name')] = []
        for place, names in _NEEDED.items() if len(link) else ():
            yield from _missing(link, place, names)
    carried = set()
    for joint in root.iterfind('joint'):
        kind, where = joint.get('type'), f'joint {name_of(joint.get("name"))}'
        if kind in ('revolute', 'prismatic'):
            yield from _missing(joint, 'limit', ('effort', 'velocity'))
        # An axis of 0 stands in many a fixed one.
        axis = joint.find('axis') if kind in ('revolute', 'continuous', 'prismatic') else None
        given = '1 0 0' if axis is None else axis.get('xyz', '1 0 0')
        if not given.strip(' 0.-+e\t\n'):
            yield f'has the axis "{name_of(given)}" of {where}; give its direction'
        parent, child = (
            getattr(joint.find(end), 'attrib', {}).get('link') for end in ('parent', 'child')
        )
        if not {parent, child} <= below.keys() or child in carried:
            yield (
                f'has {where} between {name_of(parent)} and {name_of(child)}, which have to be '
                'links, the second one carried by no other joint; correct it'
            )
        carried.add(child)
        below[parent].append(child)
    level = [link for link in below if link not in carried]
    if len(level) != 1:
        yield f'has {len(level)} links that no joint carries and needs one; give the whole URDF'
    for _ in range(_DEPTH):
        level = [child for link in level for child in below.pop(link)]
    if below:
        yield (
            f'has link {name_of(next(iter(below)))} in a circle of joints, or behind more than '
            f'{_DEPTH} of them; leave some out'
        )


def _missing(owner: ET.Element, place: str, names: tuple[str, ...]) -> Iterator[str]:
    part = owner.find(place)
    for name in names:
        if part is None or name not in part.attrib:
            what = f'{place.rpartition("/")[2]} {name}'
            yield f'has no {what} of {owner.tag} {name_of(owner.get("name"))}; add it'


def _of_numbers(root: ET.Element) -> Iterator[str]:
    """Judge the numbers of links, bodies and joints."""
    level = [('', root)]
    while level:
        where, element = level.pop()
        if element.tag in ('link', 'body', 'joint'):
            where = f' of {element.tag} {name_of(element.get("name"))}'
        level += [(where, child) for child in element]
        for name, value in element.items():
            parts = value.split()
            above = _FROM_ZERO.get(element.tag if name == 'value' else name, 0)
            low = [_NOTHING] * above + [-_LARGEST] * len(parts)
            if name in _NUMBERS and not (parts and all(map(_number, parts, low))):
                yield (
                    f'has {name_of(value)} as {element.tag} {name}{where}; write '
                    f'{"a number from 0" if above else f"numbers from {-_LARGEST:g}"} to '
                    f'{_LARGEST:g}'
                )


def _number(text: str, low: float) -> bool:
    try:
        return low <= float(text) <= _LARGEST
    except ValueError:
        return False
