# SPDX-License-Identifier: Apache-2.0
"""Identified values in the descriptions of robots: URDF, with Drake's tags, and MJCF."""

from collections.abc import Iterable, Iterator
import math
import xml.etree.ElementTree as ET

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.export.content import Content
from ros2_ident.files import mark
from ros2_ident.machine.description import name_all
from ros2_ident.models.drives.joints import Gains, Joint
from ros2_ident.models.mujoco.plant import mjcf_of

# A URDF's limit needs a speed; no joint is that fast, rad/s or m/s.
_ENDLESS = 1e9
# What a link without mass gets, kg, and kg m^2 about each axis: up to 1e-6 counts as nothing.
_LIGHT = 1e-5
_AXES = 'ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz'
_DRAKE = 'http://drake.mit.edu'
# Friction of MuJoCo's joints gives way by load / inertia x time; the closer these are to 1, the
# less. Its documentation allows up to 0.9999; width, middle and power are its own.
_STIFF = '0.9999 0.9999 0.001 0.5 2'
# A delay is shorter where its history has too few steps: enough for steps of so much, s, a
# twentieth of MuJoCo's default.
_FINEST = 1e-4


def is_urdf(text: str) -> bool:
    """Whether a description is a URDF."""
    return '<robot' in text


def urdf(text: str, content: Content) -> str:
    """Return a URDF with what was identified of links and joints; everything else as it was.

    Raises:
        IdentError: BAD_MACHINE_FILE where a joint or link is not in it.
    """
    return _written(in_urdf(text, content))


def drake(text: str, content: Content) -> str:
    """Return a URDF with actuators whose rotors count, as Drake's parser reads them.

    It has no place for Coulomb friction, of which it warns, so that none is written.

    Raises:
        IdentError: As `urdf`.
    """
    ET.register_namespace('drake', _DRAKE)
    root = in_urdf(text, content)
    for joint, element in _joints(root.findall('joint'), content, _OTHER):
        _part(element, 'dynamics').attrib.pop('friction')
        for old in root.findall('transmission'):
            driven = old.find('joint')
            if driven is not None and driven.get('name') == joint.name:
                root.remove(old)
        new = ET.SubElement(root, 'transmission', name=f'{joint.name}_transmission')
        ET.SubElement(new, 'type').text = 'transmission_interface/SimpleTransmission'
        ET.SubElement(new, 'joint', name=joint.name)
        actuator = ET.SubElement(new, 'actuator', name=joint.name)
        ET.SubElement(actuator, f'{{{_DRAKE}}}rotor_inertia', value=_number(joint.armature))
        ET.SubElement(actuator, f'{{{_DRAKE}}}gear_ratio', value='1')
    return _written(root)


def gazebo(text: str, content: Content) -> str:
    """Return a URDF that stands in the world, and of which Gazebo's parser drops nothing.

    It drops a link without mass, and with it all that it carries.

    Raises:
        IdentError: As `urdf`.
    """
    root = in_urdf(text, content)
    carried = {child.get('link') for child in root.findall('joint/child')}
    for link in root.findall('link'):
        name = link.get('name', '')
        if name not in carried and name != 'world':
            joint = ET.SubElement(root, 'joint', name=f'world_{name}', type='fixed')
            ET.SubElement(joint, 'parent', link='world')
            ET.SubElement(joint, 'child', link=name)
            ET.SubElement(root, 'link', name='world')
    give_mass(root)
    return _written(root)


_OTHER = 'give the one that the machine file names'


def in_urdf(text: str, content: Content) -> ET.Element:
    """Return the root of a URDF that has what was identified; raises as `urdf`."""
    root = _parsed(text)
    for name, mass, centre, inertia in content.inertials():
        _give(_named(root.findall('link'), 'link', name, _OTHER), mass, centre, inertia)
    for joint, element in _joints(root.findall('joint'), content, _OTHER):
        dynamics = _part(element, 'dynamics')
        dynamics.set('damping', _number(joint.viscous))
        dynamics.set('friction', _number(joint.coulomb))
        if math.isfinite(joint.limit):
            limit = _part(element, 'limit')
            limit.set('effort', _number(joint.limit))
            limit.set('velocity', limit.get('velocity', _number(_ENDLESS)))
    return root


