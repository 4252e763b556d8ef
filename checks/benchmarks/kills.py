# SPDX-License-Identifier: Apache-2.0
"""Kill a command or the node at random moments, go on, and look at what comes of it.

A run that has everything before it is killed (SIGKILL, with all its threads) at a moment drawn
evenly from the processor time that it takes undisturbed, the import of its modules excepted: runs
are forked from a process that has them. Then it is started again, and in one of four cases killed
again; at last it may end. Its directory holds the results of an earlier run with another seed.
After each kill every file has to be whole and of one run, old or new; at the end the result has to
be the uninterrupted one's to the bit, and nothing else may be left. The node gets the same goal
again after each kill.

Example: python checks/benchmarks/kills.py identify --kills 100
"""

import argparse
from collections import Counter
from collections.abc import Sequence
import json
import multiprocessing
import os
from pathlib import Path
import random
import shutil
import sys
import tempfile
import time
from typing import Any

import numpy as np

from ros2_ident.cli.main import main as ident
from ros2_ident.recording import read_bag
from ros2_ident.threads import ONE_THREAD

ROOT = Path(__file__).parents[2]
MACHINE = ROOT / 'config' / 'emps.yaml'
# So that a diagnosis has rounds of fits to be killed in.
LOG = ['--motion', 'reversals', '--seconds', '8', '--seed', '3']
LOG += ['--effect', 'stribeck@emps_axis:torque=12,velocity=0.02']
# What of a result says when and where it was made, not what was found.
OCCASION = ('seconds', 'created', 'host', 'settings', 'provenance')
AGAIN = 0.25  # share of the runs started again that are killed, too
BEFORE, IN_WORK, WITH_RESULT = 'before its work', 'in its work', 'with the new result'
PATIENCE = 600.0  # the node answers within this time, s, or it never will
FILES = {
    'identify': ('result.json', 'history.npz', 'signals.npz'),
    'diagnose': ('diagnosis.json', 'diagnosis.npz'),
}


# Modules that the commands and the node load while they run.
LOADED = [
    'ros2_ident.cli.main',
    'ros2_ident.gap.diagnose',
    'ros2_ident.identify.run',
    'ros2_ident.report.overlay',
    'ros2_ident.report.page',
    'checks.reference.bag_making',
    'ros2_ident.ros.node',
]
FORKED = multiprocessing.get_context('forkserver')


def command(name: str, out: Path, seed: int, more: Sequence[str] = ()) -> list[str]:
    """Return the words of a run on the bag beside its directory."""
    words = [name, str(out.with_name('bag')), '--machine', str(MACHINE)]
    if name == 'simulate':
        return [*words, *more]
    return [*words, '--seed', str(seed), '--out', str(out), '--quiet', *more]


def play(words: Sequence[str], said: str) -> None:
    """Be a run: `ident`, or the node where the words are its."""
    file = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(file, 1)
    os.dup2(file, 2)
    if '--ros-args' not in words:
        sys.exit(ident(words))
    from ros2_ident.ros.identifier import main as identifier

    sys.argv = ['identifier', *words]
    sys.exit(identifier())


class Run:
    """A process that runs `ident` or the node."""

    def __init__(self, words: Sequence[str], said: Path) -> None:
        self.process = FORKED.Process(target=play, args=(list(words), str(said)))
        self.process.start()
        # clock_getcpuclockid(3): the clock of another process's processor time
        self._clock = (~int(self.process.pid or 0) << 3) | 2
        self.used = 0.0

    def lives(self, moment: float | None = None) -> bool:
        """Return whether it still runs, 5 ms later or once it has used so many seconds."""
        self.process.join(0.005)
        if self.process.is_alive():
            try:
                self.used = time.clock_gettime(self._clock)
            except OSError:
                self.process.join()
        return self.process.is_alive() and (moment is None or self.used < moment)

    def kill(self) -> None:
        """Kill it."""
        self.process.kill()
        self.process.join()


def seconds(words: Sequence[str], said: Path) -> float:
    """Let a run end; return the processor time it took, s."""
    run = Run(words, said)
    while run.lives():
        pass
    if run.process.exitcode not in (0, 1):
        raise RuntimeError(said.read_text())
    return run.used


def told(value: Any) -> Any:
    """Return a result without what tells of the occasion."""
    if isinstance(value, dict):
        return {k: told(v) for k, v in value.items() if k not in OCCASION}
    return [told(x) for x in value] if isinstance(value, list) else value


def content(path: Path) -> Any:
    """Return what a file holds; fails where it is not whole."""
    if path.suffix == '.npz':
        with np.load(path, allow_pickle=False) as file:
            return {k: (file[k].dtype.str, file[k].shape, file[k].tobytes()) for k in file.files}
    return told(json.loads(path.read_text()))


