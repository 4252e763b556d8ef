# SPDX-License-Identifier: Apache-2.0
"""Kill a command or the node at random moments, go on, and look at what comes of it.

The directory holds the results of an earlier run with another seed. A run is killed (SIGKILL, with
all its threads) and started again until it ends by itself; then another begins, until there were
as many kills as asked for. After each kill every file has to be whole and of one run, old or new;
at the end the result has to be the uninterrupted one's to the bit, and nothing else may be left.
The node gets the same goal again after each kill.

Example: python benchmarks/kills.py identify --kills 100
"""

import argparse
from collections import Counter
from collections.abc import Sequence
import json
import os
from pathlib import Path
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any

import numpy as np
import yaml

from ros2_ident.recording import read_bag
from ros2_ident.threads import ONE_THREAD

ROOT = Path(__file__).parents[1]
MACHINE = ROOT / 'config' / 'emps.yaml'
# So that a diagnosis has rounds of fits to be killed in.
LOG = ['--motion', 'reversals', '--seconds', '8', '--seed', '3']
LOG += ['--effect', 'stribeck@emps_axis:torque=12,speed=0.02']
# What of a result says when and where it was made, not what was found.
OCCASION = ('seconds', 'created', 'host', 'settings', 'provenance')
FILES = {
    'identify': ('result.json', 'result.yaml', 'history.npz', 'signals.npz'),
    'diagnose': ('diagnosis.json', 'diagnosis.npz'),
}


def command(name: str, out: Path, seed: int, more: Sequence[str] = ()) -> list[str]:
    """Return the words of a run on the bag beside its directory."""
    words = [sys.executable, '-m', 'ros2_ident.cli.main', name, str(out.with_name('bag'))]
    words += ['--machine', str(MACHINE)]
    if name == 'simulate':
        return [*words, *more]
    return [*words, '--seed', str(seed), '--out', str(out), '--quiet', *more]


def start(words: Sequence[str]) -> 'subprocess.Popen[bytes]':
    """Start a run in a session of its own."""
    environment = os.environ | dict.fromkeys(ONE_THREAD, '1')
    return subprocess.Popen(
        words,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )


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
    text = path.read_text()
    return told(yaml.safe_load(text) if path.suffix == '.yaml' else json.loads(text))


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


class Trial:
    """One run that is killed again and again.

    Args:
        name: The command.
        out: Its directory.
        old: Result files of the earlier run, which lie there.
        new: Result files of the run, uninterrupted.
    """

    def __init__(self, name: str, out: Path, old: Path, new: Path) -> None:
        self.name, self.out = name, out
        self.old, self.new = results(name, old), results(name, new)
        page = old / 'report.html'
        self.old_page = page.read_bytes() if page.exists() else b''
        self.old_bag = (old / 'overlay' / 'overlay.mcap').read_bytes()
        self.found: Counter[str] = Counter()
        self.wrong: list[str] = []
        self.until, self.working = 3.0, 2.0  # s, before the work and of it

    def kills(self, process: 'subprocess.Popen[bytes]', generator: random.Random) -> bool:
        """Kill a run at a random moment; return whether it had not ended before.

        One in five moments lies anywhere before the run begins to work, the others within the
        time that it then takes, as far as the last run that ended took so long.
        """
        checkpoint = self.out / f'{self.name}.checkpoint'
        size = checkpoint.stat().st_size if checkpoint.exists() else 0
        early = generator.random() < 0.2
        begin = time.monotonic()
        limit = begin + generator.random() * self.until
        while process.poll() is None and not (early and time.monotonic() >= limit):
            if checkpoint.exists() and checkpoint.stat().st_size != size:
                self.until = time.monotonic() - begin
                break
            time.sleep(0.005)
        working = time.monotonic()
        limit = 0.0 if early else working + generator.random() * self.working
        while process.poll() is None and time.monotonic() < limit:
            time.sleep(0.005)
        if process.poll() is not None:
            self.working = max(0.1, time.monotonic() - working)
            return False
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        return True

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
        self.found['with a checkpoint'] += checkpoint.exists()
        self.found['with the new result'] += 'new' in of.values()

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
    """Starts the node, sends it a goal, and waits for the result.

    Args:
        bag: What to identify from.
        out: The node's output directory.
    """

    def __init__(self, bag: Path, out: Path) -> None:
        import rclpy
        from rclpy.action import ActionClient
        from ros2_ident_msgs.action import Identify

        os.environ.setdefault('ROS_DOMAIN_ID', str(os.getpid() % 90 + 10))
        rclpy.init()
        self.rclpy = rclpy
        self.node = rclpy.create_node('kills')
        self.connect = lambda name: ActionClient(self.node, Identify, f'/{name}/identify')
        self.starts = 0
        self.goal = Identify.Goal(
            bag_path=str(bag), data_source=Identify.Goal.DATA_SOURCE_BAG, refine=True
        )
        parameters = {'machine_file': MACHINE, 'output_directory': out}
        words = [sys.executable, '-m', 'ros2_ident.ros.identifier', '--ros-args']
        self.words = [*words, *(x for k, v in parameters.items() for x in ('-p', f'{k}:={v}'))]

    def attempt(self, seconds: float | None) -> bool:
        """Return whether the result came before the kill, which comes after so many seconds."""
        self.starts += 1
        name = f'identifier_{self.starts}'  # a killed one is on the air for a while
        process = start([*self.words, '-r', f'__node:={name}'])
        client = self.connect(name)
        end = time.monotonic() + (600.0 if seconds is None else seconds)
        sent, answer = None, None
        try:
            while time.monotonic() < end:
                self.rclpy.spin_once(self.node, timeout_sec=0.02)
                if sent is None and client.server_is_ready():
                    sent = client.send_goal_async(self.goal)
                if sent is not None and answer is None and sent.done():
                    answer = sent.result().get_result_async()
                if answer is not None and answer.done():
                    return True
            return False
        finally:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            client.destroy()


