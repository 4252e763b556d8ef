# SPDX-License-Identifier: Apache-2.0
"""What simulators make of exported machines, by running them."""
