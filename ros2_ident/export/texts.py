# SPDX-License-Identifier: Apache-2.0
"""The texts of the files: URDF and MJCF written into, YAML of Isaac Lab and ros2_control."""

from collections.abc import Callable, Iterable
import math
from typing import Any
import xml.etree.ElementTree as ET

import yaml

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.export.content import Content
from ros2_ident.files import mark
from ros2_ident.models.drives.joints import Gains, Joint

_ISAAC = (
    '# Keyword arguments of isaaclab.actuators.ImplicitActuatorCfg. Efforts in N m or N, as\n'
    '# Isaac Sim reads friction from version 5.0 on; what is missing is taken from the USD.\n'
)
_ROS2_CONTROL = (
    '# Gains of a joint_trajectory_controller that commands efforts, and limits of the joints.\n'
    '# Efforts at the joint, N m or N: where the hardware takes that of the motor, divide by the\n'
    '# gear factor.\n'
)


def urdf(text: str, content: Content) -> str:
    """Return a URDF with identified inertials, damping and friction; everything else as it was.

    Raises:
        IdentError: BAD_MACHINE_FILE where a joint or link is not in it.
    """
    root, remedy = _parsed(text), 'give the one that the machine file names'
    for name, mass, centre, inertia in content.inertials():
        _urdf_inertial(_named(root.findall('link'), 'link', name, remedy), mass, centre, inertia)
    for joint in content.joints:
        element = _named(root.findall('joint'), 'joint', joint.name, remedy)
        found = element.find('dynamics')
        if found is None:
            found = ET.SubElement(element, 'dynamics')
        found.set('damping', _number(joint.viscous))
        found.set('friction', _number(joint.coulomb))
    return _written(root)


def _urdf_inertial(link: ET.Element, mass: float, centre: Array, inertia: Array) -> None:
    new = ET.Element('inertial')
    _put_inertial(link, new)
    ET.SubElement(new, 'origin', xyz=_numbers(centre), rpy='0 0 0')
    ET.SubElement(new, 'mass', value=_number(mass))
    upper = [(i, j) for i in range(3) for j in range(i, 3)]
    values = {f'i{"xyz"[i]}{"xyz"[j]}': _number(inertia[i, j]) for i, j in upper}
    ET.SubElement(new, 'inertia', values)


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
    raise IdentError(
        ErrorCode.BAD_MACHINE_FILE, f'the description has no {tag} {name}; {remedy}'
    )


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
    data: dict[str, Any] = {'joint_names_expr': [j.name for j in content.joints]}
    for name, of in fields.items():
        values = {j.name: float(v) for j in content.joints if (v := of(j)) is not None}
        data |= {name: values} if values else {}
    return f'# {mark("export")}\n{_ISAAC}' + yaml.safe_dump(data, sort_keys=False, width=99)


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
    return f'# {mark("export")}\n{_ROS2_CONTROL}' + yaml.safe_dump(data, sort_keys=False, width=99)
