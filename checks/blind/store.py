# SPDX-License-Identifier: Apache-2.0
"""The directory of a run: what is sealed, what was answered, what was scored."""

from collections.abc import Mapping, Sequence
import json
from pathlib import Path
import subprocess
from typing import Any

from checks.blind import seal
from ros2_ident.compiled import result_digest
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import write_text

RUN, SEALED, TABLE, MACHINE = 'run.json', 'sealed', 'table.jsonl', 'machine.yaml'
CLEAN = 'clean'
# What is committed before the first diagnosis: the hash of every label, and one over these.
SEALS = 'seals.json'


def stamp() -> dict[str, str]:
    """Return of which commit, with or without changes, and of which sources this program is."""
    here = Path(__file__).parent

    def git(*words: str) -> str:
        try:
            done = subprocess.run(
                ['git', '-C', str(here), *words],  # noqa: S607 - whichever is on the path
                capture_output=True,
                text=True,
                check=True,
            )
        except (OSError, subprocess.CalledProcessError):
            return ''
        return done.stdout.strip()

    commit = git('rev-parse', '--short=12', 'HEAD')
    changed = '+' if commit and git('status', '--porcelain', '--untracked-files=no') else ''
    return {'commit': commit + changed, 'sources': result_digest()}


def write_json(path: Path, content: Any) -> None:
    """Write a file such that a reader finds all of it or none."""
    write_text(path, json.dumps(content, indent=1) + '\n', replace=True)


def read_json(path: Path) -> Any:
    """Read a JSON file; None where there is none."""
    try:
        return json.loads(path.read_text(encoding='utf-8'))
    except FileNotFoundError:
        return None


class Store:
    """Paths and files of one run."""

    def __init__(self, root: str | Path) -> None:
        self.root = Path(root)

    @property
    def machine(self) -> Path:
        """The machine file that the diagnosis reads."""
        return self.root / MACHINE

    def case(self, number: int) -> Path:
        """Return the directory of a case."""
        return self.root / 'cases' / f'case_{number:04d}'

    def clean(self, number: int) -> Path:
        """Return the bag held out of a case as it would be without noise."""
        return self.root / CLEAN / f'case_{number:04d}'

    def begin(self, what: Mapping[str, Any], machine: str | Path) -> None:
        """Begin a run, or go on with the one that is here.

        Raises:
            IdentError: INVALID_GOAL where another run is here.
        """
        there = read_json(self.root / RUN)
        if there is None and (self.root / 'cases').exists():
            raise IdentError(
                ErrorCode.INVALID_GOAL,
                f'{self.root} holds `cases` of no run, which a run would replace; give an empty '
                'directory',
            )
        (self.root / SEALED).mkdir(parents=True, exist_ok=True)
        text = Path(machine).read_text(encoding='utf-8')
        if there is None:
            write_text(self.machine, text, replace=True)
            write_json(self.root / RUN, dict(what))
            return
        same = all(there.get(key) == what[key] for key in ('cases', 'seed', 'shares'))
        if not same or self.machine.read_text(encoding='utf-8') != text:
            raise IdentError(
                ErrorCode.INVALID_GOAL,
                f'{self.root} holds another run ({there["cases"]} cases, seed {there["seed"]}); '
                'give an empty directory, or the same machine, cases, seed and shares to go on',
            )

    def about(self) -> dict[str, Any]:
        """Return what the run is.

        Raises:
            IdentError: INVALID_GOAL where there is no run.
        """
        found = read_json(self.root / RUN)
        if found is None:
            raise IdentError(
                ErrorCode.INVALID_GOAL, f'{self.root} holds no run of `checks.blind`; give another'
            )
        return dict(found)

    def note(self, **more: Any) -> None:
        """Add to what the run is."""
        write_json(self.root / RUN, {**self.about(), **more})

    def close_seals(self, cases: int) -> str:
        """Write the hashes of all labels to `seals.json`; return the one over them."""
        seals = [(self.sealed(n) or {})['sha256'] for n in range(1, cases + 1)]
        digest = seal.manifest(seals)
        what = {'manifest': digest, 'cases': cases, 'seals': seals}
        write_json(self.root / SEALS, what)
        self.note(manifest=digest)
        return digest

    def diagnosed_by(self, now: Mapping[str, str]) -> None:
        """Note which program diagnoses; every one that did is kept."""
        before = list(self.about().get('diagnosed', []))
        if dict(now) not in before:
            self.note(diagnosed=[*before, dict(now)])

    def sealed(self, number: int) -> dict[str, str] | None:
        """Return a sealed label, or None."""
        found: dict[str, str] | None = read_json(self.root / SEALED / f'{number:04d}.json')
        return found

    def seal(self, number: int, sealed: Mapping[str, str]) -> None:
        """Keep a sealed label."""
        write_json(self.root / SEALED / f'{number:04d}.json', dict(sealed))

    def answered(self, number: int) -> dict[str, Any] | None:
        """Return how a diagnosis went, or None where it has not ended."""
        found: dict[str, Any] | None = read_json(self.case(number) / 'run.json')
        return found

    def rows(self) -> list[dict[str, Any]]:
        """Return the scored cases."""
        path = self.root / TABLE
        if not path.exists():
            return []
        lines = path.read_text(encoding='utf-8').splitlines()
        return [json.loads(line) for line in lines if line.strip()]

    def write_rows(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Keep the scored cases, in the order of their numbers."""
        ordered = sorted(rows, key=lambda row: int(row['case']))
        text = ''.join(json.dumps(row) + '\n' for row in ordered)
        write_text(self.root / TABLE, text, replace=True)
