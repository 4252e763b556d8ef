# SPDX-License-Identifier: Apache-2.0
"""Many bags of many machines as one job: each identified and diagnosed, then all compared."""
