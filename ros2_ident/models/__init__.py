# SPDX-License-Identifier: Apache-2.0
"""Machines, their parameters and their compiled simulations.

What is compiled is imported when it is asked for: naming the kinds of machines does without.
"""

import importlib
from typing import Any, TYPE_CHECKING

from ros2_ident.machine.machine import Machine as Machine
from ros2_ident.machine.machine import Parameter as Parameter
from ros2_ident.models.registry import load_machine as load_machine
from ros2_ident.models.registry import machine_from_mapping as machine_from_mapping
from ros2_ident.models.registry import make_model as make_model

if TYPE_CHECKING:
    from ros2_ident.models.drives.model import DriveModel as DriveModel
    from ros2_ident.models.protocol import complete as complete
    from ros2_ident.models.protocol import EffectAt as EffectAt
    from ros2_ident.models.protocol import FullModel as FullModel
    from ros2_ident.models.protocol import Model as Model
    from ros2_ident.models.protocol import Output as Output

_LATER = {
    'DriveModel': 'ros2_ident.models.drives.model',
    **dict.fromkeys(
        ('complete', 'EffectAt', 'FullModel', 'Model', 'Output'), 'ros2_ident.models.protocol'
    ),
}


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return getattr(importlib.import_module(_LATER[name]), name)
