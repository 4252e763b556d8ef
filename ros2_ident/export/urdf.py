# SPDX-License-Identifier: Apache-2.0
"""An URDF with identified inertials, damping and friction; everything else as it was."""

import xml.etree.ElementTree as ET

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.export.content import Content
from ros2_ident.models.drives.joints import Joint


def parsed(text: str) -> ET.Element:
    """Return a description's root, its comments kept.

    Raises:
        IdentError: BAD_MACHINE_FILE where it is no XML.
    """
    try:
        return ET.fromstring(text, ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))
    except ET.ParseError as error:
        raise IdentError(
            ErrorCode.BAD_MACHINE_FILE,
            f'the description is no XML ({error}); give a URDF or an MJCF file',
        ) from None


def written(root: ET.Element) -> str:
    """Return the text of a description."""
    ET.indent(root)
    return ET.tostring(root, encoding='unicode', xml_declaration=True) + '\n'


def number(value: float) -> str:
    """Return a number's text with all of its digits."""
    return repr(float(value))


def numbers(values: object) -> str:
    """Return the text of several numbers, blanks between."""
    return ' '.join(number(value) for value in values)  # type: ignore[attr-defined]


def with_values(text: str, content: Content) -> str:
    """Return a URDF with the content's links and joints.

    Args:
        text: The URDF.
        content: What is exported.

    Raises:
        IdentError: BAD_MACHINE_FILE where a joint or link is not in it.
    """
    root = parsed(text)
    if content.links is not None:
        pairs = zip(content.links.bodies, content.links.inertials, strict=True)
        for body, inertials in pairs:
            if inertials[0] > 0.0:
                _inertial(_named(root, 'link', body.name), *body.inertial(inertials))
    for joint in content.joints:
        _dynamics(_named(root, 'joint', joint.name), joint)
    return written(root)


def _named(root: ET.Element, tag: str, name: str) -> ET.Element:
    for element in root.findall(tag):
        if element.get('name') == name:
            return element
    raise IdentError(
        ErrorCode.BAD_MACHINE_FILE,
        f'the description has no {tag} {name}; give the one that the machine file names',
    )


def _inertial(link: ET.Element, mass: float, centre: object, inertia: object) -> None:
    old = link.find('inertial')
    if old is not None:
        link.remove(old)
    new = ET.Element('inertial')
    link.insert(0, new)
    ET.SubElement(new, 'origin', xyz=numbers(centre), rpy='0 0 0')
    ET.SubElement(new, 'mass', value=number(mass))
    places = {f'i{a}{b}': (i, j) for i, a in enumerate('xyz') for j, b in enumerate('xyz')}
    upper = ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')
    values = {name: number(inertia[places[name]]) for name in upper}  # type: ignore[index]
    ET.SubElement(new, 'inertia', values)


def _dynamics(element: ET.Element, joint: Joint) -> None:
    found = element.find('dynamics')
    if found is None:
        found = ET.SubElement(element, 'dynamics')
    found.set('damping', number(joint.viscous))
    found.set('friction', number(joint.coulomb))