def mjcf(text: str, content: Content) -> str:
    """Return an MJCF with what was identified of bodies and joints, position actuators too.

    Args:
        text: An MJCF, or a URDF of which MuJoCo makes one.
        content: What was identified.

    Raises:
        IdentError: BAD_MACHINE_FILE where a joint or body is not in it; as `mjcf_of`.
    """
    described = is_urdf(text)
    root = _parsed(mjcf_of(urdf(text, content)) if described else text)
    for compiler in root.findall('compiler'):
        # What is written has to count, whatever shapes the bodies have.
        if compiler.get('inertiafromgeom') == 'true':
            compiler.set('inertiafromgeom', 'auto')
    remedy = 'name it there as the bag does'
    name_all(root)
    for name, mass, centre, inertia in () if described else content.inertials():
        full = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        new = ET.Element('inertial', pos=_numbers(centre), mass=_number(mass))
        new.set('fullinertia', _numbers(full))
        _put_inertial(_named(root.iter('body'), 'body', name, remedy), new)
    for joint, element in _joints(root.iter('joint'), content, remedy):
        element.set('damping', _number(joint.viscous))
        element.set('frictionloss', _number(joint.coulomb))
        element.set('solimpfriction', _STIFF)
        element.set('armature', _number(joint.armature))
        if joint.gains is not None:
            _actuator(root, joint, joint.gains, content.delays.get(joint.name, 0.0))
        elif math.isfinite(joint.limit):
            element.set('actuatorfrclimited', 'true')
            element.set('actuatorfrcrange', _numbers((-joint.limit, joint.limit)))
    return _written(root)


def _actuator(root: ET.Element, joint: Joint, gains: Gains, delay: float) -> None:
    """Put a position actuator in the place of whatever drives a joint, its set-points late."""
    actuators = _part(root, 'actuator')
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
    option = _part(root, 'option')
    if delay > 0.0:
        step = min(float(option.get('timestep', _FINEST)), _FINEST)
        new.set('delay', _number(delay))
        new.set('interp', 'linear')
        new.set('nsample', str(math.ceil(delay / step) + 1))
    # The default, Euler, takes kv of the step before: on a light joint that swings up.
    if option.get('integrator', 'Euler') == 'Euler':
        option.set('integrator', 'implicitfast')


def _joints(
    elements: Iterable[ET.Element], content: Content, remedy: str
) -> Iterator[tuple[Joint, ET.Element]]:
    found = list(elements)
    for joint in content.joints:
        yield joint, _named(found, 'joint', joint.name, remedy)


def _part(element: ET.Element, tag: str) -> ET.Element:
    """Return the first child of a tag, added where there is none."""
    found = element.find(tag)
    return ET.SubElement(element, tag) if found is None else found


def _parsed(text: str) -> ET.Element:
    """Return the root of a description that is judged, its comments kept."""
    return ET.fromstring(text, ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))


def _written(root: ET.Element) -> str:
    ET.indent(root)
    text = ET.tostring(root, encoding='unicode')
    return f"<?xml version='1.0' encoding='utf-8'?>\n<!-- {mark('export')} -->\n{text}\n"


def _number(value: float) -> str:
    return repr(float(value))  # all of its digits


def _numbers(values: Iterable[float]) -> str:
    return ' '.join(_number(value) for value in values)


def _named(elements: Iterable[ET.Element], tag: str, name: str, remedy: str) -> ET.Element:
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


def massless(text: str) -> tuple[str, ...]:
    """Return the links of a URDF that have no mass, but for the one that stands."""
    return tuple(link.get('name', '') for link in _massless(_parsed(text)))


def _massless(root: ET.Element) -> list[ET.Element]:
    links = {link.get('name'): link for link in root.findall('link')}
    carried = [links.get(child.get('link')) for child in root.findall('joint/child')]
    return [
        link
        for link in carried
        if link is not None
        and ((mass := link.find('inertial/mass')) is None or not float(mass.get('value', 0.0)))
    ]


def give_mass(root: ET.Element) -> None:
    """Give the links of a URDF without mass, which parsers drop or refuse, next to none."""
    for link in _massless(root):
        _give(link, _LIGHT, np.zeros(3), _LIGHT * np.eye(3))


def _give(link: ET.Element, mass: float, centre: Array, inertia: Array) -> None:
    """Give a link of a URDF an inertial: kg, (3,) m, (3, 3) kg m^2 about the centre."""
    new = ET.Element('inertial')
    ET.SubElement(new, 'origin', xyz=_numbers(centre), rpy='0 0 0')
    ET.SubElement(new, 'mass', value=_number(mass))
    values = {x: _number(inertia['xyz'.index(x[1]), 'xyz'.index(x[2])]) for x in _AXES}
    ET.SubElement(new, 'inertia', values)
    _put_inertial(link, new)


def followers(text: str) -> tuple[str, ...]:
    """Return the joints of a URDF that follow others."""
    joints = _parsed(text).findall('joint')
    return tuple(j.get('name', '') for j in joints if j.find('mimic') is not None)
