# SPDX-License-Identifier: Apache-2.0
"""Memory and time of identifying a tripod from a bag of an hour.

    python checks/benchmarks/long_bag.py [--minutes 60] [--seed 1]

Writes a bag of three drives, state, effort and command at 1 kHz, into a temporary folder: cycles
of 20 s with the bundled machine's reference simulation, fresh noise on each, and as many in which
the machine rests. Then `ident identify` runs on it as a program of its own; told are its largest
resident memory, its time, and how far its parameters are from the truth.
"""

import argparse
import json
from pathlib import Path
import resource
import subprocess
import sys
import tempfile
import time

from mcap.writer import CompressionType, Writer
import numpy as np
from rosbags.typesys import get_typestore, Stores

from checks.reference.tripod import simulate_tripod, TABLE_5
from ros2_ident.models import load_machine
from ros2_ident.recording import cdr
from ros2_ident.recording.cdr import JOINT_STATE
from ros2_ident.simulate.motions import draw_motion

ROOT = Path(__file__).resolve().parents[2]
MACHINE = ROOT / 'config/tripod.yaml'
TRUTH = {**TABLE_5, 'gear_stiffness': 2.3e4}
CYCLE, BACK, SETTLED = 20.0, 1.0, 0.5  # s; of a cycle, of its way back, of rest at its end
TOPICS = ('/joint_states', '/effort', '/joint_command')


def simulated_cycle(seed: int) -> dict[str, np.ndarray]:
    """Return one cycle at 1 kHz that ends where it began: signals (20000, 3)."""
    machine = load_machine(MACHINE)
    motion = draw_motion('mixed', machine, CYCLE - BACK - SETTLED, seed)
    dt = motion.cycle
    s = np.arange(round(BACK / dt)) / round(BACK / dt)
    blend = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    first, last = motion.position[:, :1], motion.position[:, -1:]
    rest = np.repeat(first, round(CYCLE / dt) - motion.position.shape[1] - s.size, axis=1)
    position = np.concatenate([motion.position, last + (first - last) * blend, rest], axis=1)
    velocity = np.gradient(position, dt, axis=1)
    log = simulate_tripod(machine, TRUTH, position, velocity)
    every = slice(None, None, round(1e-3 / dt))
    return {
        'position': log.position[:, every].T,
        'velocity': log.velocity[:, every].T,
        'effort': log.effort[:, every].T,
        'command': position[:, every].T,
    }


def write_bag(path: Path, minutes: float, seed: int) -> int:
    """Write the bag, of which no more than a cycle is in memory; return its messages."""
    rng = np.random.default_rng(seed)
    names = load_machine(MACHINE).drives
    cycles = [simulated_cycle(seed + k) for k in range(3)]
    resting = {key: np.repeat(x[-1:], len(x), axis=0) for key, x in cycles[0].items()}
    count = 0
    definition, _ = get_typestore(Stores.ROS2_JAZZY).generate_msgdef(JOINT_STATE)
    with path.open('wb') as file:
        writer = Writer(file, compression=CompressionType.NONE, enable_crcs=False)
        writer.start('ros2')
        schema = writer.register_schema(JOINT_STATE, 'ros2msg', definition.encode())
        channels = [writer.register_channel(topic, 'cdr', schema) for topic in TOPICS]
        for number in range(round(60.0 * minutes / CYCLE)):
            now = resting if number % 2 else cycles[number // 2 % 3]
            size = len(now['command'])
            stamp = 1_000_000_000 + 1_000_000 * (number * size + np.arange(size))
            noise = 0.01 * rng.standard_normal((size, 3))
            fields = (
                (now['position'], now['velocity'], None),
                (None, None, now['effort'] + noise),
                (now['command'], None, None),
            )
            count += len(TOPICS) * size
            encoded = [cdr.encode(stamp, names, values) for values in fields]
            for when, *messages in zip(stamp.tolist(), *encoded, strict=True):
                for channel, message in zip(channels, messages, strict=True):
                    writer.add_message(channel, when, message, when)
        writer.finish()
    return count


def main() -> None:
    """Write, identify, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--minutes', type=float, default=60.0)
    parser.add_argument('--seed', type=int, default=1)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bag, out = Path(folder, 'long.mcap'), Path(folder, 'out')
        count = write_bag(bag, args.minutes, args.seed)
        size = bag.stat().st_size / 2**20
        print(f'bag: {args.minutes:g} min, {count} messages, {size:.0f} MiB', flush=True)
        command = [sys.executable, '-m', 'ros2_ident.cli.main', 'identify', str(bag)]
        command += ['--machine', str(MACHINE), '--out', str(out), '--quiet', '--no-overlay']
        before = time.monotonic()
        subprocess.run(command, check=False)
        seconds = time.monotonic() - before
        peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**10
        result = json.loads((out / 'result.json').read_text())
    off = max(
        abs(entry['value'] / TRUTH[name.split('.')[-1]] - 1.0)
        for name, entry in result['parameters'].items()
    )
    print(f'identify: peak memory {peak:.0f} MiB, {seconds:.0f} s')
    print(f'farthest parameter from the truth: {100.0 * off:.2g} %')


if __name__ == '__main__':
    main()
