# SPDX-License-Identifier: Apache-2.0
"""An objective that other processes unpack quickly, and that can take its worker with it."""

import math
import os
from pathlib import Path
import signal
import time

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError


class Bowl:
    """A paraboloid about 0.7.

    Args:
        deadly: The first process to make this file, other than the one it was made in, is killed.
        slow: Time an evaluation takes at least, s.
    """

    def __init__(self, deadly: Path | None = None, slow: float = 0.0) -> None:
        self.deadly = deadly
        self.slow = slow
        self.home = os.getpid()

    def prepare(self) -> None:
        pass

    def costs(self, theta: np.ndarray, limit: float = math.inf, stop=None) -> np.ndarray:
        time.sleep(self.slow)
        if self.deadly is not None and os.getpid() != self.home:
            try:
                self.deadly.touch(exist_ok=False)
            except FileExistsError:
                pass
            else:
                os.kill(os.getpid(), signal.SIGKILL)
        return np.sqrt(((theta - 0.7) ** 2).sum(axis=1))

    def residuals(self, theta: np.ndarray) -> np.ndarray:
        return theta - 0.7


class Broken(Bowl):
    """Fails by itself, which is no loss of a worker."""

    def costs(self, theta: np.ndarray, limit: float = math.inf, stop=None) -> np.ndarray:
        raise IdentError(ErrorCode.BAD_VALUES, 'the bowl has a hole; mend it')
