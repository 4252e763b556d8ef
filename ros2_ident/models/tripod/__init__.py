# SPDX-License-Identifier: Apache-2.0
"""Three vertical linear drives that carry one platform on rods."""

from ros2_ident.models.tripod.model import Tripod as Tripod
