# SPDX-License-Identifier: Apache-2.0
"""A search's state in a file: NPZ, no pickle, replaced in one step."""

from collections.abc import Mapping
import json
from pathlib import Path
from typing import Any

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import write_arrays

_PLAIN = 'plain_json'


def write_state(path: str | Path, state: Mapping[str, Any]) -> None:
    """Write a state such that a crash leaves the old file or the new one, never half of one.

    Args:
        path: The file, by convention `*.npz`.
        state: From `GeneticSearch.state`: arrays, and plain data that JSON can hold.
    """
    arrays = {k: v for k, v in state.items() if isinstance(v, np.ndarray)}
    plain = json.dumps({k: v for k, v in state.items() if k not in arrays})
    # The generator's state has 128-bit integers: JSON keeps them, no array type does.
    arrays[_PLAIN] = np.frombuffer(plain.encode(), dtype=np.uint8)
    write_arrays(path, arrays, packed=False)


def read_state(path: str | Path) -> dict[str, Any]:
    """Read what `write_state` wrote.

    Args:
        path: The file.

    Returns:
        The state, for `GeneticSearch.from_state`.

    Raises:
        IdentError: NO_DATA where there is no such file, BAD_VALUES where it is no search state.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            state = {k: file[k] for k in file.files}
        plain = json.loads(state.pop(_PLAIN).tobytes().decode())
    except FileNotFoundError:
        raise IdentError(
            ErrorCode.NO_DATA, f'{path}: no such file; start the search without a state'
        ) from None
    except Exception as exc:  # zipfile, zlib, json and numpy each have their own
        raise IdentError(
            ErrorCode.BAD_VALUES,
            f'{path}: is no search state ({exc}); delete it and start the search anew',
        ) from None
    return {**plain, **state}
