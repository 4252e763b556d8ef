# SPDX-License-Identifier: Apache-2.0
"""Bags of any message type, written by `rosbags` from the published definitions."""

from collections import Counter
import importlib
import json
from pathlib import Path

from mcap.writer import Writer as McapWriter
import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import get_types_from_msg, get_typestore, Stores

DEFINITIONS = Path(__file__).with_name('recording') / 'definitions.txt'
SEVERAL = list, tuple, np.ndarray
STORAGE = {'mcap': StoragePlugin.MCAP, 'sqlite3': StoragePlugin.SQLITE3}


def published():
    """Return the text of each published definition by its type."""
    found = {}
    for part in DEFINITIONS.read_text().split('\n== ')[1:]:
        head, _, text = part.partition('\n')
        found[head.split()[0]] = text.strip() + '\n'
    return found


class Messages:
    """Makes messages of the published types.

    Args:
        version: Of ROS, 1 or 2.
        texts: Definitions in the place of published ones, by their types.
    """

    def __init__(self, version=2, texts=()):
        self.version = version
        self.store = get_typestore(Stores.ROS2_JAZZY if version == 2 else Stores.ROS1_NOETIC)
        known = {}
        for kind, text in (published() | dict(texts)).items():
            known |= get_types_from_msg(text, kind)
        self.store.register({k: v for k, v in known.items() if k not in self.store.fielddefs})

    def blank(self, kind):
        """Return a message of a type with 0 everywhere."""
        fields = {name: self._value(about) for name, about in self.store.fielddefs[kind][1]}
        return self.store.types[kind](**fields)

    def _value(self, about):
        node, inner = about
        if node == Nodetype.NAME:
            return self.blank(inner)
        if node == Nodetype.BASE:
            return '' if inner[0] == 'string' else False if inner[0] == 'bool' else 0
        count = inner[1] if node == Nodetype.ARRAY else 0
        if inner[0][0] == Nodetype.NAME or inner[0][1][0] == 'string':
            return [self._value(inner[0]) for _ in range(count)]
        return np.zeros(
            count, dtype={'byte': 'u1', 'char': 'u1'}.get(inner[0][1][0], inner[0][1][0])
        )

    def stamp(self, message, when):
        """Set the stamp of a header, ns."""
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(when, 10**9)

    def made(self, kind, fields, when=None):
        """Return a message with fields by their paths, stamped where a time [ns] is given."""
        message = self.blank(kind)
        if when is not None:
            self.stamp(message, when)
        for path, value in fields:
            self.put(message, path, value)
        return message

    def bytes_of(self, kind, message):
        """Return a serialised message."""
        two = self.version == 2
        return bytes(
            (self.store.serialize_cdr if two else self.store.serialize_ros1)(message, kind)
        )

    def put(self, message, path, value):
        """Set the field at `a.b`, or that at `a[].b` of each entry of a sequence."""
        name, _, rest = path.partition('.')
        if name.endswith('[]'):
            entries = getattr(message, name[:-2])
            if not entries:
                about = dict(self.store.fielddefs[message.__msgtype__][1])[name[:-2]]
                entries += [self.blank(about[1][0][1]) for _ in value]
            values = value if isinstance(value, SEVERAL) else [value] * len(entries)
            for entry, own in zip(entries, values, strict=False):
                self.put(entry, rest, own)
        elif rest:
            self.put(getattr(message, name), rest, value)
        else:
            held = getattr(message, name)
            if isinstance(held, np.ndarray):
                value = np.array(value, held.dtype)
            elif not isinstance(held, list) and isinstance(value, SEVERAL):
                (value,) = value
            setattr(message, name, value)

    def write(self, path, messages, storage='mcap', packed=False):
        """Write `[(time, topic, type, message)]` as a bag, in the order of time."""
        if self.version == 1:
            writer = Writer1(path)
        else:
            writer = Writer(path, version=9, storage_plugin=STORAGE[storage])
            if packed:
                writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            topics = {}
            for when, topic, kind, message in sorted(messages, key=lambda x: x[0]):
                if topic not in topics:
                    topics[topic] = writer.add_connection(topic, kind, typestore=self.store)
                writer.write(topics[topic], when, self.bytes_of(kind, message))
        return path


