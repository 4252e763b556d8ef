# SPDX-License-Identifier: Apache-2.0
"""What was identified, in the files of simulators and controllers, and what those cannot say."""
