# SPDX-License-Identifier: Apache-2.0
"""What the compiled simulations share: rows, hooks of the effects, controller, log, integrator."""
