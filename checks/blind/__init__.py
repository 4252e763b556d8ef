# SPDX-License-Identifier: Apache-2.0
"""The blind check: cases drawn, sealed, diagnosed by another process, opened, scored."""
