# SPDX-License-Identifier: Apache-2.0
"""An objective that other processes unpack quickly."""

import math
import time

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError


class Bowl:
    """A paraboloid about 0.7."""

    def prepare(self) -> None:
        pass

    def costs(self, theta: np.ndarray, limit: float = math.inf, stop=None) -> np.ndarray:
        return np.sqrt(((theta - 0.7) ** 2).sum(axis=1))

    def residuals(self, theta: np.ndarray) -> np.ndarray:
        return theta - 0.7


class Broken(Bowl):
    """Fails by itself, which is no loss of a worker."""

    def costs(self, theta: np.ndarray, limit: float = math.inf, stop=None) -> np.ndarray:
        raise IdentError(ErrorCode.BAD_VALUES, 'the bowl has a hole; mend it')


class Slow(Bowl):
    """Takes longer than anybody waits."""

    def costs(self, theta: np.ndarray, limit: float = math.inf, stop=None) -> np.ndarray:
        time.sleep(3.0)
        return super().costs(theta)
