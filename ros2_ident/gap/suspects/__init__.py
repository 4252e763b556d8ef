# SPDX-License-Identifier: Apache-2.0
"""Causes of a gap that are looked for by themselves, beside the effects of the catalogue."""
