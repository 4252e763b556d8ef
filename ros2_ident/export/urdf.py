# SPDX-License-Identifier: Apache-2.0
"""An URDF with identified inertials, damping and friction; everything else as it was."""

import xml.etree.ElementTree as ET

from ros2_ident.arrays import Array
from ros2_ident.export.content import Content
from ros2_ident.export.description import named, number, numbers, parsed, put_inertial, written
from ros2_ident.models.drives.joints import Joint


def with_values(text: str, content: Content) -> str:
    """Return a URDF with the content's links and joints.

    Args:
        text: The URDF.
        content: What is exported.

    Raises:
        IdentError: BAD_MACHINE_FILE where a joint or link is not in it.
    """
    root = parsed(text)
    for name, mass, centre, inertia in content.inertials():
        _inertial(_named(root, 'link', name), mass, centre, inertia)
    for joint in content.joints:
        _dynamics(_named(root, 'joint', joint.name), joint)
    return written(root)


def _named(root: ET.Element, tag: str, name: str) -> ET.Element:
    return named(root.findall(tag), tag, name, 'give the one that the machine file names')


def _inertial(link: ET.Element, mass: float, centre: Array, inertia: Array) -> None:
    new = ET.Element('inertial')
    put_inertial(link, new)
    ET.SubElement(new, 'origin', xyz=numbers(centre), rpy='0 0 0')
    ET.SubElement(new, 'mass', value=number(mass))
    places = {f'i{a}{b}': (i, j) for i, a in enumerate('xyz') for j, b in enumerate('xyz')}
    upper = ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')
    values = {name: number(inertia[places[name]]) for name in upper}
    ET.SubElement(new, 'inertia', values)


def _dynamics(element: ET.Element, joint: Joint) -> None:
    found = element.find('dynamics')
    if found is None:
        found = ET.SubElement(element, 'dynamics')
    found.set('damping', number(joint.viscous))
    found.set('friction', number(joint.coulomb))
