# SPDX-License-Identifier: Apache-2.0
"""How good the time to go was that a run told: from 20 % of the run on, beside the truth.

Example: python checks/benchmarks/time_to_go.py diagnose my_bag --machine my.yaml --out build/run
"""

import argparse
import math
import sys
import time
from typing import Any, Self

from ros2_ident.cli import progress
from ros2_ident.cli.main import main as ident

# Share of the run from which on what is told counts, and how far off it may be.
FROM, FACTOR = 0.2, 2.0


class Listener:
    """Takes the place of what shows progress; notes when which time to go was told."""

    told: list[tuple[float, float]] = []

    def __init__(self, **_: object) -> None:
        """Begin; what is shown otherwise is of no matter."""

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Leave nothing behind."""

    def note(self, text: str) -> None:
        """Let a sentence pass."""

    def __call__(self, fraction: float, text: str, eta: float) -> None:
        """Note the time to go of a diagnosis."""
        self.told.append((time.monotonic(), eta))

    def search(self, progress: Any) -> None:
        """Note the time to go of an identification."""
        self.told.append((time.monotonic(), float(progress.eta)))


def main() -> int:
    """Run the command, then print how good it told."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('words', nargs=argparse.REMAINDER, help='what `ident` is called with')
    words = parser.parse_args().words
    setattr(progress, 'Meter', Listener)  # noqa: B010
    code = ident(words)
    end, begin = time.monotonic(), Listener.told[0][0]
    ratios = [
        eta / (end - now)
        for now, eta in Listener.told
        if now - begin >= FROM * (end - begin) and end - now > 1.0 and not math.isnan(eta)
    ]
    off = [ratio for ratio in ratios if not 1.0 / FACTOR <= ratio <= FACTOR]
    least, most = min(ratios, default=math.nan), max(ratios, default=math.nan)
    now, eta = Listener.told[-1]
    print(
        f'time to go: {len(off)} of {len(ratios)} reports outside a factor of {FACTOR:g}, '
        f'told over true {least:.2f} to {most:.2f}; the last one {eta / (end - now):.2f}'
    )
    return code


if __name__ == '__main__':
    sys.exit(main())