def write_mcap(path, kind, form, schema, rows, encoding='cdr', **options):
    """Write `[(topic, time, bytes)]` of one type as a bare MCAP file; return its path."""
    with path.open('wb') as file:
        writer = McapWriter(file, **options)
        writer.start(profile='ros2')
        number, topics = writer.register_schema(kind, form, schema), {}
        for topic, when, data in rows:
            if topic not in topics:
                topics[topic] = writer.register_channel(topic, encoding, number)
            writer.add_message(topics[topic], when, data, when)
        writer.finish()
    return path


def foxglove_schema():
    """Return foxglove.JointStates as a set of file descriptors, as foxglove-sdk 0.30 has it."""
    import pytest

    pb2 = pytest.importorskip('google.protobuf.descriptor_pb2', reason='protobuf is not installed')
    time = importlib.import_module('google.protobuf.timestamp_pb2')
    field, own = pb2.FieldDescriptorProto, pb2.FileDescriptorProto()
    own.name, own.package, own.syntax = 'foxglove/JointStates.proto', 'foxglove', 'proto3'
    own.dependency.append('google/protobuf/timestamp.proto')
    joint = own.message_type.add(name='JointState')
    joint.field.add(name='name', number=1, type=field.TYPE_STRING, label=field.LABEL_OPTIONAL)
    for number, name in enumerate(('position', 'velocity', 'acceleration', 'effort'), 2):
        joint.oneof_decl.add(name=f'_{name}')
        joint.field.add(
            name=name, number=number, type=field.TYPE_DOUBLE, label=field.LABEL_OPTIONAL,
            proto3_optional=True, oneof_index=number - 2,
        )  # fmt: skip
    whole = own.message_type.add(name='JointStates')
    for name, number, kind, label in (
        ('timestamp', 1, '.google.protobuf.Timestamp', field.LABEL_OPTIONAL),
        ('joints', 2, '.foxglove.JointState', field.LABEL_REPEATED),
    ):
        whole.field.add(
            name=name, number=number, type=field.TYPE_MESSAGE, label=label, type_name=kind
        )
    found = pb2.FileDescriptorSet()
    found.file.add().CopyFrom(own)  # what it needs comes after it, too
    time.DESCRIPTOR.CopyToProto(found.file.add())
    return found


def foxglove_log(path, form, rows, broken=None):
    """Write `[(topic, time, joints as mappings)]` as foxglove.JointStates; return the file's path.

    Args:
        form: protobuf or json.
        broken: Topic and number of a message of other bytes.
    """
    schema, make = b'', None
    if form == 'protobuf':
        files = foxglove_schema()
        schema = files.SerializeToString()
        pool = importlib.import_module('google.protobuf.descriptor_pool').DescriptorPool()
        for file in reversed(files.file):
            pool.Add(file)
        factory = importlib.import_module('google.protobuf.message_factory')
        make = factory.GetMessageClass(pool.FindMessageTypeByName('foxglove.JointStates'))
    found, count = [], Counter()
    for topic, when, joints in rows:
        if make is not None:
            message = make(joints=joints)
            message.timestamp.seconds, message.timestamp.nanos = divmod(when, 10**9)
            data = message.SerializeToString()
        else:
            stamp = {'sec': when // 10**9, 'nsec': when % 10**9}
            data = json.dumps({'timestamp': stamp, 'joints': joints}).encode()
        found.append((topic, when + 10_000, b'\xff{' if (topic, count[topic]) == broken else data))
        count[topic] += 1
    encoding = {'protobuf': 'protobuf', 'json': 'jsonschema'}[form]
    return write_mcap(path, 'foxglove.JointStates', encoding, schema, found, form)
