# SPDX-License-Identifier: Apache-2.0
"""Identified values in descriptions of robots: URDF, with Drake's tags, and MJCF."""

import math
import os
from pathlib import Path
from typing import Any
import xml.etree.ElementTree as ET

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.export.content import Content
from ros2_ident.files import mark
from ros2_ident.machine.description import name_all
from ros2_ident.models.drives.joints import Gains, Joint
from ros2_ident.models.mujoco.model import Mujoco
from ros2_ident.models.mujoco.plant import mjcf_of

# A URDF's limit needs a speed; no joint is that fast, rad/s or m/s.
_ENDLESS = 1e9
# What a link without mass gets, kg, and kg m^2 about each axis: up to 1e-6 counts as nothing.
_LIGHT = 1e-5
_DRAKE = 'http://drake.mit.edu'
# Friction of MuJoCo's joints gives way by load / inertia x time; the closer these are to 1, the
# less. Its documentation allows up to 0.9999; width, middle and power are its own.
_STIFF = '0.9999 0.9999 0.001 0.5 2'
# A delay is shorter where its history has too few steps: enough for steps of so much, s, a
# twentieth of MuJoCo's default.
_FINEST = 1e-4
# What to do about a name that an MJCF, or a URDF, does not have.
_REMEDIES = 'name it there as the bag does', 'give the one that the machine file names'


def is_urdf(text: str) -> bool:
    """Whether a description is a URDF."""
    return '<robot' in text


def moved(text: str, folder: Path, to: Path | None) -> str:
    """Return a description for another folder, from where it finds the shapes that it names.

    Ways that are absolute, or begin as `package://` does, stay; all are absolute where it is for
    no folder.
    """
    root = _parsed(text)

    def way(name: str) -> str:
        if '://' in name or os.path.isabs(name):
            return name
        found = folder.resolve() / name
        return str(found) if to is None else os.path.relpath(found, to.resolve())

    for shape in root.iterfind('.//geometry/mesh[@filename]'):
        shape.set('filename', way(shape.attrib['filename']))
    if root.find('asset/*[@file]') is not None:
        compilers = root.findall('compiler') or [_add(root, 'compiler')]
        for kind in ('meshdir', 'texturedir'):  # MuJoCo takes the last of each
            told = [compiler.get(kind, compiler.get('assetdir')) for compiler in compilers]
            compilers[-1].set(kind, way(([''] + [name for name in told if name])[-1]))
    return ET.tostring(root, encoding='unicode')


def urdf(text: str, content: Content) -> str:
    """Return a URDF with what was identified of links and joints; everything else as it was.

    Raises:
        IdentError: BAD_MACHINE_FILE where a joint or link is not in it.
    """
    return _written(in_urdf(text, content))


def drake(text: str, content: Content) -> str:
    """Return a URDF with actuators whose rotors count, as Drake's parser reads them.

    It has no place for Coulomb friction, of which it warns, so that none is written. Raises as
    `urdf`.
    """
    ET.register_namespace('drake', _DRAKE)
    root = in_urdf(text, content)
    for joint in content.joints:
        _part(_named(root, 'joint', joint.name), 'dynamics').attrib.pop('friction')
        for old in root.findall('transmission'):
            if joint.name in [driven.get('name') for driven in old.findall('joint')[:1]]:
                root.remove(old)
        new = _add(root, 'transmission', name=f'{joint.name}_transmission')
        _add(new, 'type').text = 'transmission_interface/SimpleTransmission'
        _add(new, 'joint', name=joint.name)
        actuator = _add(new, 'actuator', name=joint.name)
        _add(actuator, f'{{{_DRAKE}}}rotor_inertia', value=joint.armature)
        _add(actuator, f'{{{_DRAKE}}}gear_ratio', value='1')
    return _written(root)


def gazebo(text: str, content: Content) -> str:
    """Return a URDF that stands in the world, and of which Gazebo's parser drops nothing.

    It drops a link without mass, and with it all that it carries. Raises as `urdf`.
    """
    root = in_urdf(text, content)
    carried = {'world', *(child.get('link') for child in root.findall('joint/child'))}
    for name in [link.get('name', '') for link in root.findall('link')]:
        if name not in carried:
            joint = _add(root, 'joint', name=f'world_{name}', type='fixed')
            _add(joint, 'parent', link='world')
            _add(joint, 'child', link=name)
            _add(root, 'link', name='world')
    give_mass(root)
    return _written(root)


