# SPDX-License-Identifier: Apache-2.0
"""Section 4 of the paper: the tripod drive identified with Table 4's settings."""

from collections.abc import Callable
from pathlib import Path


def tripod_section(
    figures: Path, progress: Callable[[float, str], None], *, seeds: int = 20
) -> str:
    """Run section 4 and return its part of the page.

    Args:
        figures: Folder for the pictures of Figs. 11 to 13; exists.
        progress: Takes the part of this section that is done, 0 to 1, and a short text.
        seeds: Seeds for success rates.

    Returns:
        Markdown from its `##` heading on; pictures are referred to as `paper/NAME.png`.
    """
    return (
        '## Section 4: the tripod\n\nFigures 11 to 13 and Table 5 are not part of this run yet.\n'
    )
