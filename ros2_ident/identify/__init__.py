# SPDX-License-Identifier: Apache-2.0
"""From data to identified parameters: data, problem, run, result."""
