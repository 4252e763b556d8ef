# SPDX-License-Identifier: Apache-2.0
"""An MJCF with identified inertials, joint attributes and position actuators."""

import math
import xml.etree.ElementTree as ET

from ros2_ident.arrays import Array
from ros2_ident.export.content import Content
from ros2_ident.export.description import named, number, numbers, parsed, put_inertial, written
from ros2_ident.models.drives.joints import Joint


def with_values(text: str, content: Content) -> str:
    """Return an MJCF with the content's links, joints and gains.

    Args:
        text: The MJCF.
        content: What is exported.

    Raises:
        IdentError: BAD_MACHINE_FILE where a joint or body is not in it.
    """
    root = parsed(text)
    for compiler in root.findall('compiler'):
        # What is written has to count, whatever shapes the bodies have.
        if compiler.get('inertiafromgeom') == 'true':
            compiler.set('inertiafromgeom', 'auto')
    for name, mass, centre, inertia in content.inertials():
        _inertial(_found(root, 'body', name), mass, centre, inertia)
    for joint in content.joints:
        element = _found(root, 'joint', joint.name)
        element.set('damping', number(joint.viscous))
        element.set('frictionloss', number(joint.coulomb))
        element.set('armature', number(joint.armature))
        if joint.gains is not None:
            _actuator(root, joint)
    return written(root)


def _found(root: ET.Element, tag: str, name: str) -> ET.Element:
    return named(root.iter(tag), tag, name, 'name it there as the bag does')


def _inertial(body: ET.Element, mass: float, centre: Array, inertia: Array) -> None:
    order = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    values = [inertia[place] for place in order]
    new = ET.Element('inertial', pos=numbers(centre), mass=number(mass))
    new.set('fullinertia', numbers(values))
    put_inertial(body, new)


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
    new.set('kp', number(joint.gains.p))
    new.set('kv', number(joint.gains.d))
    if math.isfinite(joint.limit):
        new.set('forcelimited', 'true')
        new.set('forcerange', numbers((-joint.limit, joint.limit)))
