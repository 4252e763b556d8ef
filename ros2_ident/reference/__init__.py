# SPDX-License-Identifier: Apache-2.0
"""Slow, plain twins of the models: redundant coordinates, adaptive integration, and bags made from them."""
