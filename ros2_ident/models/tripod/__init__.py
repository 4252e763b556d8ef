# SPDX-License-Identifier: Apache-2.0
"""Three vertical linear drives that carry one platform on rods."""
