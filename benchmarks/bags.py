"""Small valid bags of every kind, and valid bags with damaged messages, for fuzzing.

A plain bag lets a fuzzer damage messages while checksums, lengths and indexes of the file stay valid. It is a sequence
of records separated by a mark: first a byte that selects the compression, then one record per topic (its number with
the highest bit set; name, type and definition, separated by zeros) and one per message (number of the topic, stamp of
8 bytes, content).
"""

from __future__ import annotations

import bz2
import io
import sqlite3
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

_SCAN, _ODOMETRY, _TF = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"
_STAMPED, _PATH = "geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Path"
_MARK = b"\xfe|~\xfe"
_TABLES = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL,
  offered_qos_profiles TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
  encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
  data BLOB NOT NULL);
INSERT INTO schema VALUES (4, 'humble');
"""


class _Messages:
    """A few messages of each type that a log reader uses."""

    def __init__(self, one: bool) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self._one = one
        self.store = get_typestore(Stores.ROS1_NOETIC if one else Stores.ROS2_HUMBLE)
        if one:  # the typestore lacks tf2
            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", _TF))

    def _make(self, name: str, *values: Any) -> Any:
        return self.store.types[name](*values)

    def _header(self, stamp_ns: int, frame: str) -> Any:
        time = self._make("builtin_interfaces/msg/Time", *divmod(stamp_ns, 10**9))
        return self._make("std_msgs/msg/Header", *((0,) if self._one else ()), time, frame)

    def __iter__(self) -> Iterator[tuple[str, str, int, bytes]]:
        """Topic, type, stamp in ns, and content."""
        put = self.store.serialize_ros1 if self._one else self.store.serialize_cdr
        turn = self._make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.1, 0.9)
        zero = self._make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        link = self._make("geometry_msgs/msg/Transform", zero, turn)
        link = self._make("geometry_msgs/msg/TransformStamped", self._header(0, "base"), "laser", link)
        yield "/tf_static", _TF, 0, bytes(put(self._make(_TF, [link]), _TF))
        twist = self._make("geometry_msgs/msg/Twist", zero, zero)
        twist = self._make("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36))
        for k in range(3):
            stamp = 10**9 + k * 10**8
            pose = self._make("geometry_msgs/msg/Pose", self._make("geometry_msgs/msg/Point", 0.1 * k, 0.0, 0.0), turn)
            spread = self._make("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36))
            odometry = self._make(_ODOMETRY, self._header(stamp, "odom"), "base", spread, twist)
            yield "/odom", _ODOMETRY, stamp, bytes(put(odometry, _ODOMETRY))
            there = self._make(_STAMPED, self._header(stamp, "map"), pose)
            yield "/truth", _STAMPED, stamp, bytes(put(there, _STAMPED))
            ranges = np.array([1.0, 2.0, np.inf, 3.0], np.float32)
            numbers = (-0.75, 0.75, 0.5, 0.0, 0.1, 0.1, 8.0)
            scan = self._make(_SCAN, self._header(stamp, "laser"), *numbers, ranges, ranges[:0])
            yield "/scan", _SCAN, stamp, bytes(put(scan, _SCAN))
            path = self._make(_PATH, self._header(stamp, "map"), [there, there])
            yield "/plan", _PATH, stamp, bytes(put(path, _PATH))


@cache
def _definition(one: bool, name: str) -> tuple[str, str]:
    """The definition of a type and its digest; empty for an unknown type."""
    try:
        definition, digest = _Messages(one).store.generate_msgdef(name, ros_version=1 if one else 2)
        return definition, digest
    except Exception:
        return "", ""


@dataclass(frozen=True)
class Topic:
    """A topic of a plain bag."""

    number: int
    name: str
    kind: str
    definition: str
    digest: str


def _plain(one: bool, has_definitions: bool) -> bytes:
    """The messages as a plain bag, with the definitions of their types if `has_definitions`."""
    topics: dict[str, int] = {}
    records, messages = [], []
    for name, kind, stamp_ns, content in _Messages(one):
        if name not in topics:
            topics[name] = len(topics)
            definition = _definition(one, kind)[0] if has_definitions else ""
            records.append(bytes([128 + topics[name]]) + f"{name}\0{kind}\0{definition}".encode())
        messages.append(struct.pack("<BQ", topics[name], stamp_ns) + content)
    return b"~" + _MARK.join([bytes([has_definitions]), *records, *messages])


def _parsed(data: bytes, one: bool) -> tuple[int, list[Topic], list[tuple[int, int, bytes]]]:
    """Compression, topics and messages (number of the topic, stamp, content) of a plain bag, also of a damaged one."""
    first, *records = data.split(_MARK)
    topics, messages = [], []
    for record in records:
        number = record[:1]
        if number >= b"\x80":
            words = record[1:].decode("utf-8", "replace").split("\0", 2) + [""] * 3
            definition = (words[2], "") if words[2] else _definition(one, words[1])
            topics.append(Topic(number[0] - 128, words[0], words[1], *definition))
        elif number:
            messages.append((number[0], int.from_bytes(record[1:9], "little") % 2**63, record[9:]))
    return sum(first) % 3, topics, messages


def mcap(data: bytes) -> bytes:
    """An MCAP file from a plain bag: uncompressed, lz4 or zstd."""
    from mcap.writer import CompressionType, Writer

    compression, topics, messages = _parsed(data, False)
    stream = io.BytesIO()
    kinds = (CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD)
    writer = Writer(stream, compression=kinds[compression])
    writer.start(profile="ros2")
    channels = {}
    for topic in topics:
        schema = writer.register_schema(topic.kind, "ros2msg", topic.definition.encode())
        channels[topic.number] = writer.register_channel(topic.name, "cdr", schema)
    for number, stamp_ns, content in messages:
        if number in channels:
            writer.add_message(channels[number], stamp_ns, content, stamp_ns)
    writer.finish()
    return stream.getvalue()


def database(data: bytes) -> bytes:
    """A ROS 2 SQLite database from a plain bag."""
    _, topics, messages = _parsed(data, False)
    with sqlite3.connect(":memory:") as store:
        store.executescript(_TABLES)
        for topic in topics:
            row = (topic.number, topic.name, topic.kind, "cdr", "", "")
            store.execute("INSERT OR REPLACE INTO topics VALUES (?, ?, ?, ?, ?, ?)", row)
            row = (topic.number, topic.kind, "ros2msg", topic.definition, "")
            store.execute("INSERT OR REPLACE INTO message_definitions VALUES (?, ?, ?, ?, ?)", row)
        store.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", messages)
        store.commit()
        return store.serialize()


def _one_record(data: bytes, **fields: bytes) -> bytes:
    """A ROS 1 record: header fields and data, each with its length first."""
    return _counted(b"".join(_counted(name.encode() + b"=" + value) for name, value in fields.items())) + _counted(data)


def _counted(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data


def bag_of_one(data: bytes) -> bytes:
    """A ROS 1 bag from a plain bag: uncompressed, bz2 or lz4 (wiki.ros.org/Bags/Format/2.0)."""
    from lz4.frame import compress

    compression, topics, messages = _parsed(data, True)
    known = {topic.number for topic in topics}
    connections, chunk, index = b"", b"", dict[int, list[bytes]]()
    for topic in topics:
        fields = {
            "topic": topic.name, "type": topic.kind.replace("/msg/", "/"), "md5sum": topic.digest,
            "message_definition": topic.definition,
        }  # fmt: skip
        header = b"".join(_counted(f"{name}={value}".encode()) for name, value in fields.items())
        conn = struct.pack("<I", topic.number)
        connections += _one_record(header, op=b"\x07", conn=conn, topic=topic.name.encode())
    for number, stamp_ns, content in messages:
        if number in known:
            time = struct.pack("<II", stamp_ns // 10**9 % 2**32, stamp_ns % 10**9)
            index.setdefault(number, []).append(time + struct.pack("<I", len(chunk)))
            chunk += _one_record(content, op=b"\x02", conn=struct.pack("<I", number), time=time)
    kind, by = ((b"none", bytes), (b"bz2", bz2.compress), (b"lz4", compress))[compression]
    out = _one_record(by(chunk), op=b"\x05", compression=kind, size=struct.pack("<I", len(chunk)))
    for number, entries in index.items():
        counts = {"conn": struct.pack("<I", number), "count": struct.pack("<I", len(entries))}
        out += _one_record(b"".join(entries), op=b"\x04", ver=struct.pack("<I", 1), **counts)

    def head(index_pos: int) -> bytes:
        counts = {"conn_count": struct.pack("<I", len(topics)), "chunk_count": struct.pack("<I", 1)}
        return b"#ROSBAG V2.0\n" + _one_record(b"", op=b"\x03", index_pos=struct.pack("<Q", index_pos), **counts)

    start = len(head(0))
    times = dict.fromkeys(("start_time", "end_time"), bytes(8))
    places = {"chunk_pos": struct.pack("<Q", start), "count": struct.pack("<I", len(index))}
    counts = b"".join(struct.pack("<II", number, len(entries)) for number, entries in index.items())
    info = _one_record(counts, op=b"\x06", ver=struct.pack("<I", 1), **times, **places)
    return head(start + len(out)) + out + connections + info


def foreign(kind: str) -> Callable[[Path], list[bytes]]:
    """Seeds of a kind of bag: one written by rosbags, and two plain ones."""

    def seeds(folder: Path) -> list[bytes]:
        from rosbags.rosbag1 import Writer as Writer1
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer as Writer2

        one = kind == "bag"
        messages = _Messages(one)
        path = folder / f"valid-{kind}"
        plugin = StoragePlugin.SQLITE3 if kind == "db3" else StoragePlugin.MCAP
        with Writer1(path) if one else Writer2(path, version=8, storage_plugin=plugin) as writer:
            topics: dict[str, Any] = {}
            for topic, name, stamp_ns, data in messages:
                if topic not in topics:
                    topics[topic] = writer.add_connection(topic, name, typestore=messages.store)
                writer.write(topics[topic], stamp_ns, data)
        whole = (path if one else next(path.glob(f"*.{kind}"))).read_bytes()
        return [whole, _plain(one, True), _plain(one, False)]

    return seeds


def of_a_run(folder: Path) -> list[bytes]:
    """The bag of a run, and the plain bag it is made from."""
    return [mcap(_plain(False, False)[1:]), _plain(False, False)]


def compile_once() -> None:
    """Make rosbags cache the code that it compiles for a bag's types, which takes most of the reading time."""
    from rosbags.highlevel import anyreader
    from rosbags.serde import utils
    from rosbags.typesys import store

    if "exec" not in vars(utils):
        compiled = lru_cache(2000)(lambda text: compile(text, "types of a bag", "exec"))
        vars(utils)["exec"] = vars(store)["exec"] = lambda text, scope: exec(compiled(text), scope)
        anyreader.get_types_from_msg = lru_cache(500)(anyreader.get_types_from_msg)
