# SPDX-License-Identifier: Apache-2.0
"""A search's state in a file: NPZ, no pickle, replaced in one step."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
import json
from pathlib import Path
from typing import Any

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import write_arrays
from ros2_ident.search.genetic import GeneticSearch, GeneticSettings
from ros2_ident.search.operators import Array, Flags, Index

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


@dataclass(frozen=True, eq=False)
class Kept:
    """What a checkpoint holds.

    Attributes:
        search: State of the search, for `GeneticSearch.from_state`.
        best_costs: (G,) best cost after every generation.
        candidates: (E, N) candidates so far.
        costs: (E,) their costs, or lower bounds.
        exact: (E,) where it is the cost.
        generations: (E,) their generations.
    """

    search: Mapping[str, Any]
    best_costs: Array
    candidates: Array
    costs: Array
    exact: Flags
    generations: Index


class Checkpoint:
    """A file from which a fit goes on where it was cut off.

    Args:
        path: The file, by convention `*.npz`.
        key: Of the problem; a checkpoint of another one is refused.
    """

    def __init__(self, path: Path, key: str) -> None:
        self.path = path
        self._key = key

    def write(
        self,
        search: GeneticSearch,
        best_costs: Array,
        candidates: Array,
        costs: Array,
        exact: Flags,
        generations: Index,
    ) -> None:
        """Replace the file by the state after a generation; arguments as for `Kept`."""
        state = {f'search_{k}': v for k, v in search.state().items()}
        history = {
            'best_costs': best_costs,
            'candidates': candidates,
            'costs': costs,
            'exact': exact,
            'generations': generations,
        }
        write_state(self.path, {**state, **history, 'key': self._key})

    def read(self, seed: int, settings: GeneticSettings) -> Kept | None:
        """Return what the file holds, None where there is none.

        Raises:
            IdentError: BAD_VALUES where it is damaged, or of another problem, seed or settings.
        """
        if not self.path.exists():
            return None
        state = read_state(self.path)
        search = {
            k.removeprefix('search_'): v for k, v in state.items() if k.startswith('search_')
        }
        same = (
            state.get('key') == self._key
            and search.get('seed') == seed
            and search.get('settings') == asdict(settings)
        )
        if not same:
            raise IdentError(
                ErrorCode.BAD_VALUES,
                f'{self.path}: belongs to a fit of other data, parameters, bounds, seed or '
                'settings; delete it, or go on with the same ones',
            )
        names = ('best_costs', 'candidates', 'costs', 'exact', 'generations')
        return Kept(search, *(np.asarray(state[name]) for name in names))

    def remove(self) -> None:
        """Remove the file: the fit has come to its end."""
        self.path.unlink(missing_ok=True)
