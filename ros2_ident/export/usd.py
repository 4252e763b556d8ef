# SPDX-License-Identifier: Apache-2.0
"""Identified values in OpenUSD, by the converter of URDF that Newton's developers made."""

import importlib.util
import math
from pathlib import Path
from tempfile import TemporaryDirectory
import xml.etree.ElementTree as ET

from ros2_ident.errors import ErrorCode
from ros2_ident.export.content import Content
from ros2_ident.export.descriptions import give_mass, in_urdf
from ros2_ident.files import mark


def can_write() -> bool:
    """Whether the converter is there."""
    return importlib.util.find_spec('urdf_usd_converter') is not None


def usd(text: str, content: Content) -> str:
    """Return a layer of USD, as text, with all of a URDF but for meshes that are not found.

    The converter leaves out, and this adds, the inertia of motors and gears as the attribute
    `newton:armature` [kg m^2 or kg], and by UsdPhysics' `DriveAPI` the effort limits of the URDF
    [N m or N] and controllers' gains.

    Raises:
        IdentError: BAD_MACHINE_FILE where the converter refuses the URDF; as `urdf`.
    """
    from pxr import Sdf, Usd, UsdPhysics
    from urdf_usd_converter import Converter
    import usdex.core

    root = in_urdf(text, content)
    give_mass(root)
    usdex.core.activateDiagnosticsDelegate()  # or every step is told on the terminal
    usdex.core.setDiagnosticsLevel(usdex.core.DiagnosticsLevel.eError)
    with TemporaryDirectory() as folder:
        path = Path(folder) / 'robot.urdf'
        path.write_bytes(ET.tostring(root, encoding='utf-8'))
        try:
            asset = Converter(layer_structure=False, scene=False).convert(str(path), folder)
        except (RuntimeError, ValueError) as error:
            raise ErrorCode.BAD_MACHINE_FILE.error(
                f'no USD can be made of the URDF ({" ".join(str(error).split())}); mend it, or '
                'leave usd out of --to'
            ) from error
        stage = Usd.Stage.Open(asset.path)
        identified = {joint.name: joint for joint in content.joints}
        for prim in filter(lambda prim: prim.IsA(UsdPhysics.Joint), stage.Traverse()):
            joint = identified.get(prim.GetDisplayName() or prim.GetName())
            # USD's angles are in degrees, and so are gains.
            turns = prim.IsA(UsdPhysics.RevoluteJoint)
            axis, unit = ('angular', math.pi / 180.0) if turns else ('linear', 1.0)
            if joint is not None:
                prim.AddAppliedSchema('NewtonJointAPI')
                armature = prim.CreateAttribute('newton:armature', Sdf.ValueTypeNames.Float)
                armature.Set(joint.armature)
            gains = joint and joint.gains
            limit = prim.GetAttribute('urdf:limit:effort').Get() or 0.0
            if gains or limit:
                drive = UsdPhysics.DriveAPI.Apply(prim, axis)
                drive.CreateTypeAttr('force')
                if limit:
                    drive.CreateMaxForceAttr(limit)
                if gains:
                    drive.CreateStiffnessAttr(gains.p * unit)
                    drive.CreateDampingAttr(gains.d * unit)
        layer = stage.GetRootLayer()
        layer.comment, layer.documentation = mark('export'), ''
        return str(layer.ExportToString())
