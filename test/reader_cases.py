# SPDX-License-Identifier: Apache-2.0
"""Small logs of every kind, ways to damage them, and what may come of reading a damaged one."""

from collections.abc import Callable, Sequence
import contextlib
from dataclasses import dataclass
import importlib
import json
from pathlib import Path
import random
import struct
import zlib

import lz4.frame
from message_makers import Messages, write_mcap
import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
import scipy.io
import zstandard

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import (
    check,
    read_bag,
    Recording,
    RecordingBuilder,
    Stream,
    write_bag,
)
from ros2_ident.recording.cdr import encode
from ros2_ident.recording.streams import FIELDS

MS = 1_000_000
START = 1_700_000_000_000_000_000
JOINT_STATE = 'sensor_msgs/msg/JointState'
TOPICS = ('/joint_states', '/effort', '/joint_command')
MAGIC = b'\x89MCAP0\r\n'
STORE = get_typestore(Stores.ROS2_JAZZY)


def make_recording(size=120, seed=0):
    """Return state, effort and command of two drives at 1 kHz: smooth motion, a little noise."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(size) * 1e-3
    turn = 2.0 * np.pi * np.array([3.0, 5.0])
    position = 0.1 * np.sin(time_s[:, None] * turn)
    velocity = 0.1 * turn * np.cos(time_s[:, None] * turn)
    effort = velocity + rng.normal(size=(size, 2)) * 0.05
    stamp = START + np.arange(size) * MS
    names = ('drive_1', 'drive_2')
    noise = rng.normal(size=(size, 2)) * 1e-5
    return Recording(
        state=Stream(names, stamp, position + noise, velocity),
        effort=Stream(names, stamp, effort=effort),
        command=Stream(names, stamp, position),
    )


def add(
    builder: RecordingBuilder,
    role: str,
    stamp: int,
    names: Sequence[str],
    position: Sequence[float] | np.ndarray = (),
    velocity: Sequence[float] | np.ndarray = (),
    effort: Sequence[float] | np.ndarray = (),
) -> None:
    """Append one message; what is empty was not measured."""
    values = (np.array(x)[None] if len(x) else None for x in (position, velocity, effort))
    builder.add_block(role, np.array([stamp]), names, *values)


def raw_messages(recording):
    """Return topic, time and CDR bytes of every message, in the order of time."""
    found = []
    for topic, stream in zip(
        TOPICS, (recording.state, recording.effort, recording.command), strict=True
    ):
        data = encode(stream.stamp, stream.names, [stream.values(x) for x in FIELDS])
        found += [(int(t), topic, x) for t, x in zip(stream.stamp, data, strict=True)]
    return sorted(found, key=lambda x: x[0])


def record(opcode, content):
    return struct.pack('<BQ', opcode, len(content)) + content


def text(value):
    raw = value if isinstance(value, bytes) else value.encode()
    return struct.pack('<I', len(raw)) + raw


def message_record(channel, when, data):
    return record(5, struct.pack('<HIQQ', channel, 0, when, when) + data)


def definitions(kind=JOINT_STATE, topics=TOPICS):
    out = record(3, struct.pack('<H', 1) + text(kind) + text('ros2msg') + text(''))
    for k, topic in enumerate(topics):
        channel = struct.pack('<HH', k, 1) + text(topic) + text('cdr') + struct.pack('<I', 0)
        out += record(4, channel)
    return out


def pack(method, raw):
    if method == 'zstd':
        return zstandard.ZstdCompressor().compress(raw)
    return lz4.frame.compress(raw) if method == 'lz4' else raw


def chunk_record(raw, method='', crc=True, size=None):
    packed = pack(method, raw)
    head = struct.pack('<QQQI', 0, 0, size or len(raw), zlib.crc32(raw) if crc else 0)
    return record(6, head + text(method) + struct.pack('<Q', len(packed)) + packed)


def mcap_bytes(recording, method='', chunk=60, crc=True, early=True):
    """Return an MCAP file; `chunk` messages per chunk (0: none), `crc`: with all checksums.

    Where not `early`, topics are described in the summary only.
    """
    out = MAGIC + record(1, text('ros2') + text(''))
    out += definitions() if early else b''
    messages = [message_record(TOPICS.index(t), w, d) for w, t, d in raw_messages(recording)]
    if chunk:
        for at in range(0, len(messages), chunk):
            out += chunk_record(b''.join(messages[at : at + chunk]), method, crc)
    else:
        out += b''.join(messages)
    out += record(15, struct.pack('<I', zlib.crc32(out) if crc else 0))
    start = len(out)
    summary = definitions()
    counts = [sum(t == topic for _, t, _ in raw_messages(recording)) for topic in TOPICS]
    table = b''.join(struct.pack('<HQ', k, n) for k, n in enumerate(counts))
    sizes = struct.pack('<QHIIIIQQ', sum(counts), 1, 3, 0, 0, 0, 0, 0)
    summary += record(11, sizes + struct.pack('<I', len(table)) + table)
    footer = struct.pack('<BQQQ', 2, 20, start, 0)
    out += summary + footer
    return out + struct.pack('<I', zlib.crc32(summary + footer) if crc else 0) + MAGIC


def ros_1_file(path, recording, compression=None, chunk=1 << 13):
    store = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    stamp_type = types['builtin_interfaces/msg/Time']
    writer = Writer1(path)
    writer.chunk_threshold = chunk
    if compression:
        writer.set_compression(Writer1.CompressionFormat[compression])
    with writer:
        streams = (recording.state, recording.effort, recording.command)
        for topic, stream in zip(TOPICS, streams, strict=True):
            connection = writer.add_connection(topic, JOINT_STATE, typestore=store)
            for k, stamp in enumerate(stream.stamp.tolist()):
                header = types['std_msgs/msg/Header'](k, stamp_type(*divmod(stamp, 10**9)), '')
                fields = [stream.values(x) for x in FIELDS]
                arrays = [np.empty(0) if x is None else x[k] for x in fields]
                data = types[JOINT_STATE](header, list(stream.names), *arrays)
                writer.write(connection, stamp, store.serialize_ros1(data, JOINT_STATE))


def table_text(recording):
    lines = ['time,q1,q2,tau1,tau2,ref1,ref2']
    for k, stamp in enumerate(recording.state.stamp.tolist()):
        row = [f'{stamp // 10**9}.{stamp % 10**9:09d}']
        for values in (recording.state.position, recording.effort.effort):
            row += [repr(float(x)) for x in values[k]]
        row += [repr(float(x)) for x in recording.command.position[k]]
        lines.append(','.join(row))
    return '\n'.join(lines) + '\n'


COLUMNS = """time: {column: time, unit: s}
joints:
  drive_1: {position: q1, effort: tau1, command_position: ref1}
  drive_2: {position: q2, effort: {column: tau2, scale: 2.0}, command_position: 7}
