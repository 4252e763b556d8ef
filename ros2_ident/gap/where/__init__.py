# SPDX-License-Identifier: Apache-2.0
"""Where a gap lies: coordinates of the motion, frequencies, instants."""
