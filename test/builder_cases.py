# SPDX-License-Identifier: Apache-2.0
"""Single messages for a builder of recordings."""

from collections.abc import Sequence

import numpy as np

from ros2_ident.recording import RecordingBuilder

Values = Sequence[float] | np.ndarray


def add(
    builder: RecordingBuilder,
    role: str,
    stamp: int,
    names: Sequence[str],
    position: Values = (),
    velocity: Values = (),
    effort: Values = (),
) -> None:
    """Append one message; what is empty was not measured."""
    values = (np.array(x)[None] if len(x) else None for x in (position, velocity, effort))
    builder.add_block(role, np.array([stamp]), names, *values)
