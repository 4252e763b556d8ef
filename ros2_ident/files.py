# SPDX-License-Identifier: Apache-2.0
"""The one writer of files: a reader finds the old content or the new, never half of one.

Everything is written beside its place under a name of its own that ends with `.partial`, brought
to the disk, and put in its place in one step. What a crash leaves therefore ends with `.partial`;
nothing reads it, the next run does not mind it, and it may be deleted.

A file takes the place only of one of its own kind: both carry the same mark near their beginning,
as a key, a comment, a field or the name of a column. All else that is there is a user's.
"""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
import errno
import fcntl
import json
import os
from pathlib import Path
import re
import secrets
import shutil
import stat
from typing import Any, IO

from ros2_ident.errors import ErrorCode

PARTIAL = '.partial'
# Some network file systems cannot bring a directory to the disk.
_NO_SYNC = (errno.EINVAL, errno.ENOTSUP, errno.EBADF)
_MARK = re.compile(
    rb'(?:schema|format)\W{1,4}ros2_ident\.(\w+)|name="(generator)" content="ros2_ident '
    rb'|ros2_ident (journal)'
)
# The head of a table of many columns is long.
_MARKED = 1 << 16


def mark(kind: str) -> str:
    """Return the mark of files of a kind, which a later run may replace."""
    return f'format=ros2_ident.{kind}'


def kind_of(path: str | Path) -> bytes:
    """Return the kind that a file's mark names; empty where it has none."""
    with suppress(OSError), regular(path) as file:
        found = _MARK.search(file.read(_MARKED))
        return found[found.lastindex or 0] if found else b''
    return b''


def require_ours(
    paths: Iterable[str | Path], inputs: Iterable[str | Path] = (), *, kind: bytes | None = None
) -> None:
    """Refuse to write where something is that is not ours to replace.

    Args:
        paths: Files to write. One that is empty holds nothing that could be lost.
        inputs: What is read; it is not replaced even where it carries a mark.
        kind: What the mark of a file that is there has to name; any where None.

    Raises:
        IdentError: INVALID_GOAL with the remedy.
    """
    read = {Path(x).resolve() for x in inputs}
    for path in map(Path, paths):
        what, there = '', kind_of(path)
        empty = path.is_file() and not path.stat().st_size
        if path.is_dir():
            what = 'is a directory where a file has to go'
        elif path.resolve() in read:
            what = 'is what is read and will not be replaced'
        elif not there and os.path.lexists(path) and not empty:
            what = 'is no file that ident wrote and will not be replaced'
        elif there and kind not in (None, there):
            what = f'is a file of another kind ({there.decode()}) and will not be replaced'
        if what:
            raise ErrorCode.INVALID_GOAL.error(
                f'{path}: {what}; move it away, or give another place for the results'
            )


def make_directory(path: str | Path) -> Path:
    """Make the directory results go to, with its parents.

    Raises:
        IdentError: INVALID_GOAL where something else is there or it cannot be written to.
    """
    path, why = Path(path), ''
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        why = 'is no folder' if path.exists() else f'cannot be made ({exc.strerror})'
    if not why and not os.access(path, os.W_OK):
        why = 'cannot be written to'
    if why:
        raise ErrorCode.INVALID_GOAL.at(path, f'{why}; give another directory for the results')
    return path


@contextmanager
def sole_writer(path: str | Path, names: Iterable[str] = ()) -> Iterator[Path]:
    """Make the directory results go to, and yield it; no other run writes there meanwhile.

    Raises:
        IdentError: INVALID_GOAL where it cannot be made, `require_ours` refuses one of the files,
            or another run writes there.
    """
    path = make_directory(path)
    require_ours(path / name for name in names)
    number = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(number)
        raise ErrorCode.INVALID_GOAL.error(
            f'{path}: another run writes its results there; wait for its end, or give another '
            'directory'
        ) from None
    except OSError:
        pass  # some network file systems lock no directories
    try:
        yield path
    finally:
        os.close(number)


@contextmanager
def replacing(path: str | Path, *, replace: bool = False) -> Iterator[IO[bytes]]:
    """Give a binary file to write to, which takes the place of `path` when all of it is written.

    Where an exception ends the writing, `path` stays what it was.

    Args:
        path: The file; its directory exists.
        replace: Whether a file that is there may go even without the mark of the new one. It is
            for the caller to know that it is his own.

    Raises:
        IdentError: INVALID_GOAL where it cannot be written, or something else is there.
    """
    path = Path(path)
    partial = _beside(path)
    with _explained(path):
        try:
            with partial.open('xb') as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            if not replace:
                require_ours([path], kind=kind_of(partial))
            os.replace(partial, path)
        except BaseException:
            with suppress(OSError):
                partial.unlink()
            raise
        _sync(path.parent)


@contextmanager
def replacing_directory(path: str | Path, *, replace: bool = False) -> Iterator[Path]:
    """Give the path of a directory to make, which takes the place of `path` when it is whole.

    It has the same name and is on the same file system. The parents of `path` are made.

    Args:
        replace: Whether a directory that is there may go. It is for the caller to know that it
            is his own.

    Raises:
        IdentError: INVALID_GOAL where something is in the way or it cannot be written.
    """
    path = Path(path)
    partial = _beside(path)
    new, old = partial / 'new' / path.name, partial / 'old'
    with _explained(path):
        try:
            new.parent.mkdir(parents=True)
            yield new
            for made in (new, *new.rglob('*')):
                _sync(made)
            if os.path.lexists(path):
                if path.is_symlink() or not replace:
                    raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
                os.rename(path, old)
            os.rename(new, path)
        except BaseException:
            if old.exists():
                os.rename(old, path)
            shutil.rmtree(partial, ignore_errors=True)
            raise
        _sync(path.parent)
    shutil.rmtree(partial, ignore_errors=True)


