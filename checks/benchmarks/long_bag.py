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
import struct
import subprocess
import sys
import tempfile
import time
from typing import BinaryIO

import numpy as np
from rosbags.typesys import get_typestore, Stores

from checks.reference.tripod import simulate_tripod
from ros2_ident.models import load_machine
from ros2_ident.recording import cdr
from ros2_ident.recording.content import JOINT_STATE
from ros2_ident.simulate.motions import draw_motion

ROOT = Path(__file__).resolve().parents[2]
MACHINE = ROOT / 'config/tripod.yaml'
TRUTH = {
    'measurement_delay': 0.0249,
    'gear_stiffness': 2.3e4,
    'gear_damping_ratio': 0.4,
    'tool_mass': 1.76,
    'drive_inertia': 8.9e-5,
    'coulomb_torque': 0.05,
    'viscous_torque': 0.05,
}
CYCLE, BACK, SETTLED = 20.0, 1.0, 0.5  # s; of a cycle, of its way back, of rest at its end
TOPICS = ('/joint_states', '/effort', '/joint_command')
MAGIC = b'\x89MCAP0\r\n'


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


def record(opcode: int, content: bytes) -> bytes:
    """Return an MCAP record."""
    return struct.pack('<BQ', opcode, len(content)) + content


def text(value: str) -> bytes:
    """Return an MCAP string."""
    raw = value.encode()
    return struct.pack('<I', len(raw)) + raw


def write_bag(path: Path, minutes: float, seed: int) -> int:
    """Write the bag; return its messages. Messages of a chunk are rows of one table of bytes."""
    rng = np.random.default_rng(seed)
    names = load_machine(MACHINE).drives
    cycles = [simulated_cycle(seed + k) for k in range(3)]
    resting = {key: np.repeat(x[-1:], len(x), axis=0) for key, x in cycles[0].items()}
    definition, _ = get_typestore(Stores.ROS2_JAZZY).generate_msgdef(JOINT_STATE)
    schema = struct.pack('<H', 1) + text(JOINT_STATE) + text('ros2msg') + text(definition)
    channels = [
        struct.pack('<HH', k, 1) + text(topic) + text('cdr') + struct.pack('<I', 0)
        for k, topic in enumerate(TOPICS)
    ]
    chunks: list[bytes] = []
    counts = [0, 0, 0]
    with path.open('wb') as file:
        file.write(MAGIC + record(0x01, text('ros2') + text('')))
        file.write(record(0x03, schema) + b''.join(record(0x04, c) for c in channels))
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
            tables = []
            for channel, values in enumerate(fields):
                tables.append(_rows(channel, stamp, cdr.encode(stamp, names, values)))
                counts[channel] += size
            _chunks(file, tables, stamp, chunks)
        _summary(file, schema, channels, chunks, counts)
    return sum(counts)


def _rows(channel: int, stamp: np.ndarray, messages: list[bytes]) -> np.ndarray:
    """Return message records (T, bytes)."""
    data = np.frombuffer(b''.join(messages), dtype=np.uint8).reshape(len(messages), -1)
    head = np.zeros(
        len(messages),
        dtype=[
            ('op', 'u1'),
            ('size', '<u8'),
            ('channel', '<u2'),
            ('sequence', '<u4'),
            ('log', '<u8'),
            ('sent', '<u8'),
        ],
    )
    head['op'], head['size'], head['channel'] = 0x05, 22 + data.shape[1], channel
    head['log'] = head['sent'] = stamp
    return np.concatenate([head.view(np.uint8).reshape(len(messages), -1), data], axis=1)


def _chunks(
    file: BinaryIO, tables: list[np.ndarray], stamp: np.ndarray, chunks: list[bytes]
) -> None:
    """Write tables, a row of each in turn, in chunks of two seconds; note their index."""
    table = np.concatenate(tables, axis=1)
    begins = np.cumsum([0, *(x.shape[1] for x in tables)])
    for at in range(0, len(table), 2000):
        part, times = table[at : at + 2000], stamp[at : at + 2000]
        raw, first, last = part.tobytes(), int(times[0]), int(times[-1])
        head = struct.pack('<QQQI', first, last, len(raw), 0) + text('')
        content = record(0x06, head + struct.pack('<Q', len(raw)) + raw)
        start = file.tell()
        file.write(content)
        end, offsets = file.tell(), b''
        for channel in range(len(tables)):
            places = begins[channel] + table.shape[1] * np.arange(len(part))
            index = np.stack([times, places], axis=1).astype('<u8').tobytes()
            offsets += struct.pack('<HQ', channel, file.tell())
            file.write(record(0x07, struct.pack('<HI', channel, len(index)) + index))
        chunks.append(
            struct.pack('<QQQQI', first, last, start, len(content), len(offsets))
            + offsets
            + struct.pack('<Q', file.tell() - end)
            + text('')
            + struct.pack('<QQ', len(raw), len(raw))
        )


def _summary(
    file: BinaryIO, schema: bytes, channels: list[bytes], chunks: list[bytes], counts: list[int]
) -> None:
    """Write what stands at the end of the file: definitions, index of chunks, counts."""
    file.write(record(0x0F, struct.pack('<I', 0)))
    start = file.tell()
    file.write(record(0x03, schema) + b''.join(record(0x04, c) for c in channels))
    file.write(b''.join(record(0x08, c) for c in chunks))
    (begin,), (end,) = struct.unpack('<Q', chunks[0][:8]), struct.unpack('<Q', chunks[-1][8:16])
    sizes = (sum(counts), 1, len(channels), 0, 0, len(chunks), begin, end)
    table = b''.join(struct.pack('<HQ', k, n) for k, n in enumerate(counts))
    content = struct.pack('<QHIIIIQQ', *sizes) + struct.pack('<I', len(table)) + table
    file.write(record(0x0B, content) + record(0x02, struct.pack('<QQI', start, 0, 0)) + MAGIC)


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
