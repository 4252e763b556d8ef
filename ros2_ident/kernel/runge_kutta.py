# SPDX-License-Identifier: Apache-2.0
"""The classical Runge-Kutta scheme of fourth order, for positions whose accelerations are known.

Positions and rates are kept apart (Nystrom's form): what a stage needs of a coordinate follows
from its position and rate at the step's start and two accelerations before.
The step length is a number of each lane; a lane whose step is zero keeps its state.
"""
# mypy: ignore-errors

from ros2_ident.lanes import inlined, load, store, WIDTH

W = WIDTH
STAGES = 4


@inlined
def ahead(part):
    """Return how far stage 0 to 3 is ahead of the step's start, in steps."""
    return 0.0 if part == 0 else (1.0 if part == 3 else 0.5)


@inlined
def stage_state(place, rate, bend, count, row, part, h):
    """Return position and rate of coordinate `row` at a stage of a step of `h` seconds.

    Args:
        place: (N * W,) positions at the step's start.
        rate: (N * W,) their rates.
        bend: (4 * N * W,) accelerations of the stages before.
        count: Coordinates N.
        row: Which of them.
        part: The stage, 0 to 3.
        h: Step [s].
    """
    square = 0.0 if part < 2 else (0.25 if part == 2 else 0.5)
    before = max(part - 1, 0)
    earlier = max(part - 2, 0)
    near = ahead(part) * h
    v = load(rate, row * W)
    x = load(place, row * W) + near * v
    x = x + (square * h * h) * load(bend, (earlier * count + row) * W)
    return x, v + near * load(bend, (before * count + row) * W)


@inlined
def finish(place, rate, bend, count, used, h):
    """Move the first `used` coordinates to the end of the step; arguments as `stage_state`."""
    sixth = h * (1.0 / 6.0)
    for row in range(used):
        first = load(bend, row * W)
        middle = load(bend, (count + row) * W) + load(bend, (2 * count + row) * W)
        last = load(bend, (3 * count + row) * W)
        v = load(rate, row * W)
        store(place, row * W, load(place, row * W) + h * (v + sixth * (first + middle)))
        store(rate, row * W, v + sixth * (first + (middle + middle + last)))
