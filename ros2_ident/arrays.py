# SPDX-License-Identifier: Apache-2.0
"""The type of most arrays."""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
