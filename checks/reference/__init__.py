# SPDX-License-Identifier: Apache-2.0
"""Slow, plain twins of the models, and the bags made with them."""

from checks.reference.twin import Twin as Twin
from checks.reference.twin import twin_of as twin_of
