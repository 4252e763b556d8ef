# SPDX-License-Identifier: Apache-2.0
"""Time and memory of reading a large log, beside rosbags.

    python checks/benchmarks/large_log.py [--minutes 60] [--rounds 3] [--before CHECKOUT]

Writes unitree_go/LowState at 500 Hz, 20 motors that move with noise, as rosbag2 does with zstd,
into a temporary folder. Told are the time for each message: of scanning the file and decoding the
motors, of `read_bag` as a whole, and of the first 20000 messages read and deserialised by rosbags;
and the largest resident memory of `read_bag` in a program of its own. With `--before`, that of
another checkout in turns with this one, too.
"""

import argparse
import os
from pathlib import Path
import subprocess
import sys
import tempfile

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer

sys.path.insert(0, str(Path(__file__).parents[2] / 'test'))

from message_makers import Messages  # noqa: E402

from checks.benchmarks.measure import interleaved, machine, ratio  # noqa: E402
from ros2_ident.recording import read_bag  # noqa: E402
from ros2_ident.recording.content import Content  # noqa: E402
from ros2_ident.recording.scan import scan  # noqa: E402

KIND, TOPIC, MOTORS, RATE, AT_ONCE = 'unitree_go/msg/LowState', '/lowstate', 20, 500, 10_000
BEGIN, DESERIALISED = 1_700_000_000_000_000_000, 20_000
READ = """
import resource, sys, time
from ros2_ident.recording import read_bag
before = time.process_time()
read_bag(sys.argv[1])
print(time.process_time() - before, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10)
"""


def write(path: Path, count: int) -> None:
    """Write a bag of so many messages, the same bytes but for its tick and the motors' values."""
    maker = Messages()
    fields = ('q', 'dq', 'tau_est')
    marks = {f: 1.37 + 100.0 * n + np.arange(MOTORS) for n, f in enumerate(fields)}
    tick = 12_345_678
    given = [
        (f'motor_state.{k}.{f}', float(x[k])) for f, x in marks.items() for k in range(MOTORS)
    ]
    one = maker.blank(KIND)
    for name, value in given:
        _, number, field = name.split('.')
        setattr(one.motor_state[int(number)], field, value)
    one.tick = tick
    data = maker.bytes_of(KIND, one)
    places = {
        field: [data.index(np.float32(x).tobytes()) for x in mark] for field, mark in marks.items()
    }
    rng = np.random.default_rng(0)
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        channel = writer.add_connection(TOPIC, KIND, typestore=maker.store)
        for begin in range(0, count, AT_ONCE):
            number = np.arange(begin, min(begin + AT_ONCE, count))
            phase = number[:, None] / RATE * np.linspace(1.0, 3.0, MOTORS)
            table = np.tile(np.frombuffer(data, np.uint8), (number.size, 1))
            for field, lag, noise in zip(fields, (0.0, 1.6, 2.1), (1e-4, 1e-3, 1e-2), strict=True):
                values = np.sin(phase + lag) + noise * rng.standard_normal(phase.shape)
                for place, column in zip(places[field], values.T, strict=True):
                    table[:, place : place + 4] = _bytes(column, '<f4')
            at = data.index(np.uint32(tick).tobytes())
            table[:, at : at + 4] = _bytes(1000 // RATE * number, '<u4')
            for when, row in zip((BEGIN + number * (10**9 // RATE)).tolist(), table, strict=True):
                writer.write(channel, when, row.tobytes())


def _bytes(column: np.ndarray, form: str) -> np.ndarray:
    return column.astype(form).view(np.uint8).reshape(-1, 4)


def decoded(file: Path) -> None:
    """Scan a file and decode what the motors measured."""
    content = Content({TOPIC: ('state',)})
    scan(file, content)
    for messages in content.messages.values():
        messages.finish()


def deserialised(path: Path, store: object) -> None:
    """Read and deserialise the first messages as objects, by rosbags."""
    with Reader(path) as reader:
        for _, (connection, _, data) in zip(range(DESERIALISED), reader.messages(), strict=False):
            store.deserialize_cdr(data, connection.msgtype)  # type: ignore[attr-defined]


def own_program(path: Path, checkout: Path) -> tuple[float, float]:
    """Return processor time, s, and largest memory, MiB, of `read_bag` of a checkout."""
    done = subprocess.run(
        [sys.executable, '-c', READ, str(path)],
        cwd=path,
        env={**os.environ, 'PYTHONPATH': f'{checkout}:{os.environ.get("PYTHONPATH", "")}'},
        capture_output=True,
        text=True,
        check=True,
    )
    seconds, memory = map(float, done.stdout.split())
    return seconds, memory


def main() -> None:
    """Write, read, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--minutes', type=float, default=60.0)
    parser.add_argument('--rounds', type=int, default=3)
    parser.add_argument('--before', type=Path)
    args = parser.parse_args()
    count = round(60 * RATE * args.minutes)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, 'low')
        write(path, count)
        (file,) = path.glob('*.mcap')
        size = file.stat().st_size / 2**20
        print(f'{machine()}\nlog: {count} messages, {size:.0f} MiB', flush=True)
        store = Messages().store
        jobs = {
            'scan and decode': lambda: decoded(file),
            'read_bag': lambda: read_bag(path),
            'rosbags': lambda: deserialised(path, store),
        }
        shares = dict.fromkeys(jobs, count) | {'rosbags': min(count, DESERIALISED)}
        times = interleaved(jobs, args.rounds, shares=shares)
        for name, time in times.items():
            print(f'{name}: {1e6 * time.median:.2f} us a message (least {1e6 * time.least:.2f})')
        for name in ('scan and decode', 'read_bag'):
            print(f'rosbags over {name}: {ratio(times["rosbags"], times[name])} times as long')
        here = Path(__file__).resolve().parents[2]
        for checkout in [here] + ([args.before, here, args.before] if args.before else []):
            seconds, memory = own_program(path, checkout.resolve())
            name = 'this' if checkout == here else 'before'
            print(f'read_bag of {name}, alone: {seconds:.1f} s, {memory:.0f} MiB', flush=True)


if __name__ == '__main__':
    main()