"""


@dataclass(frozen=True)
class Kind:
    """A kind of log: the file that is damaged, and those beside it."""

    name: str
    data: bytes
    beside: tuple[tuple[str, bytes], ...] = ()

    def write(self, folder: Path, data: bytes) -> Path:
        """Write damaged bytes into a folder; return the path to read."""
        for name, content in self.beside:
            (folder / name).write_bytes(content)
        path = folder / self.name
        path.write_bytes(data)
        if self.name == 'metadata.yaml':
            return folder
        if self.name.endswith('.yaml'):
            return folder / self.beside[0][0]
        return folder if any(x == 'metadata.yaml' for x, _ in self.beside) else path


def rosbags_bag(path, recording, storage=StoragePlugin.SQLITE3, mode=None):
    """Write a recording as a bag by `rosbags` and return the path."""
    writer = Writer(path, version=9, storage_plugin=storage)
    if mode is not None:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {x: writer.add_connection(x, JOINT_STATE, typestore=STORE) for x in TOPICS}
        for when, topic, data in raw_messages(recording):
            writer.write(connections[topic], when, data)
    return path


def kinds(room: Path, size: int = 120) -> dict[str, Kind]:
    """Return the logs that are damaged, by name; `size` samples a stream."""
    recording = make_recording(size)
    found = {}
    bags = {
        'mcap': write_bag(room / 'own_mcap', recording),
        'db3': rosbags_bag(room / 'own_sqlite3', recording),
    }
    for kind, bag in bags.items():
        file, notes = bag / f'{bag.name}.{kind}', (bag / 'metadata.yaml').read_bytes()
        found[kind] = Kind(file.name, file.read_bytes(), (('metadata.yaml', notes),))
        found[f'{kind}_bare'] = Kind(file.name, file.read_bytes())
        if kind == 'mcap':
            beside = ((file.name, file.read_bytes()),)
            found['metadata'] = Kind('metadata.yaml', notes, beside)
    found['mcap_plain'] = Kind('a.mcap', mcap_bytes(recording))
    found['mcap_lz4'] = Kind('a.mcap', mcap_bytes(recording, 'lz4'))
    found['mcap_late'] = Kind('a.mcap', mcap_bytes(recording, 'zstd', early=False))
    found['mcap_no_crc'] = Kind('a.mcap', mcap_bytes(recording, crc=False))
    found['mcap_zstd_no_crc'] = Kind('a.mcap', mcap_bytes(recording, 'zstd', crc=False))
    found['mcap_loose'] = Kind('a.mcap', mcap_bytes(recording, chunk=0, crc=False))
    for compression in (None, 'BZ2', 'LZ4'):
        path = room / f'ros_1_{compression}.bag'
        ros_1_file(path, recording, compression)
        found[f'bag_{compression}'.lower()] = Kind('a.bag', path.read_bytes())
    for name, storage, mode in (
        ('mcap_file_zstd', StoragePlugin.MCAP, CompressionMode.FILE),
        ('db3_message_zstd', StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    ):
        bag = rosbags_bag(room / name, recording, storage, mode)
        (file,) = (x for x in bag.iterdir() if x.name != 'metadata.yaml')
        found[name] = Kind(file.name, file.read_bytes())
    table = table_text(recording).encode()
    found['table'] = Kind('a.csv', table, (('a.columns.yaml', COLUMNS.encode()),))
    found['columns'] = Kind('a.columns.yaml', COLUMNS.encode(), (('a.csv', table),))
    return found | messages(room, recording) | arrays(room, recording)


def messages(room: Path, recording: Recording) -> dict[str, Kind]:
    """Return bags of messages with their definitions, without a checksum, by name."""
    position, effort = recording.state.position, recording.effort.effort
    maker = Messages()
    files = {}
    for name, topic, kind, fields in (
        ('lowstate', '/lowstate', 'unitree_go/msg/LowState',
         {'motor_state[].q': position, 'motor_state[].tau_est': effort}),
        ('pid_state', '/pid/state', 'control_msgs/msg/MultiDOFStateStamped',
         {'dof_states[].name': ['ab'] * len(position), 'dof_states[].feedback': position}),
    ):  # fmt: skip
        rows = []
        for k, when in enumerate(recording.state.stamp.tolist()):
            own = [(path, [*values[k]]) for path, values in fields.items()]
            own, stamp = ([*own, ('tick', 5 + k)], None) if name == 'lowstate' else (own, when)
            rows.append((topic, when, maker.bytes_of(kind, maker.made(kind, own, stamp))))
        definition, _ = maker.store.generate_msgdef(kind)
        files[name] = (kind, 'ros2msg', definition.encode(), rows)
    rows = []
    for k, when in enumerate(recording.state.stamp.tolist()):
        stamp = {'sec': when // 10**9, 'nsec': when % 10**9}
        joints = [{'name': 'ab'[d], 'position': position[k, d]} for d in (0, 1)]
        data = json.dumps({'timestamp': stamp, 'joints': joints}).encode()
        rows.append(('/joint_states', when, data))
    files['json'] = ('foxglove.JointStates', 'jsonschema', b'{}', rows, 'json')
    found = {}
    for name, about in files.items():
        path = room / f'{name}.mcap'
        write_mcap(path, *about, use_chunking=False, enable_crcs=False)
        found[name] = Kind('a.mcap', path.read_bytes())
    return found


ARRAYS = """time: {column: time, unit: ns}
joints:
  drive_1, drive_2: {position: 'q[0:2]', effort: 'tau[0:2]'}
