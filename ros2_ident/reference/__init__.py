# SPDX-License-Identifier: Apache-2.0
"""Slow, plain twins of the models, and the bags made with them."""

from ros2_ident.reference.twin import Twin as Twin
from ros2_ident.reference.twin import twin_of as twin_of
