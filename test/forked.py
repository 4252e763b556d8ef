# SPDX-License-Identifier: Apache-2.0
"""Programs in processes that need not import the package: forks of one that has.

python test/forked.py serve PLACE MODULE...   is that one, until its standard input ends
python test/forked.py ask PLACE WORDS...      is what `python WORDS...` would be
"""

import atexit
from functools import cache
import importlib
import json
import os
from pathlib import Path
import runpy
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import traceback

KIND = socket.AF_UNIX, socket.SOCK_SEQPACKET
# What most programs of the package load.
LOADED = 'ros2_ident.jobs', 'ros2_ident.report.overlay', 'ros2_ident.report.page'


@cache
def forked(*modules: str) -> tuple[str, ...]:
    """Start what forks, with these modules loaded; return the words that `python` stands for."""
    place = f'{tempfile.mkdtemp()}/socket'
    server = subprocess.Popen(
        [sys.executable, __file__, 'serve', place, *LOADED, *modules],
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, sys.path))},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert server.stdout is not None and server.stdout.readline() == 'ready\n'

    def end() -> None:
        server.communicate()
        shutil.rmtree(Path(place).parent)

    atexit.register(end)
    return sys.executable, '-S', __file__, 'ask', place


def serve(place: str, modules: list[str]) -> None:
    """Fork for everyone who asks."""
    from ros2_ident.threads import one_thread_for_linear_algebra

    one_thread_for_linear_algebra()  # before NumPy is loaded, as programs do
    for module in modules:
        importlib.import_module(module)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    with socket.socket(*KIND) as listener:
        listener.bind(place)
        listener.listen()
        print('ready', flush=True)
        while listener in select.select([listener, sys.stdin], [], [])[0]:
            asker, _ = listener.accept()
            if not os.fork():
                watch(asker)
                os._exit(0)
            asker.close()


def watch(asker: socket.socket) -> None:
    """Fork the program, tell its number and its exit code, and kill it where nobody asks now."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    said, files, *_ = socket.recv_fds(asker, 1 << 20, 3)
    if not (child := os.fork()):
        asker.close()
        os._exit(run(files, **json.loads(said)))
    for file in files:
        os.close(file)
    asker.send(str(child).encode())
    if asker in select.select([os.pidfd_open(child), asker], [], [])[0]:
        os.kill(child, signal.SIGKILL)
    else:
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        asker.send(str(code & 255).encode())


def run(files: list[int], words: list[str], folder: str, variables: dict[str, str]) -> int:
    """Be the program that was asked for; return its exit code."""
    for number, file in enumerate(files):
        os.dup2(file, number)
    sys.stdout, sys.stderr = os.fdopen(1, 'w'), os.fdopen(2, 'w', 1)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(variables)
    try:
        if words[0] == '-m':
            sys.argv = words[1:]
            runpy.run_module(words[1], run_name='__main__', alter_sys=True)
        else:
            sys.argv, sys.path[0] = words, os.path.dirname(os.path.abspath(words[0]))
            runpy.run_path(words[0], run_name='__main__')
        return 0
    except SystemExit as end:
        return int(end.code or 0)
    except BaseException:
        traceback.print_exc()
        return 1
    finally:
        sys.stdout.flush()


def ask(place: str, words: list[str]) -> int:
    """Have a program run on these standard streams, pass signals on; return its exit code."""
    with socket.socket(*KIND) as server:
        server.connect(place)
        said = {'words': words, 'folder': os.getcwd(), 'variables': dict(os.environ)}
        socket.send_fds(server, [json.dumps(said).encode()], [0, 1, 2])
        child = int(server.recv(64))
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda number, _: os.kill(child, number))
        return int(server.recv(64) or 1)


if __name__ == '__main__':
    what, there, *more = sys.argv[1:]
    sys.exit(ask(there, more) if what == 'ask' else serve(there, more))