def results(name: str, out: Path) -> dict[str, Any]:
    """Return the content of the result files that are there."""
    return {x: content(out / x) for x in FILES[name] if (out / x).exists()}


def overlay(out: Path) -> bytes | None:
    """Return the bytes of the overlay bag, None where there is none; it has to be readable."""
    if not (out / 'overlay').exists():
        return None
    read_bag(out / 'overlay')
    data = (out / 'overlay' / 'overlay.mcap').read_bytes()
    return data


def told_moments(found: Counter[str]) -> str:
    """Return when the kills came, in words."""
    return ', '.join(f'{count} {what}' for what, count in sorted(found.items()))


class Trial:
    """One run that is killed again and again.

    Args:
        old: Result files of the earlier run, which lie there.
        new: Result files of the run, uninterrupted.
    """

    def __init__(self, name: str, out: Path, old: Path, new: Path) -> None:
        self.name, self.out, self.said = name, out, out.with_name('said')
        self.old, self.new = results(name, old), results(name, new)
        page = old / 'report.html'
        self.old_page = page.read_bytes() if page.exists() else b''
        self.old_bag = (old / 'overlay' / 'overlay.mcap').read_bytes()
        self.found: Counter[str] = Counter()
        self.wrong: list[str] = []

    def run(self, words: Sequence[str], whole: float, generator: random.Random) -> int:
        """Kill a run, go on with it to its end; return how often it was killed.

        Args:
            whole: The processor time that it takes, s.
        """
        kills = 0
        moment: float | None = generator.uniform(0.0, whole)
        while True:
            run = Run(words, self.said)
            while run.lives(moment):
                pass
            if not run.process.is_alive():
                break
            run.kill()
            kills += 1
            self.look()
            moment = generator.uniform(0.0, whole) if generator.random() < AGAIN else None
        if run.process.exitcode not in (0, 1):
            text = self.said.read_text()
            self.wrong.append(f'exit code {run.process.exitcode}: {text[-300:]}')
        self.end()
        return kills

    def look(self) -> None:
        """Look at the directory after a kill."""
        files = results(self.name, self.out)
        of = {x: 'old' if v == self.old[x] else 'new' for x, v in files.items()}
        for x, v in files.items():
            if of[x] == 'new' and v != self.new[x]:
                self.wrong.append(f'{x} is neither the old one nor the new one')
        page, bag = self.out / 'report.html', overlay(self.out)
        if page.exists():
            text = page.read_bytes()
            of['page'] = 'old' if text == self.old_page else 'new'
            if not text.rstrip().endswith(b'</html>'):
                self.wrong.append('half a page')
        if bag is not None:
            of['overlay'] = 'old' if bag == self.old_bag else 'new'
        if len(set(of.values())) > 1:
            self.wrong.append(f'old beside new: {of}')
        checkpoint = self.out / f'{self.name}.checkpoint'
        written = WITH_RESULT if 'new' in of.values() else BEFORE
        self.found[IN_WORK if checkpoint.exists() else written] += 1

    def end(self) -> None:
        """Look at the directory after the end."""
        if results(self.name, self.out) != self.new:
            self.wrong.append('another result than that of the uninterrupted run')
        left = {x.name for x in self.out.iterdir()}
        left = {x for x in left if not x.endswith('.partial')}
        expected = {*FILES[self.name], 'overlay'} | ({'report.html'} if self.old_page else set())
        if left != expected:
            self.wrong.append(f'left: {sorted(left ^ expected)}')


class Client:
    """Starts the node, sends it a goal, and waits for the result."""

    def __init__(self, bag: Path, out: Path) -> None:
        import rclpy
        from rclpy.action import ActionClient
        from rclpy.signals import SignalHandlerOptions
        from ros2_ident_msgs.action import Identify
        from ros2_ident_msgs.msg import Status

        from ros2_ident.ros.outlet import LATCHED

        # rclpy's own would end the context and let this go on without it
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self.rclpy = rclpy
        self.node = rclpy.create_node('kills')
        self.connect = lambda name: ActionClient(self.node, Identify, f'/{name}/identify')
        self.hear = lambda name, callback: self.node.create_subscription(
            Status, f'/{name}/status', callback, LATCHED
        )
        self.starts = 0
        self.goal = Identify.Goal(
            bag_path=str(bag), data_source=Identify.Goal.DATA_SOURCE_BAG, refine=True
        )
        parameters = {'machine_file': MACHINE, 'output_directory': out}
        self.said = out.with_name('said')
        words = (x for k, v in parameters.items() for x in ('-p', f'{k}:={v}'))
        self.words = ['--ros-args', *words]

    def attempt(self, moment: float | None) -> float:
        """Return the processor time at which the result came, s, or 0 where the kill was first.

        Args:
            moment: Kill after this processor time, s; after the result where None.
        """
        self.starts += 1
        name = f'identifier_{self.starts}'  # a killed one is on the air for a while
        run = Run([*self.words, '-r', f'__node:={name}'], self.said)
        client = self.connect(name)
        # it answers only those it knows of; what is latched comes when it does
        known: list[Any] = []
        status = self.hear(name, known.append)
        sent, answer = None, None
        end = time.monotonic() + PATIENCE
        try:
            while run.lives(moment):
                if time.monotonic() > end:
                    raise RuntimeError(f'no result in {PATIENCE} s: {self.said.read_text()}')
                self.rclpy.spin_once(self.node, timeout_sec=0.02)
                if sent is None and known and client.server_is_ready():
                    sent = client.send_goal_async(self.goal)
                if sent is not None and answer is None and sent.done():
                    answer = sent.result().get_result_async()
                if answer is not None and answer.done():
                    return run.used
            if not run.process.is_alive():
                raise RuntimeError(self.said.read_text())
            return 0.0
        finally:
            run.kill()
            client.destroy()
            self.node.destroy_subscription(status)


