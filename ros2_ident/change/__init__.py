# SPDX-License-Identifier: Apache-2.0
"""Changes between two sets of logs of one machine."""
