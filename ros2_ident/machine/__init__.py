# SPDX-License-Identifier: Apache-2.0
"""The machine file: its keys, its reader, and what it says as one frozen value."""
