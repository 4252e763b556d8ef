# SPDX-License-Identifier: Apache-2.0
"""Parts of the compiled simulations: rows, hooks of the effects, controller, log, integrator."""