def kill_the_node(folder: Path, kills: int, generator: random.Random, end: float) -> int:
    """Kill the node in its goals; return how often something was wrong."""
    seconds(command('simulate', folder / 'out', 1, LOG), folder / 'said')
    out, found, ended, wrong = folder / 'out', Counter[str](), 0, list[str]()
    client = Client(folder / 'bag', out)
    whole = client.attempt(None)
    (first,) = out.glob('*/result.json')
    reference = {x: content(first.with_name(x)) for x in ('result.json', 'history.npz')}
    while found.total() < kills and time.monotonic() < end:
        shutil.rmtree(out, ignore_errors=True)
        moment: float | None = generator.uniform(0.0, whole)
        while not client.attempt(moment):
            saved = any(out.glob('2*/result.json'))
            unfinished = any(out.glob('unfinished/*.checkpoint'))
            found[IN_WORK if unfinished else WITH_RESULT if saved else BEFORE] += 1
            for path in (x for x in out.glob('2*/*') if x.suffix in ('.json', '.npz')):
                content(path)  # fails where it is not whole
            moment = generator.uniform(0.0, whole) if generator.random() < AGAIN else None
        ended += 1
        last = max(out.glob('*/result.json'))
        if {x: content(last.with_name(x)) for x in reference} != reference:
            wrong.append('another result than that of the uninterrupted run')
        if list(out.glob('unfinished/*')):
            wrong.append('a checkpoint is left')
    print(f'node: {whole:.2f} s; {found.total()} kills, {ended} goals ended')
    print(told_moments(found))
    print(f'{len(wrong)} wrong', *wrong[:20], sep='\n  ')
    return len(wrong)


def main() -> int:
    """Kill, resume, compare, count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('command', choices=(*FILES, 'node'))
    parser.add_argument('--kills', type=int, default=100)
    parser.add_argument('--seed', type=int, default=1, help='of the moments')
    parser.add_argument('--minutes', type=float, default=1e9, help='end after this time')
    parser.add_argument('--words', default='', help='further words of the command')
    args = parser.parse_args()
    os.environ.update(dict.fromkeys(ONE_THREAD, '1'))
    # before the first process: all are forked from one, and have its environment
    os.environ.setdefault('ROS_DOMAIN_ID', str(os.getpid() % 90 + 10))
    FORKED.set_forkserver_preload(LOADED)
    generator, more = random.Random(args.seed), args.words.split()
    end = time.monotonic() + 60.0 * args.minutes
    with tempfile.TemporaryDirectory() as folder:
        if args.command == 'node':
            return bool(kill_the_node(Path(folder), args.kills, generator, end))
        old, new, out = (Path(folder, x) for x in ('old', 'new', 'out'))
        said = Path(folder, 'said')
        seconds(command('simulate', old, 1, LOG), said)
        seconds(command(args.command, old, 2, more), said)
        whole = seconds(command(args.command, new, 1, more), said)
        trial = Trial(args.command, out, old, new)
        words, kills, ended = command(args.command, out, 1, [*more, '--resume']), 0, 0
        while kills < args.kills and time.monotonic() < end:
            shutil.rmtree(out, ignore_errors=True)
            shutil.copytree(old, out)
            kills += trial.run(words, whole, generator)
            ended += 1
        print(f'{args.command}: {whole:.2f} s; {kills} kills, {ended} runs ended')
        print(told_moments(trial.found))
        print(f'{len(trial.wrong)} wrong')
        for sentence in trial.wrong[:20]:
            print(f'  {sentence}')
    return bool(trial.wrong)


if __name__ == '__main__':
    sys.exit(main())
