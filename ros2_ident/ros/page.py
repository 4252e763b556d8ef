# SPDX-License-Identifier: Apache-2.0
"""The page on a run, written by a process of its own: messages and runs need not wait for it."""

from pathlib import Path
import subprocess
import sys

# The process goes behind everything else, as the worker does.
_COMMAND = ['nice', '-n', '10', sys.executable, '-m', 'ros2_ident.cli.main', 'report']


class PageWriter:
    """Starts processes that write pages, and says what became of them."""

    def __init__(self) -> None:
        self._running: list[subprocess.Popen[str]] = []

    def start(self, result_file: str) -> None:
        """Begin to write the page on a run.

        Args:
            result_file: Path of its result or diagnosis file; empty to write nothing.
        """
        if result_file:
            self._running.append(
                subprocess.Popen(
                    [*_COMMAND, str(Path(result_file).parent)],
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.PIPE,
                    text=True,
                    start_new_session=True,  # Ctrl-C ends the node, and the page is still written
                )
            )

    def failures(self) -> list[str]:
        """Return a sentence for each page that could not be written since the last call."""
        ended = [process for process in self._running if process.poll() is not None]
        self._running = [process for process in self._running if process not in ended]
        out = []
        for process in ended:
            _, said = process.communicate()
            if process.returncode:
                out.append(
                    f'the page on a run was not written ({said.strip()}); its other files are '
                    'there, and `ident report` writes the page from them'
                )
        return out
