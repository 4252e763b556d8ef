# SPDX-License-Identifier: Apache-2.0
"""A URDF as MuJoCo's own language has it."""

import importlib.util
import xml.etree.ElementTree as ET

from ros2_ident.errors import ErrorCode
from ros2_ident.models.mujoco.plant import loaded, tried

# A body without mass, which MuJoCo refuses to move, gets so much: kg, and kg m^2 about each axis.
_MASS, _INERTIA = 1e-9, 1e-12


def can_convert() -> bool:
    """Whether MuJoCo is there to do it."""
    return importlib.util.find_spec('mujoco') is not None


def mjcf_of(urdf: str) -> str:
    """Return the MJCF that MuJoCo makes of a URDF, without the shapes that lie in files.

    Raises:
        IdentError: UNKNOWN_MODEL without MuJoCo, BAD_MACHINE_FILE where it refuses the URDF.
    """
    mj, root = loaded(), ET.fromstring(urdf)
    for link in root.iterfind('link'):
        for shape in [*link.findall('visual'), *link.findall('collision')]:
            if shape.find('geometry/mesh') is not None:
                link.remove(shape)
    text = ET.tostring(root, encoding='unicode')
    tried(text)
    try:
        spec = mj.MjSpec.from_string(text)
        spec.compiler.boundmass, spec.compiler.boundinertia = _MASS, _INERTIA
        spec.compile()
        return str(spec.to_xml())
    except ValueError as error:
        why = ' '.join(str(error).split())
        raise ErrorCode.BAD_MACHINE_FILE.error(
            f'MuJoCo makes no MJCF of the URDF ({why}); give an MJCF with --into'
        ) from error
