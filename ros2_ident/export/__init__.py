# SPDX-License-Identifier: Apache-2.0
"""Results in the files of simulators and controllers, and the limits of those files."""