"""


def arrays(room: Path, recording: Recording) -> dict[str, Kind]:
    """Return files of arrays, by the ending of their names."""
    values = {
        'time': recording.state.stamp - START,
        'q': recording.state.position,
        'tau': recording.effort.effort,
    }
    for name in ('a.npz', 'packed.npz'):
        (np.savez_compressed if name == 'packed.npz' else np.savez)(room / name, **values)
    scipy.io.savemat(room / 'a.mat', values)
    scipy.io.savemat(room / 'packed.mat', values, do_compression=True)
    rows = [{x: y[k].tolist() for x, y in values.items()} for k in range(len(values['time']))]
    (room / 'a.jsonl').write_text('\n'.join(map(json.dumps, rows)))
    names = ['a.npz', 'packed.npz', 'a.mat', 'packed.mat', 'a.jsonl']
    with contextlib.suppress(ModuleNotFoundError):
        h5py = importlib.import_module('h5py')
        for name, turned in (('a.hdf5', False), ('new.mat', True)):
            with h5py.File(room / name, 'w', userblock_size=512) as file:
                for key, x in values.items():
                    options = {} if turned or x.ndim == 1 else {'compression': 'gzip'}
                    file.create_dataset(key, data=x.T if turned else x, **options)
            names.append(name)
        with (room / 'new.mat').open('r+b') as stream:
            stream.write(b'MATLAB 7.3 MAT-file')
        parquet = importlib.import_module('pyarrow.parquet')
        pyarrow = importlib.import_module('pyarrow')
        table = {x: y if y.ndim == 1 else list(y) for x, y in values.items()}
        parquet.write_table(pyarrow.table(table), room / 'a.parquet')
        names.append('a.parquet')
    found = {}
    for name in names:
        stem, _, kind = name.partition('.')
        beside = ((f'{stem}.columns.yaml', ARRAYS.encode()),)
        found[name.replace('.', '_')] = Kind(name, (room / name).read_bytes(), beside)
    return found


# ---------------------------------------------------------------------- damage

NUMBERS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, (1 << 63) - 1)


def _flip(data, rng):
    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)


def _put(data, rng):
    data[rng.randrange(len(data))] = rng.randrange(256)


def _delete(data, rng):
    at = rng.randrange(len(data))
    del data[at : at + rng.choice((1, 1, 1, 2, 7, 64, 4096))]


def _insert(data, rng):
    at = rng.randrange(len(data))
    data[at:at] = rng.randbytes(rng.choice((1, 1, 2, 8, 300)))


def _cut(data, rng):
    del data[rng.randrange(len(data)) :]


def _number(data, rng):
    size = rng.choice((1, 2, 4, 8))
    at = rng.randrange(len(data))
    value = rng.choice(NUMBERS) & ((1 << 8 * size) - 1)
    data[at : at + size] = value.to_bytes(size, rng.choice(('little', 'big')))


def _zero(data, rng):
    at, size = rng.randrange(len(data)), rng.choice((4, 512, 4096))
    size = min(size, len(data) - at)
    data[at : at + size] = bytes(size)


def _repeat(data, rng):
    at, size = rng.randrange(len(data)), rng.choice((1, 30, 500, 5000))
    place = rng.randrange(len(data))
    data[place:place] = data[at : at + size]


DAMAGES: tuple[Callable, ...] = (_flip, _put, _delete, _insert, _cut, _number, _zero, _repeat)


def damage(data: bytes, rng: random.Random, times: int | None = None) -> bytes:
    """Return bytes damaged in one to four ways."""
    out = bytearray(data)
    for _ in range(times or rng.choice((1, 1, 1, 2, 4))):
        if out:
            rng.choice(DAMAGES)(out, rng)
    return bytes(out)


# ---------------------------------------------------------------------- outcomes


def outcome(path: Path, truth: list[Recording], judged: bool = True) -> str:
    """Read a log as `ident check` does, judge it where `judged`; return what came of it.

    Returns:
        `same`, `salvaged` (something else, with a warning), `refused` (one sentence with a code)
        or `silent` (something else without a word). Every other exception passes.
    """
    try:
        found = read_bag(path)
    except IdentError as error:
        assert '\n' not in error.message and error.message.isprintable(), repr(error.message)
        assert error.code != ErrorCode.INTERNAL
        return 'refused'
    if equal(found, truth):
        return 'same'
    for sentence in check(found).findings if judged else ():
        assert sentence.sentence.isprintable(), repr(sentence.sentence)
    return 'salvaged' if any(x.warnings for x in found) else 'silent'


def alike(one: Stream, two: Stream) -> bool:
    """Say whether streams hold the same values; NaN equals NaN."""
    mine, theirs = one.fields, two.fields
    return (
        one.names == two.names
        and mine.keys() == theirs.keys()
        and np.array_equal(one.stamp, two.stamp)
        and all(np.array_equal(x, theirs[k], equal_nan=True) for k, x in mine.items())
    )


def equal(one: Sequence[Recording], two: Sequence[Recording]) -> bool:
    """Say whether recordings hold the same streams."""
    pairs = [(x.streams, y.streams) for x, y in zip(one, two, strict=False)]
    return len(one) == len(two) and all(
        x.keys() == y.keys() and all(alike(x[role], y[role]) for role in x) for x, y in pairs
    )
