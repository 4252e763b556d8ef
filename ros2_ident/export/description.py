# SPDX-License-Identifier: Apache-2.0
"""URDF and MJCF files with what was identified written into them."""

from collections.abc import Iterable
import math
import xml.etree.ElementTree as ET

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.export.content import Content
from ros2_ident.files import mark
from ros2_ident.models.drives.joints import Joint


def urdf(text: str, content: Content) -> str:
    """Return a URDF with identified inertials, damping and friction; everything else as it was.

    Args:
        text: The URDF.
        content: What is exported.

    Raises:
        IdentError: BAD_MACHINE_FILE where a joint or link is not in it.
    """
    root = _parsed(text)
    for name, mass, centre, inertia in content.inertials():
        _urdf_inertial(_of_urdf(root, 'link', name), mass, centre, inertia)
    for joint in content.joints:
        _dynamics(_of_urdf(root, 'joint', joint.name), joint)
    return _written(root)


def _of_urdf(root: ET.Element, tag: str, name: str) -> ET.Element:
    return _named(root.findall(tag), tag, name, 'give the one that the machine file names')


def _urdf_inertial(link: ET.Element, mass: float, centre: Array, inertia: Array) -> None:
    new = ET.Element('inertial')
    _put_inertial(link, new)
    ET.SubElement(new, 'origin', xyz=_numbers(centre), rpy='0 0 0')
    ET.SubElement(new, 'mass', value=_number(mass))
    places = {f'i{a}{b}': (i, j) for i, a in enumerate('xyz') for j, b in enumerate('xyz')}
    upper = ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')
    values = {name: _number(inertia[places[name]]) for name in upper}
    ET.SubElement(new, 'inertia', values)


def _dynamics(element: ET.Element, joint: Joint) -> None:
    found = element.find('dynamics')
    if found is None:
        found = ET.SubElement(element, 'dynamics')
    found.set('damping', _number(joint.viscous))
    found.set('friction', _number(joint.coulomb))


def mjcf(text: str, content: Content) -> str:
    """Return an MJCF with identified inertials, joint attributes and position actuators.

    Args:
        text: The MJCF.
        content: What is exported.

    Raises:
        IdentError: BAD_MACHINE_FILE where a joint or body is not in it.
    """
    root = _parsed(text)
    for compiler in root.findall('compiler'):
        # What is written has to count, whatever shapes the bodies have.
        if compiler.get('inertiafromgeom') == 'true':
            compiler.set('inertiafromgeom', 'auto')
    for name, mass, centre, inertia in content.inertials():
        _mjcf_inertial(_of_mjcf(root, 'body', name), mass, centre, inertia)
    for joint in content.joints:
        element = _of_mjcf(root, 'joint', joint.name)
        element.set('damping', _number(joint.viscous))
        element.set('frictionloss', _number(joint.coulomb))
        element.set('armature', _number(joint.armature))
        if joint.gains is not None:
            _actuator(root, joint)
    return _written(root)


def _of_mjcf(root: ET.Element, tag: str, name: str) -> ET.Element:
    return _named(root.iter(tag), tag, name, 'name it there as the bag does')


def _mjcf_inertial(body: ET.Element, mass: float, centre: Array, inertia: Array) -> None:
    order = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    values = [inertia[place] for place in order]
    new = ET.Element('inertial', pos=_numbers(centre), mass=_number(mass))
    new.set('fullinertia', _numbers(values))
    _put_inertial(body, new)


def _actuator(root: ET.Element, joint: Joint) -> None:
    """Put a position actuator in the place of whatever drives a joint."""
    assert joint.gains is not None
    actuators = root.find('actuator')
    if actuators is None:
        actuators = ET.SubElement(root, 'actuator')
    name = joint.name
    for old in [a for a in actuators if a.get('joint') == joint.name]:
        name = old.get('name', name)
        actuators.remove(old)
    new = ET.SubElement(actuators, 'position', name=name, joint=joint.name)
    new.set('kp', _number(joint.gains.p))
    new.set('kv', _number(joint.gains.d))
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
    """Return the element of a name.

    Args:
        elements: Where it is looked for.
        tag: What they are.
        name: Its name.
        remedy: What to do where there is none.

    Raises:
        IdentError: BAD_MACHINE_FILE where there is none.
    """
    for element in elements:
        if element.get('name') == name:
            return element
    raise IdentError(
        ErrorCode.BAD_MACHINE_FILE, f'the description has no {tag} {name}; {remedy}'
    )


def _put_inertial(body: ET.Element, new: ET.Element) -> None:
    """Put an inertial into a body, in the place of the one it has."""
    old = body.find('inertial')
    if old is not None:
        body.remove(old)
    body.insert(0, new)
