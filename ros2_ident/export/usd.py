# SPDX-License-Identifier: Apache-2.0
"""Identified values in OpenUSD, by its converters, and what these leave out."""

from collections.abc import Sequence
import importlib
from importlib.util import find_spec
import math
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
import xml.etree.ElementTree as ET

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.export.content import Content
from ros2_ident.export.descriptions import give_mass, in_mjcf, in_urdf, is_urdf
from ros2_ident.files import mark

# Converters to USD, by the root of what they take.
CONVERTERS = {'urdf': 'urdf_usd_converter', 'mjcf': 'mujoco_usd_converter'}


def usd(text: str, content: Content) -> str:
    """Return a layer of OpenUSD, as text, with all of a URDF or MJCF but textures.

    Meshes are in it where the description has their absolute paths. The converter of URDFs leaves
    out, and this adds, the inertia of motors and gears as the attribute `newton:armature` [kg m^2
    or kg]. Effort limits [N m or N] and controllers' gains are those of UsdPhysics' `DriveAPI`.

    Raises:
        IdentError: BAD_MACHINE_FILE where the converter refuses the description; as `urdf`, or
            `mjcf`.
    """
    from pxr import Usd
    import usdex.core

    described = is_urdf(text)
    root = in_urdf(text, content) if described else in_mjcf(text, content)
    if described:
        give_mass(root)
    else:
        _leave_out_textures(root)
    usdex.core.activateDiagnosticsDelegate()  # or every step is told on the terminal
    usdex.core.setDiagnosticsLevel(usdex.core.DiagnosticsLevel.eError)
    kind = 'urdf' if described else 'mjcf'
    # Either brings schemas, which count from before the first stage of a process.
    there = [name for name in CONVERTERS.values() if find_spec(name)]
    converter = {name: importlib.import_module(name).Converter for name in there}[CONVERTERS[kind]]
    with TemporaryDirectory() as folder:
        path = Path(folder) / 'robot.xml'
        path.write_bytes(ET.tostring(root, encoding='utf-8'))
        try:
            asset = converter(layer_structure=False, scene=False).convert(str(path), folder)
        except (RuntimeError, ValueError) as error:
            raise ErrorCode.BAD_MACHINE_FILE.error(
                f'no USD can be made of the {kind.upper()} ({" ".join(str(error).split())}); '
                'mend it, or leave usd out of --to'
            ) from error
        stage = Usd.Stage.Open(asset.path)
        (_drive_urdf if described else _drive_mjcf)(stage, content)
        layer = stage.GetRootLayer()
        layer.comment, layer.documentation = mark('export'), ''
        return str(layer.ExportToString())


def _leave_out_textures(root: ET.Element) -> None:
    """Take textures, which a layer of USD has in files beside it, out of an MJCF."""
    for asset in root.findall('asset'):
        for texture in asset.findall('texture'):
            asset.remove(texture)
        for material in asset.findall('material'):
            material.attrib.pop('texture', None)
            material[:] = [x for x in material if x.tag != 'layer']


def _drive_urdf(stage: Any, content: Content) -> None:
    """Give joints of a URDF in USD their armature, effort limit and gains."""
    from pxr import Sdf, UsdPhysics

    identified = {joint.name: joint for joint in content.joints}
    for prim in filter(lambda prim: prim.IsA(UsdPhysics.Joint), stage.Traverse()):
        joint = identified.get(prim.GetDisplayName() or prim.GetName())
        if joint is not None:
            prim.AddAppliedSchema('NewtonJointAPI')
            armature = prim.CreateAttribute('newton:armature', Sdf.ValueTypeNames.Float)
            armature.Set(joint.armature)
        gains = joint.gains if joint is not None else None
        most = prim.GetAttribute('urdf:limit:effort').Get() or math.inf
        _drive(prim, most, (gains.p, gains.d) if gains else (0.0, 0.0))


def _drive_mjcf(stage: Any, _: Content) -> None:
    """Put drives in the place of the actuators of an MJCF's joints, which few importers read."""
    from pxr import UsdPhysics

    prims = list(stage.Traverse())
    joints = {prim.GetPath(): prim for prim in prims if prim.IsA(UsdPhysics.Joint)}
    made, gains = dict.fromkeys(joints, 0.0), dict.fromkeys(joints, np.zeros(2))
    for prim in prims:
        if prim.GetTypeName() != 'MjcActuator':
            continue
        gear = abs((prim.GetAttribute('mjc:gear').Get() or [1.0])[0])
        bias = prim.GetAttribute('mjc:biasPrm').Get() or [0.0] * 3
        for path in {*prim.GetRelationship('mjc:target').GetTargets()} & {*joints}:
            # Both the effort and the way of an actuator are those of the joint by its gear.
            made[path] += gear * _limit(prim, 'force')
            gains[path] = gains[path] - gear**2 * np.array(bias[1:3])
            stage.RemovePrim(prim.GetPath())
    for path, joint in joints.items():
        most = made[path] or math.inf
        _drive(joint, min(most, _limit(joint, 'actuatorfrc')), gains[path])


def _limit(prim: Any, of: str) -> float:
    """Return the most that an actuator or a joint of an MJCF in USD may make, N m or N."""
    found = {x.GetName().lower(): x.Get() for x in prim.GetAuthoredAttributes()}
    limited = found.get(f'mjc:{of}limited') != 'false'
    return float(found.get(f'mjc:{of}range:max', math.inf)) if limited else math.inf


def _drive(prim: Any, most: float, gains: Sequence[float] | Array) -> None:
    """Give a joint in USD a drive of an effort limit, and of gains p and d, where it has one."""
    from pxr import UsdPhysics

    if not (math.isfinite(most) or any(gains)):
        return
    # USD's angles are in degrees, and so are gains.
    turns = prim.IsA(UsdPhysics.RevoluteJoint)
    axis, unit = ('angular', math.pi / 180.0) if turns else ('linear', 1.0)
    drive = UsdPhysics.DriveAPI.Apply(prim, axis)
    drive.CreateTypeAttr('force')
    if math.isfinite(most):
        drive.CreateMaxForceAttr(most)
    if any(gains):
        drive.CreateStiffnessAttr(gains[0] * unit)
        drive.CreateDampingAttr(gains[1] * unit)
