# SPDX-License-Identifier: Apache-2.0
"""The belt drive of the paper's section 3."""

from ros2_ident.models.belt_drive.model import BeltDrive as BeltDrive
from ros2_ident.models.belt_drive.model import step_reference as step_reference
from ros2_ident.models.belt_drive.model import StepReference as StepReference
