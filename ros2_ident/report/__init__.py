# SPDX-License-Identifier: Apache-2.0
"""Results as files: JSON, YAML, overlay bags."""
