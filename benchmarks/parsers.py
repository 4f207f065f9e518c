"""Every parser, each with small valid files to be damaged."""

from __future__ import annotations

import bz2
import gzip
import io
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sixthsense.config import LaserConfig

LASER = LaserConfig(beams=4, fov=1.5)
_SCENE = b"""start = [1, 1.5, 0]
radius = 0.2
goal = [3, 1]
tour = [[3, 1], [1, 1]]
region = [0, 0, 4, 2]
walls = [[0, 0, 4, 0], [4, 0, 4, 2], [4, 2, 0, 2], [0, 2, 0, 0]]
[[polygons]]
closed = true
points = [[2.0, 0.5], [2.2, 0.5], [2.1, 0.7]]
"""
_SCN = b"1 1 0 0.2\n0 0 4 0\n4 0 4 2\n4 2 0 2\n0 2 0 0\n"
_MAP = b"""image: m.pgm
resolution: 0.1
origin: [-1.0, 2.0, 0.1]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
mode: trinary
"""
_CARMEN = b"".join(
    b"ODOM %d 0.5 0.1 0.1 0.2 0 %d nohost 0.5\nFLASER 4 1.0 2.0 3.0 81.8 0 0 0 %d 0.5 0.1 %d.25 nohost 0.5\n"
    % (k, k, k, k)
    for k in range(4)
)
_RELATIONS = b"# t1 t2 dx dy dz roll pitch yaw\n1.25 2.25 1 0 0 0 0 0\n1.25 3.25 2 0.1 0 0 0 -0.1\n"
_CONFIG = b"""preset = "report"
scene = "office"
seed = 3
goal = [1.0, 2.0]
max_time = 60.0
[laser]
beams = 90
fov = 6.2
mount = [0.1, 0.0, 0.2]
[features.lines]
ransac_threshold_m = 0.04
[follow]
shortcut = false
"""
_WORDS = b"apartment --seed 3 --laser.beams=90 --goal 1.0 2 --laser.mount 0 0 1e-3 --out x --overwrite --no-realtime"
_SCAN, _ODOMETRY, _TF = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"
_STAMPED = "geometry_msgs/msg/PoseStamped"


@dataclass(frozen=True)
class Parser:
    """A way from bytes into the program."""

    name: str
    seeds: Callable[[Path], list[bytes]]
    """valid inputs; may use a folder"""
    read: Callable[[Path, bytes], Any]
    """parses bytes, by a file in a folder where it reads files"""
    wrap: Callable[[bytes], bytes] | None = None
    """Inputs that begin with `~` are its argument: what lies below a compression or a checksum."""

    def form(self, data: bytes) -> bytes:
        """The bytes that the parser gets."""
        return self.wrap(data[1:]) if self.wrap is not None and data.startswith(b"~") else data


def _written(folder: Path, name: str, data: bytes) -> Path:
    (folder / name).write_bytes(data)
    return folder / name


def _scene(name: str) -> Callable[[Path, bytes], Any]:
    def read(folder: Path, data: bytes) -> Any:
        from sixthsense.scene import load_scene

        return load_scene(_written(folder, name, data))

    return read


def _map(folder: Path, data: bytes) -> Any:
    from sixthsense.scene import load_scene

    _written(folder, "m.pgm", _pgm())
    return load_scene(_written(folder, "m.yaml", data))


def _image(folder: Path, data: bytes) -> Any:
    from sixthsense.scene import load_scene

    _written(folder, "m.pgm", data)
    return load_scene(_written(folder, "m.yaml", _MAP))


def _pixels() -> np.ndarray:
    pixels = np.full((12, 16), 254, np.uint8)
    pixels[[0, -1]] = pixels[:, [0, -1]] = pixels[4:7, 5] = 0
    pixels[8, 3:6] = 205
    return pixels


def _pgm() -> bytes:
    return b"P5 16 12 255\n" + _pixels().tobytes()


def _plain_pgm() -> bytes:
    return b"P2 16 12 255\n" + b" ".join(b"%d" % v for v in _pixels().ravel())