def kill_the_node(folder: Path, kills: int, generator: random.Random) -> int:
    """Kill the node in its goals; return how often something was wrong."""
    subprocess.run(command('simulate', folder / 'out', 1, LOG), capture_output=True, check=True)
    out, done, ended, wrong = folder / 'out', 0, 0, list[str]()
    client = Client(folder / 'bag', out)
    begin = time.monotonic()
    client.attempt(None)
    whole = time.monotonic() - begin
    (first,) = out.glob('*/result.json')
    reference = {x: content(first.with_name(x)) for x in ('result.json', 'history.npz')}
    kept = 0
    while done < kills or not ended:
        shutil.rmtree(out, ignore_errors=True)
        while not client.attempt(generator.uniform(0.0, 1.05) * whole if done < kills else None):
            done += 1
            kept += any(out.glob('unfinished/*'))
            for path in (x for x in out.glob('2*/*') if x.suffix in ('.json', '.yaml', '.npz')):
                content(path)  # fails where it is not whole
        ended += 1
        last = max(out.glob('*/result.json'))
        if {x: content(last.with_name(x)) for x in reference} != reference:
            wrong.append('another result than that of the uninterrupted run')
        if list(out.glob('unfinished/*')):
            wrong.append('a checkpoint is left')
    print(f'node: {whole:.1f} s; {done} kills, {kept} with a checkpoint, {ended} goals ended')
    print(f'{len(wrong)} wrong', *wrong[:20], sep='\n  ')
    return len(wrong)


def main() -> int:
    """Kill, resume, compare, count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('command', choices=(*FILES, 'node'))
    parser.add_argument('--kills', type=int, default=100)
    parser.add_argument('--seed', type=int, default=1, help='of the moments')
    parser.add_argument('--words', default='', help='further words of the command')
    args = parser.parse_args()
    generator, more = random.Random(args.seed), args.words.split()
    with tempfile.TemporaryDirectory() as folder:
        if args.command == 'node':
            return bool(kill_the_node(Path(folder), args.kills, generator))
        old, new, out = (Path(folder, x) for x in ('old', 'new', 'out'))
        subprocess.run(command('simulate', old, 1, LOG), capture_output=True, check=True)
        subprocess.run(command(args.command, old, 2, more), capture_output=True, check=False)
        begin = time.monotonic()
        subprocess.run(command(args.command, new, 1, more), capture_output=True, check=False)
        whole = time.monotonic() - begin
        trial = Trial(args.command, out, old, new)
        kills, runs, ended = 0, 0, 0
        while kills < args.kills or not ended:
            shutil.rmtree(out, ignore_errors=True)
            shutil.copytree(old, out)
            while True:
                runs += 1
                process = start(command(args.command, out, 1, [*more, '--resume']))
                if kills < args.kills and trial.kills(process, generator):
                    kills += 1
                    trial.look()
                    continue
                said = process.communicate()[1].decode()
                ended += 1
                if process.returncode not in (0, 1):
                    trial.wrong.append(f'exit code {process.returncode}: {said[-300:]}')
                trial.end()
                break
        print(f'{args.command}: {whole:.1f} s; {kills} kills, {runs} starts, {ended} runs ended')
        print(', '.join(f'{count} {what}' for what, count in sorted(trial.found.items())))
        print(f'{len(trial.wrong)} wrong')
        for sentence in trial.wrong[:20]:
            print(f'  {sentence}')
    return bool(trial.wrong)


if __name__ == '__main__':
    sys.exit(main())
