# SPDX-License-Identifier: Apache-2.0
"""Programs in processes that need not import the package: forks of one that has.

python test/forked.py PLACE                  is that one, until its standard input ends
python test/forked.py PLACE ident WORDS...   is `ident WORDS`; a script where one is named
"""

import json
import os
import runpy
import select
import socket
import sys
import traceback


def serve(place: str) -> None:
    """Fork for everyone who asks."""
    from ros2_ident.threads import one_thread_for_linear_algebra

    one_thread_for_linear_algebra()  # before NumPy is loaded, as `ident` does
    import ros2_ident.jobs
    import ros2_ident.report.overlay
    import ros2_ident.report.page  # noqa: F401

    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(place)
        listener.listen()
        print('ready', flush=True)
        while listener in select.select([listener, sys.stdin], [], [])[0]:
            asker, _ = listener.accept()
            text, files, *_ = socket.recv_fds(asker, 1 << 20, 3)
            if not (child := os.fork()):
                os._exit(run(files, **json.loads(text)))
            for file in files:
                os.close(file)
            asker.send(bytes([os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) & 255]))
            asker.close()


def run(files: list[int], words: list[str], folder: str, variables: dict[str, str]) -> int:
    """Be the program that was asked for; return its exit code."""
    for number, file in enumerate(files):
        os.dup2(file, number)
    sys.stdout, sys.stderr = os.fdopen(1, 'w'), os.fdopen(2, 'w')
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(variables)
    sys.argv, sys.path[0] = words, os.path.dirname(os.path.abspath(words[0]))
    try:
        if words[0] == 'ident':
            from ros2_ident.cli.main import main

            return main(words[1:])
        runpy.run_path(words[0], run_name='__main__')
        return 0
    except SystemExit as end:
        return int(end.code or 0)
    except BaseException:
        traceback.print_exc()
        return 1
    finally:
        sys.stdout.flush()
        sys.stderr.flush()


def ask(place: str, words: list[str]) -> int:
    """Have a program run on these standard streams; return its exit code."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as server:
        server.connect(place)
        said = {'words': words, 'folder': os.getcwd(), 'variables': dict(os.environ)}
        socket.send_fds(server, [json.dumps(said).encode()], [0, 1, 2])
        return (server.recv(1) or b'\1')[0]


if __name__ == '__main__':
    sys.exit(ask(sys.argv[1], sys.argv[2:]) if sys.argv[2:] else serve(sys.argv[1]))
