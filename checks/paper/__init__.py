# SPDX-License-Identifier: Apache-2.0
"""The experiments of Ludwig and Gerstmayr (2011), run again."""