def remove_file(path: str | Path) -> None:
    """Remove a file, or the link that is there; nothing need be.

    Raises:
        IdentError: INVALID_GOAL where it cannot be removed, or is not ours.
    """
    require_ours([path])
    with _explained(Path(path)):
        Path(path).unlink(missing_ok=True)


def remove_directory(path: str | Path) -> None:
    """Remove a directory: it is whole there, or not at all.

    Args:
        path: It is for the caller to know that it is his own.

    Raises:
        IdentError: INVALID_GOAL where it cannot be removed.
    """
    partial = _beside(Path(path))
    with _explained(Path(path)):
        os.rename(path, partial)
    shutil.rmtree(partial, ignore_errors=True)


def write_text(path: str | Path, text: str, *, replace: bool = False) -> Path:
    """Write a text as UTF-8, its line ends as they are, and return the path; see `replacing`."""
    with replacing(path, replace=replace) as file:
        file.write(text.encode())
    return Path(path)


def write_json(path: str | Path, data: Mapping[str, Any], indent: int = 1) -> Path:
    """Write JSON, what is not finite as null, and return the path; see `replacing`."""
    from ros2_ident.arrays import plain

    return write_text(path, json.dumps(plain(data), indent=indent, allow_nan=False) + '\n')


def write_arrays(path: str | Path, arrays: Mapping[str, Any]) -> Path:
    """Write arrays by name as NPZ without pickle, and return the path; see `replacing`."""
    import numpy as np

    with replacing(path) as file:
        np.savez_compressed(file, allow_pickle=False, **{mark('arrays'): np.array(1), **arrays})
    return Path(path)


def unreadable(path: str | Path) -> str:
    """Return why nothing can be read at a path, in words that follow it; empty where it can.

    What is neither file nor folder, as a pipe, may never begin or never end.
    """
    path = Path(path)
    if path.is_file() or path.is_dir():
        return ''
    return 'is no regular file or folder' if path.exists() else 'does not exist'


def read_small(path: str | Path, most: int = 1 << 18) -> bytes:
    """Return the content of a file that people write, as a configuration.

    Args:
        most: Most bytes of it.

    Raises:
        OSError: It cannot be read, is no regular file (which might never end), or is larger.
    """
    with regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise OSError(errno.EFBIG, f'it has {size} bytes and may have {most}')
        return file.read(most)


def read_yaml(path: str | Path, most: int = 1 << 18) -> Any:
    """Return what a YAML file holds; arguments as of `read_small`.

    Raises:
        ValueError: It cannot be read or is no YAML, in words that follow its name.
    """
    import yaml

    try:
        return yaml.safe_load(read_small(path, most).decode())
    except OSError as error:
        raise ValueError(f'cannot be read ({error.strerror})') from None
    except RecursionError:
        raise ValueError('is no YAML (it is nested without end)') from None
    except (yaml.YAMLError, ValueError, TypeError, OverflowError) as error:
        raise ValueError(f'is no YAML ({" ".join(str(error).split())})') from None


class Growing:
    """A file that grows as data arrive, and that only one process writes.

    The one kind that may be found half written: for formats whose readers take what is whole.

    Args:
        path: The file; its directory is made. What it holds is kept.

    Attributes:
        size: Bytes in it.

    Raises:
        IdentError: INVALID_GOAL where it cannot be written, here and in every step, or another
            process writes it.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        make_directory(self._path.parent)
        with _explained(self._path):
            self._number = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            try:
                fcntl.flock(self._number, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                os.close(self._number)
                raise OSError(errno.EBUSY, 'another process writes it') from None
            self.size = os.lseek(self._number, 0, os.SEEK_END)

    def read(self, start: int, count: int) -> bytes:
        """Return bytes from a place on, fewer at the end of it."""
        return os.pread(self._number, count, start)

    def write(self, data: bytes) -> None:
        """Append bytes; where that fails, what was there before stays whole."""
        with _explained(self._path):
            done = 0
            try:
                while done < len(data):
                    done += os.pwrite(self._number, data[done:], self.size + done)
            except OSError:
                os.ftruncate(self._number, self.size)
                raise
            self.size += done

    def cut(self, size: int) -> None:
        """Keep only the first bytes."""
        with _explained(self._path):
            os.ftruncate(self._number, size)
            self.size = size

    def close(self) -> None:
        """Let others write it."""
        os.close(self._number)


@contextmanager
def regular(path: str | Path) -> Iterator[IO[bytes]]:
    """Open a regular file to read; a pipe is not waited for."""
    with open(path, 'rb', opener=lambda x, flags: os.open(x, flags | os.O_NONBLOCK)) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, 'it is no regular file')
        yield file


def _beside(path: Path) -> Path:
    """Return a path in the same directory that no other process and no earlier run has."""
    return path.with_name(f'{path.name}.{secrets.token_hex(4)}{PARTIAL}')


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Turn the system's refusal to write into a sentence with the remedy."""
    try:
        yield
    except OSError as exc:
        raise ErrorCode.INVALID_GOAL.error(
            f'{path}: cannot be written ({exc.strerror or exc}); make room there, or give another '
            'directory'
        ) from exc


def _sync(path: Path) -> None:
    """Bring a file or the names in a directory to the disk."""
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    except OSError as exc:
        if exc.errno not in _NO_SYNC:
            raise
    finally:
        os.close(number)