def _png(inner: bytes) -> bytes:
    """A PNG whose checksums are right: `inner` is its header and its rows."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", inner[:13])
        + chunk(b"IDAT", zlib.compress(inner[13:]))
        + chunk(b"IEND", b"")
    )


def _png_seeds(folder: Path) -> list[bytes]:
    from PIL import Image

    rows = b"".join(b"\x00" + row.tobytes() for row in _pixels())
    inner = struct.pack(">IIBBBBB", 16, 12, 8, 0, 0, 0, 0) + rows
    coloured = io.BytesIO()
    Image.fromarray(_pixels()).convert("RGBA").save(coloured, "PNG")
    return [_png(inner), b"~" + inner, coloured.getvalue()]


def _log(name: str) -> Callable[[Path, bytes], Any]:
    def read(folder: Path, data: bytes) -> Any:
        from sixthsense.logs import open_log

        return open_log(_written(folder, name, data), LASER)

    return read


def _relations(folder: Path, data: bytes) -> Any:
    from sixthsense.logs.carmen import read_relations

    return read_relations(_written(folder, "some.relations", data))


def _config(folder: Path, data: bytes) -> Any:
    from sixthsense.config import load_config, save_config

    config = load_config(_written(folder, "c.toml", data))
    save_config(config, folder / "again.toml")
    assert load_config(folder / "again.toml") == config
    return config


def _words(folder: Path, data: bytes) -> Any:
    from sixthsense.cli.common import parse_command
    from sixthsense.cli.options import words
    from sixthsense.cli.run import Run

    # A shell hands over bytes as this does.
    args = [word.replace("\0", "") for word in data.decode("utf-8", "surrogateescape").split(" ")]
    if args[0] == "report":
        return words(args, {"out": Path, "overwrite": bool})
    return parse_command(Run, "scene", "default", args)


def _run_bag(folder: Path, data: bytes) -> Any:
    from sixthsense.logs.runfolder import read_run

    (folder / "bag").mkdir(exist_ok=True)
    _written(folder, "bag/bag_0.mcap", data)
    return read_run(folder, LASER)


class _Messages:
    """Messages of a robot that drives past nothing in particular."""

    def __init__(self, one: bool) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self._one = one
        self.store = get_typestore(Stores.ROS1_NOETIC if one else Stores.ROS2_HUMBLE)
        if one:  # it does not know tf2
            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", _TF))

    def _make(self, name: str, *values: Any) -> Any:
        return self.store.types[name](*values)

    def _header(self, stamp_ns: int, frame: str) -> Any:
        time = self._make("builtin_interfaces/msg/Time", *divmod(stamp_ns, 10**9))
        return self._make("std_msgs/msg/Header", *((0,) if self._one else ()), time, frame)

    def __iter__(self) -> Any:
        """Topic, type, stamp in ns, and bytes."""
        put = self.store.serialize_ros1 if self._one else self.store.serialize_cdr
        turn = self._make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.1, 0.9)
        zero = self._make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        link = self._make("geometry_msgs/msg/Transform", zero, turn)
        link = self._make("geometry_msgs/msg/TransformStamped", self._header(0, "base"), "laser", link)
        yield "/tf_static", _TF, 0, put(self._make(_TF, [link]), _TF)
        twist = self._make("geometry_msgs/msg/Twist", zero, zero)
        twist = self._make("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36))
        for k in range(3):
            stamp = 10**9 + k * 10**8
            pose = self._make("geometry_msgs/msg/Pose", self._make("geometry_msgs/msg/Point", 0.1 * k, 0.0, 0.0), turn)
            spread = self._make("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36))
            odometry = self._make(_ODOMETRY, self._header(stamp, "odom"), "base", spread, twist)
            yield "/odom", _ODOMETRY, stamp, put(odometry, _ODOMETRY)
            yield "/truth", _STAMPED, stamp, put(self._make(_STAMPED, self._header(stamp, "map"), pose), _STAMPED)
            ranges = np.array([1.0, 2.0, np.inf, 3.0], np.float32)
            numbers = (-0.75, 0.75, 0.5, 0.0, 0.1, 0.1, 8.0)
            scan = self._make(_SCAN, self._header(stamp, "laser"), *numbers, ranges, ranges[:0])
            yield "/scan", _SCAN, stamp, put(scan, _SCAN)


def _foreign(kind: str) -> Callable[[Path], list[bytes]]:
    def seeds(folder: Path) -> list[bytes]:
        from rosbags.rosbag1 import Writer as Writer1
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer as Writer2

        messages = _Messages(kind == "ros1")
        path = folder / f"valid-{kind}"
        plugin = StoragePlugin.SQLITE3 if kind == "db3" else StoragePlugin.MCAP
        with Writer1(path) if kind == "ros1" else Writer2(path, version=8, storage_plugin=plugin) as writer:
            topics: dict[str, Any] = {}
            for topic, name, stamp_ns, data in messages:
                if topic not in topics:
                    topics[topic] = writer.add_connection(topic, name, typestore=messages.store)
                writer.write(topics[topic], stamp_ns, data)
        return [(path if kind == "ros1" else next(path.glob(f"*.{kind}"))).read_bytes()]

    return seeds


def _run_bag_seeds(folder: Path) -> list[bytes]:
    """A run's bag with checksums, and one without, in which damage reaches the messages."""
    from mcap.writer import CompressionType, Writer

    out = []
    for checked in (True, False):
        stream = io.BytesIO()
        writer = Writer(stream, compression=CompressionType.NONE, enable_crcs=checked)
        writer.start()
        topics: dict[str, int] = {}
        for topic, name, stamp_ns, data in _Messages(False):
            if topic not in topics:
                topics[topic] = writer.register_channel(topic, "cdr", writer.register_schema(name, "ros2msg", b""))
            writer.add_message(topics[topic], stamp_ns, bytes(data), stamp_ns)
        writer.finish()
        out.append(stream.getvalue())
    return out


def _plain(*seeds: bytes) -> Callable[[Path], list[bytes]]:
    return lambda folder: list(seeds)


PARSERS = {
    parser.name: parser
    for parser in (
        Parser("scene-toml", _plain(_SCENE), _scene("s.toml")),
        Parser("scene-scn", _plain(_SCN), _scene("s.scn")),
        Parser("map-yaml", _plain(_MAP), _map),
        Parser("map-pgm", _plain(_pgm(), _plain_pgm()), _image),
        Parser("map-png", _png_seeds, _image, _png),
        Parser("carmen", _plain(_CARMEN), _log("x.log")),
        Parser("carmen-gz", _plain(gzip.compress(_CARMEN, mtime=0), b"~" + _CARMEN), _log("x.log.gz"), gzip.compress),
        Parser("carmen-bz2", _plain(bz2.compress(_CARMEN), b"~" + _CARMEN), _log("x.log.bz2"), bz2.compress),
        Parser("relations", _plain(_RELATIONS), _relations),
        Parser("config", _plain(_CONFIG), _config),
        Parser("words", _plain(_WORDS, b"report run-1 --out x --overwrite"), _words),
        Parser("ros1", _foreign("ros1"), _log("x.bag")),
        Parser("mcap", _foreign("mcap"), _log("x.mcap")),
        Parser("db3", _foreign("db3"), _log("x.db3")),
        Parser("run-bag", _run_bag_seeds, _run_bag),
    )
}
