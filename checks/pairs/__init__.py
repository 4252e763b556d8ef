# SPDX-License-Identifier: Apache-2.0
"""Sealed pairs of logs: what changed from one to the other, drawn before anything is compared."""