def in_urdf(text: str, content: Content) -> ET.Element:
    """Return the root of a URDF that has what was identified; raises as `urdf`."""
    root = _parsed(text)
    for name, mass, centre, inertia in content.inertials():
        _give(_named(root, 'link', name), mass, centre, inertia)
    for joint in content.joints:
        element = _named(root, 'joint', joint.name)
        _set(_part(element, 'dynamics'), damping=joint.viscous, friction=joint.coulomb)
        if math.isfinite(joint.limit):
            limit = _part(element, 'limit')
            _set(limit, effort=joint.limit, velocity=limit.get('velocity', _ENDLESS))
    return root


def mjcf(text: str, content: Content) -> str:
    """Return an MJCF with what was identified of bodies and joints, position actuators too.

    It is made of an MJCF, or of the one that MuJoCo makes of a URDF.

    Raises:
        IdentError: BAD_MACHINE_FILE where a joint or body is not in it; as `mjcf_of`.
    """
    return _written(in_mjcf(text, content))


def in_mjcf(text: str, content: Content) -> ET.Element:
    """Return the root of an MJCF that has what was identified; raises as `mjcf`."""
    described = is_urdf(text)
    root = _parsed(mjcf_of(urdf(text, content)) if described else text)
    for compiler in root.findall('compiler[@inertiafromgeom="true"]'):
        compiler.set('inertiafromgeom', 'auto')  # what is written counts, whatever the shapes
    name_all(root)
    for name, mass, centre, inertia in () if described else content.inertials():
        new = _inertial(_named(root, 'worldbody//body', name))
        full = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        _set(new, pos=centre, mass=mass, fullinertia=full)
    if isinstance(content.model, Mujoco):
        _put_back(root, content.model, content)
    for joint in content.joints:
        element = _named(root, 'worldbody//joint', joint.name)
        _set(element, damping=joint.viscous, frictionloss=joint.coulomb, solimpfriction=_STIFF)
        _set(element, armature=joint.armature)
        if joint.gains is not None:
            _actuator(root, joint, joint.gains, content.delays.get(joint.name, 0.0))
        elif math.isfinite(joint.limit):
            most = (-joint.limit, joint.limit)
            _set(element, actuatorfrclimited='true', actuatorfrcrange=most)
    return root


def _actuator(root: ET.Element, joint: Joint, gains: Gains, delay: float) -> None:
    """Put a position actuator in the place of whatever drives a joint, its set-points late."""
    actuators, option = _part(root, 'actuator'), _part(root, 'option')
    there = [a for a in actuators if joint.name in (a.get('joint'), a.get('jointinparent'))]
    place = list(actuators).index(there[0]) if there else len(actuators)
    # It keeps the bounds of set-points where it has them, else it has none, whatever the defaults.
    kept = there[:1] if there and there[0].tag == 'position' else []
    new = (kept or [ET.Element('position', joint=joint.name, ctrllimited='false')])[0]
    new.set('name', there[0].get('name', joint.name) if there else joint.name)
    for old in there:
        actuators.remove(old)
    actuators.insert(place, new)
    new.attrib.pop('dampratio', None)
    _set(new, kp=gains.p, kv=gains.d, gear='1', timeconst='0')
    if math.isfinite(joint.limit):
        _set(new, forcelimited='true', forcerange=(-joint.limit, joint.limit))
    _set_delay(option, new, delay)
    # The default, Euler, takes kv of the step before: on a light joint that swings up.
    if option.get('integrator', 'Euler') == 'Euler':
        option.set('integrator', 'implicitfast')


def _set_delay(option: ET.Element, actuator: ET.Element, delay: float) -> None:
    if delay > 0.0:
        step = min(float(option.get('timestep', _FINEST)), _FINEST)
        _set(actuator, delay=delay, interp='linear', nsample=str(math.ceil(delay / step) + 1))


