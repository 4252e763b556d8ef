# SPDX-License-Identifier: Apache-2.0
"""Slow, plain twins of the models, and the bags made with them."""