def _put_back(root: ET.Element, model: Mujoco, content: Content) -> None:
    """Put what MuJoCo's own model has of drives into the MJCF that it was made of."""
    found, drives = model.as_found(content.theta)[0], model.machine.drives
    sought, option = {*model.machine.bounds, *model.machine.given}, _part(root, 'option')
    _set(option, timestep=found.opt.timestep)
    acting = [x for part in root.findall('actuator') for x in part if isinstance(x.tag, str)]
    for at, drive in zip(model.plant.places, drives, strict=True):
        joint = _named(root, 'worldbody//joint', found.joint(at.joint).name)
        _set(joint, armature=found.dof_armature[at.dof], damping=found.dof_damping[at.dof])
        _set(joint, frictionloss=found.dof_frictionloss[at.dof])
        _set(joint, stiffness=found.jnt_stiffness[at.joint])
        own, n = acting[at.actuator], at.actuator
        gain, bias = found.actuator_gainprm[n], found.actuator_biasprm[n]
        if own.tag == 'position':
            own.attrib.pop('dampratio', None)
            _set(own, kp=gain[0], kv=-bias[2])
        elif own.tag == 'general':
            _set(own, gainprm=gain, biasprm=bias)
        _set(own, gear=found.actuator_gear[n])
        if found.actuator_forcelimited[n]:
            _set(own, forcelimited='true', forcerange=found.actuator_forcerange[n])
            if not found.jnt_actfrclimited[at.joint]:
                joint.set('actuatorfrclimited', 'false')
        _set_delay(option, own, content.delays.get(drive, 0.0))
        if any(name.startswith('body_') for name in sought):
            name, every = found.body(at.body).name, root.iterfind('worldbody//body')
            body = next(x for x in every if (x.get('name') == name if name else joint in x))
            new = _inertial(body)
            _set(body, pos=found.body_pos[at.body])
            _set(new, pos=found.body_ipos[at.body], quat=found.body_iquat[at.body])
            _set(new, mass=found.body_mass[at.body], diaginertia=found.body_inertia[at.body])
    if 'free_fall' in sought:
        _set(option, gravity=found.opt.gravity)


def massless(root: ET.Element) -> list[ET.Element]:
    """Return the links of a URDF that have no mass, but for the one that stands."""
    links = {link.get('name'): link for link in root.findall('link')}
    carried = [links.get(child.get('link')) for child in root.findall('joint/child')]
    masses = [(link, link.find('inertial/mass')) for link in carried if link is not None]
    return [link for link, m in masses if m is None or not float(m.get('value', 0.0))]


def give_mass(root: ET.Element) -> None:
    """Give the links of a URDF without mass, which parsers drop or refuse, next to none."""
    for link in massless(root):
        _give(link, _LIGHT, np.zeros(3), _LIGHT * np.eye(3))


def odd(text: str) -> dict[str, list[str]]:
    """Return the links of a URDF without mass, and the joints that follow others."""
    root = _parsed(text)
    kinds = {'links without mass': massless(root)}
    kinds |= {'joints that follow others': root.findall('joint[mimic]')}
    return {kind: [one.get('name', '') for one in found] for kind, found in kinds.items()}


def _give(link: ET.Element, mass: float, centre: Array, inertia: Array) -> None:
    """Give a link of a URDF an inertial: kg, (3,) m, (3, 3) kg m^2 about the centre."""
    new = _inertial(link)
    _add(new, 'origin', xyz=centre, rpy='0 0 0')
    _add(new, 'mass', value=mass)
    xx, xy, xz, yy, yz, zz = inertia[np.triu_indices(3)]
    _add(new, 'inertia', ixx=xx, ixy=xy, ixz=xz, iyy=yy, iyz=yz, izz=zz)


def _inertial(body: ET.Element) -> ET.Element:
    """Return an empty inertial of a body, in the place of the one it has."""
    if (old := body.find('inertial')) is not None:
        body.remove(old)
    body.insert(0, ET.Element('inertial'))
    return body[0]


def _named(root: ET.Element, path: str, name: str) -> ET.Element:
    """Return the element of a path and name; raises as `urdf`."""
    for element in root.iterfind(path):
        if element.get('name') == name:
            return element
    tag, remedy = path.rpartition('/')[2], _REMEDIES[root.tag == 'robot']
    raise ErrorCode.BAD_MACHINE_FILE.error(f'the description has no {tag} {name}; {remedy}')


def _part(element: ET.Element, tag: str) -> ET.Element:
    """Return the first child of a tag, added where there is none."""
    found = element.find(tag)
    return _add(element, tag) if found is None else found


def _add(element: ET.Element, tag: str, **values: Any) -> ET.Element:
    """Return a new child with attributes, see `_set`."""
    new = ET.SubElement(element, tag)
    _set(new, **values)
    return new


def _set(element: ET.Element, **values: Any) -> None:
    """Set attributes: texts, and numbers, one or several, with all of their digits."""
    for name, value in values.items():
        text = value if isinstance(value, str) else ' '.join(map(repr, np.ravel(value).tolist()))
        element.set(name, text)


def _parsed(text: str) -> ET.Element:
    """Return the root of a description that is judged, its comments kept."""
    return ET.fromstring(text, ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))


def _written(root: ET.Element) -> str:
    ET.indent(root)
    text = ET.tostring(root, encoding='unicode')
    return f"<?xml version='1.0' encoding='utf-8'?>\n<!-- {mark('export')} -->\n{text}\n"
